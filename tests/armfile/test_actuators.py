"""The labels of an arm's actuators, read without geometry: the same as those of the arm that is built."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from hyperbit.controller.arm.arm import load
from hyperbit.controller.armfile.actuators import read_wired
from hyperbit.controller.armfile.strict import InputFaults
from tests.arm_files import TRUSS, changed, document, listed
from tests.keys import DEPLOY

STATE = {"position": [0.1, 0.0]}
CHAINS: dict[str, list[dict[str, Any]]] = {
    "trusses": [{**TRUSS, "count": 3}],
    "revolute": [{"type": "revolute", "angles": [k / 10 for k in range(count)]} for count in (2, 3, 4, 5, 8, 9)],
    "prismatic": [{"type": "prismatic", "axis": [1, 0], "lengths": [0.1, 0.2, 0.3], "count": 2}],
    "transforms": listed(STATE, {"position": [0.2, 0.0]}, {"position": [0.3, 0.0]}, count=2),
    "tables": [{"type": "transforms", "table": "measured.csv"}, TRUSS],
}


def written(folder: Path, content: dict[str, Any]) -> Path:
    (folder / "measured.csv").write_text("x,y,th\n" + "0.1,0,0\n\n" + "0.2,0,0\n" * 4)
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def mapped(folder: Path, modules: list[dict[str, Any]]) -> Path:
    """A file with these modules and all of their actuators wired."""
    bare = {"name": "a", "modules": modules, "tolerance": {"position": 0.002}}
    actuators = load(written(folder, bare)).manipulator.actuators
    wires = [
        {"module": int(label.split(".")[0]), "actuator": label.split(".")[1], "bus": "can0", "node": 1, "output": k}
        for k, label in enumerate(actuators)
    ]
    return written(folder, {**bare, "buses": [{"name": "can0", "channel": "can0"}], "actuators": wires[::-1]})


@pytest.mark.parametrize("path", sorted(Path(DEPLOY).glob("*.yaml")), ids=lambda path: path.stem)
def test_labels_and_wiring_of_the_shipped_arms_are_those_of_the_built_arm(path: Path) -> None:
    arm = load(path)
    assert read_wired(path) == (arm.settings, arm.manipulator.actuators, arm.wiring)


@pytest.mark.parametrize("modules", CHAINS.values(), ids=CHAINS)
def test_labels_and_wiring_of_every_kind_of_module_are_those_of_the_built_arm(
    modules: list[dict[str, Any]], tmp_path: Path
) -> None:
    arm = load(path := mapped(tmp_path, modules))
    assert read_wired(path) == (arm.settings, arm.manipulator.actuators, arm.wiring)


@pytest.mark.parametrize(
    ("where", "value"),
    [("actuators.0.node", 2), ("actuators.1.actuator", "left"), ("actuators.0.module", 3), ("boards.heartbeat", 0.3)],
)
def test_faults_of_the_wiring_are_told_as_for_the_built_arm(where: str, value: Any, tmp_path: Path) -> None:
    path = written(tmp_path, changed(where, value))
    with pytest.raises(InputFaults) as built:
        load(path)
    with pytest.raises(InputFaults) as read:
        read_wired(path)
    assert set(read.value.faults) <= set(built.value.faults)
    assert read.value.faults


@pytest.mark.parametrize("table", ["../measured.csv", "nowhere.csv", "arm.yaml", "one.csv"])
def test_a_table_that_cannot_be_read_is_told(table: str, tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("x,y,th\n0,0,0\n")
    path = written(tmp_path, {**document(), "modules": [{"type": "transforms", "table": table}]})
    with pytest.raises(InputFaults, match=r"modules\[1\]\.table: "):
        read_wired(path)


def test_a_file_that_maps_nothing_is_refused(tmp_path: Path) -> None:
    content = {**document(), "actuators": [], "buses": []}
    with pytest.raises(InputFaults, match="none is mapped"):
        read_wired(written(tmp_path, content))


def test_the_file_is_read_without_the_other_rooms() -> None:
    script = "import sys, hyperbit.controller.armfile.actuators; print({name.split('.')[0] for name in sys.modules})"
    loaded = eval(subprocess.run([sys.executable, "-c", script], capture_output=True, check=True, text=True).stdout)
    assert not loaded & {"numba", "scipy", "numpy", "zenoh", "typer", "rich", "can", "canopen"}
    script = (
        "import sys, hyperbit.controller.armfile.actuators\n"
        "print({name.split('.')[2] for name in sys.modules if name.startswith('hyperbit.controller.')})"
    )
    loaded = eval(subprocess.run([sys.executable, "-c", script], capture_output=True, check=True, text=True).stdout)
    assert loaded == {"armfile", "decoding", "host"}  # of host only the folder of the machine code
