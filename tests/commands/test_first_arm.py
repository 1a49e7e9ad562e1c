"""From a drawing to a moving arm: `new`, `check`, `commission` with three faults of wiring, and `send`."""

from __future__ import annotations

from pathlib import Path

from tests.commands.commissioning import Commission, right_answer
from tests.system.stack import daemon

MODULES = ["--module", "prismatic strokes=25,50 link=60", "--module", "revolute angles=-15,15 link=40", "--repeat", "2"]
PATIENT = ("  on_loss: hold", "  heartbeat_timeout: 10 # long: tests\n  on_loss: hold")
FAULTS = [  # of the wires: swapped outputs, an inverted output, crossed end-stops
    ("output: 0, input: 0", "output: 1, input: 0"),
    ("output: 1, input: 2", "output: 0, input: 2"),
    ("node: 1, output: 2,", "node: 1, output: {bit: 2, inverted: true},"),
    ("node: 2, output: 2, input: 4, input_contracted: 5", "node: 2, output: 2, input: 5, input_contracted: 4"),
]


def test_a_drawn_arm_with_faults_of_wiring_is_commissioned_and_moves(hyperbit, tmp_path: Path) -> None:
    file, true = tmp_path / "arm.yaml", tmp_path / "true.yaml"
    words = ["--boards", "2", "--end-stops", "both", "--name", "drawn", "--defaults"]
    assert hyperbit("new", str(file), *MODULES, *words)[0] == 0
    file.write_text(drawn := f"planner_timeout: 10\n{file.read_text().replace(*PATIENT)}")
    assert "6 of 6 actuators were never commissioned" in str(hyperbit("check", str(file)))
    wires = drawn
    for before, after in FAULTS:
        assert before in wires
        wires = wires.replace(before, after, 1)
    true.write_text(wires)
    for kinds in (("swapped outputs", "inverted outputs", "crossed end-stops"), ("no fault of the wiring",)):
        it = Commission(tmp_path, "drawn", "--simulate", "--wired", str(true))
        try:
            while (state := it.next_question()) is not None:
                it.answer(state, right_answer(state["commission"]["question"]["text"], file, true))
        finally:
            it.kill()
        assert [kind for kind in kinds if kind not in it.told] == [], it.told
    assert it.process.returncode == 0, it.told
    assert rows(file.read_text()) == rows(wires)
    assert (tmp_path / "arm.yaml.bak-1").read_text() == drawn
    assert "never commissioned" not in str(hyperbit("check", str(file)))
    (served := tmp_path / "served").mkdir()
    with daemon.running(file, served) as endpoint:
        code, out, err = hyperbit("send", str(file), "--to", "25.9,271.6", "--connect", endpoint)
        assert (code, " mm, error " in out) == (0, True), err


def rows(text: str) -> list[str]:
    """Returns the lines of an arm's file but that of the travel time, which a commission measures."""
    return [line for line in text.splitlines() if not line.startswith("travel_time")]
