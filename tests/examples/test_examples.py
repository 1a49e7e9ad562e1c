"""Each example runs and prints the expected words."""

import runpy
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.stack import daemon

HERE = Path(__file__).parent

# Words of the output, and pictures that are drawn.
EXAMPLES: dict[str, tuple[tuple[str, ...], str | None]] = {
    "01_first_solve": (("certificate:", "switches"), None),
    "02_trajectory": (("12 points", "farthest from a goal: 0.00"), "trajectory.png"),
    "03_own_arm": (("6 modules with [4, 8, 8, 8, 8, 2] states, 15 actuators",), None),
    "04_spatial_arm": (("position only", "with orientation"), "spatial.png"),
    "05_obstacles": ((" is in disc 'crate'", "switches; clear", "path of"), "obstacles.png"),
    "06_locked_actuators": (("whole", "with locked actuators", "5.left is 1"), None),
    "07_methods": (("minimum-switch", "pop", "25/25"), None),
    "08_density": (("pixels", "densest at"), "density.png"),
    "09_calibration": (("residuals (rms): before", "samples held out"), None),
}


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.delenv("CACHE_DIRECTORY", raising=False)
        yield


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words, picture = EXAMPLES[name]
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(HERE / f"{name}.py"), run_name="__main__")
    printed = capsys.readouterr().out
    assert all(word in printed for word in words), printed
    assert picture is None or (tmp_path / picture).stat().st_size > 1000


@pytest.mark.timeout(600)
def test_the_example_that_sends_a_goal_to_a_daemon(
    arm_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with daemon.running(arm_file, tmp_path) as endpoint:
        monkeypatch.setattr(sys, "argv", ["10_send_goal.py", endpoint])
        runpy.run_path(str(HERE / "10_send_goal.py"), run_name="__main__")
    printed = capsys.readouterr().out
    assert "accepted: True" in printed
    assert "succeeded at [0.4" in printed or "succeeded at [0.3" in printed, printed


def test_every_example_is_tried() -> None:
    assert {path.stem for path in HERE.glob("[0-9]*.py")} == {*EXAMPLES, "10_send_goal"}
