"""The wheel, installed away from this checkout, beside files of a user with the names of its folders."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from tests.waiting import eventually

ROOT = Path(__file__).parents[2]
LETTERS = ("left", "diagonal", "right")
ARM = {
    "name": "four",
    "modules": [{"type": "vgt", "count": 4, "width": 0.2, "lengths": [0.2, 0.25]}],
    "tolerance": {"position": 0.002},
    "travel_time": 0.05,
    "buses": [{"name": "can0", "interface": "socketcan", "channel": "can0", "bitrate": 1000000}],
    "boards": {"heartbeat": 0.1, "heartbeat_timeout": 10.0, "boot_timeout": 30.0, "on_loss": "hold"},
    "actuators": [
        {"module": module, "actuator": LETTERS[k], "bus": "can0", "node": module, "output": k, "input": k}
        for module in range(1, 5)
        for k in range(3)
    ],
}
SCRIPT = """
import hyperbit as hb
arm = hb.load("four.yaml")
solution = hb.Solver(arm).solve(hb.Goal(arm.position([7, 0, 7, 0])), start=arm.home)
print(hb.__file__, hb.__version__, solution.within_tolerance)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder of a user; the wheel is installed in its folder `installed`."""
    folder = tmp_path_factory.mktemp("user")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", folder, ROOT], check=True)
    (wheel,) = folder.glob("hyperbit-*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--target", folder / "installed", wheel], check=True)
    for name in ("controller", "drivers", "deploy"):
        (folder / f"{name}.py").write_text("raise ImportError('this is not a part of hyperbit')")
    (folder / "four.yaml").write_text(yaml.safe_dump(ARM))
    (folder / "script.py").write_text(SCRIPT)
    return folder


def environment(folder: Path) -> dict[str, str]:
    # Python in place of machine code, which would be compiled for minutes. The arm is small.
    return {**os.environ, "PYTHONPATH": str(folder / "installed"), "NUMBA_DISABLE_JIT": "1"}


def run(folder: Path, *words: str) -> str:
    done = subprocess.run([sys.executable, *words], env=environment(folder), cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_contains_nothing_but_the_package_and_its_command(folder: Path) -> None:
    assert {path.name for path in (folder / "installed").iterdir() if path.suffix != ".dist-info"} == {
        "bin",
        "hyperbit",
    }


def test_a_script_uses_the_library(folder: Path) -> None:
    place, version, within = run(folder, "script.py").split()
    assert (Path(place).parent, within) == (folder / "installed" / "hyperbit", "True")
    assert (folder / "installed" / f"hyperbit-{version}.dist-info").is_dir()


def test_the_daemon_runs_and_takes_a_goal(folder: Path) -> None:
    endpoint = f"unixsock-stream/{folder}/zenoh.sock"
    words = ["-m", "hyperbit", "run", "four.yaml", "--simulate", "--listen", endpoint, "--ledger", "ledger.sqlite"]
    log = folder / "log"
    with ExitStack() as closing, log.open("w") as file:
        own = environment(folder) | {"RUNTIME_DIRECTORY": str(folder)}
        daemon = subprocess.Popen([sys.executable, *words], env=own, cwd=folder, stdout=file, stderr=file)
        closing.callback(daemon.wait, 60)
        closing.callback(daemon.terminate)
        eventually(lambda: "serving the arm four" in log.read_text())
        assert "reached" in run(
            folder, "-m", "hyperbit", "send", "four", "--configuration", "7070", "--connect", endpoint
        )
