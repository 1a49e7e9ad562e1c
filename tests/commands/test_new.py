"""`hyperbit new`: by options and by questions; it writes a right file, and nothing over another."""

import io
import re
import shlex
from pathlib import Path

import pytest

SEGMENT = ["--module", "prismatic strokes=25,50 link=60", "--module", "revolute angles=-30,30 link=40"]


@pytest.fixture(autouse=True)
def in_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def asked(monkeypatch: pytest.MonkeyPatch, *answers: str) -> None:
    monkeypatch.setattr("sys.stdin", Terminal("".join(f"{line}\n" for line in answers)))


def test_options_give_a_file_that_check_accepts(hyperbit, tmp_path: Path) -> None:
    code, out, err = hyperbit("new", "lift.yaml", *SEGMENT, "--repeat", "10", "--boards", "5", "--defaults")
    assert (code, err) == (0, "")
    assert "lift.yaml: 20 modules, 30 actuators on 5 boards" in out
    code, out, err = hyperbit("check", "lift.yaml")
    assert (code, err) == (0, "")
    assert "no fault" in out
    assert "1750 mm" in out
    assert out.count("Warning") == 1
    assert "30 of 30 actuators were never commissioned" in out


def test_the_command_in_the_file_writes_the_same_file(hyperbit, tmp_path: Path) -> None:
    words = [*SEGMENT, "--repeat", "4", "--valves", "pulse", "--pulse", "60 ms", "--outputs", "24", "--island"]
    words += ["--error-state", "off", "--wiring", "csv", "--bitrate", "125 kbit/s", "--end-stops", "both"]
    assert hyperbit("new", "lift.yaml", *words, "--defaults")[0] == 0
    first = Path("lift.yaml").read_text(), Path("lift-wiring.csv").read_text()
    Path("lift.yaml").unlink()
    Path("lift-wiring.csv").unlink()
    (command,) = re.findall(r"^# +(hyperbit new .*)$", first[0], re.MULTILINE)
    assert hyperbit(*shlex.split(command)[1:])[0] == 0
    assert (Path("lift.yaml").read_text(), Path("lift-wiring.csv").read_text()) == first
    assert hyperbit("check", "lift.yaml")[0] == 0


def test_nothing_is_written_over(hyperbit, told) -> None:
    Path("lift.yaml").write_text("mine")
    assert "lift.yaml: the file exists, and is not written over" in told("new", "lift.yaml", *SEGMENT, code=2)
    Path("b-wiring.csv").write_text("mine")
    csv = ("--wiring", "csv", "--defaults")
    assert "b-wiring.csv: the file exists" in told("new", "b.yaml", *SEGMENT, *csv, code=2)
    assert sorted(path.name for path in Path().iterdir()) == ["b-wiring.csv", "lift.yaml"]
    assert Path("lift.yaml").read_text() == Path("b-wiring.csv").read_text() == "mine"


def test_a_folder_that_cannot_be_written_leaves_nothing(told) -> None:
    assert "nothing is written" in told("new", "nowhere/lift.yaml", *SEGMENT, "--wiring", "csv", "--defaults", code=1)


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["--module", "vtg"], "--module: 'vtg' is no kind of module; did you mean 'vgt'?"),
        ([*SEGMENT, "--unit", "ft"], "--unit: 'ft' is no answer; known are m, cm, mm, in"),
        ([*SEGMENT, "--boards", "7"], "--boards: 7 boards, but 3 actuators need 1 to 3 boards of 8 outputs"),
        ([*SEGMENT, "--travel-time", "80 mm"], "--travel-time: a number is needed, got '80 mm'"),
        ([*SEGMENT, "--pulse", "5 min"], "--pulse: 0.01 s to 10 s are needed, got '5 min'"),
        ([*SEGMENT, "--name", "a b"], "--name: 1 to 64 letters, digits, _ and - are needed, got 'a b'"),
        ([*SEGMENT, "--bitrate", "5 Mbit/s"], "--bitrate: a number from 10000 to 1e+06 is needed, got '5000000'"),
        (["--module", "vgt lengths=200,900"], "do not meet over a base of 200"),
        (
            [*SEGMENT, "--valves", "pulse", "--error-state", "hold"],
            "boards.error_state: hold, but each of the actuators",
        ),
        ([], "--module: at least one module is needed, such as 'prismatic strokes=50 link=60'"),
    ],
)
def test_a_wrong_answer_is_told_and_writes_nothing(told, words: list[str], fault: str) -> None:
    assert fault in told("new", "lift.yaml", *words, "--defaults", code=2)
    assert not list(Path().iterdir())


def test_questions_are_asked_again_until_the_answer_is_right(hyperbit, monkeypatch: pytest.MonkeyPatch) -> None:
    module = "prismatik|prismatic|25,x|25,50|60|revolute|-30 mm|-30, 30|40|no more"
    boards = "can0||no|8|3|5||none|rows"
    asked(monkeypatch, *f"two words|lift|ft|mm|{module}|10|2|||both|{boards}".split("|"))
    code, out, err = hyperbit("new", "lift.yaml")
    assert (code, "20 modules, 30 actuators on 5 boards" in out) == (0, True)
    for said in (
        "1 to 64 letters, digits, _ and - are needed, got 'two words'",
        "'ft' is no answer; known are m, cm, mm, in",
        "'prismatik' is no kind of module; did you mean 'prismatic'?",
        "strokes: a length in mm, as 20 or 2cm, is needed, got 'x'",
        "angles: an angle in degrees, as 30 or 0.5rad, is needed, got '-30mm'",
        "3 boards, but 30 actuators need 4 to 30 boards of 8 outputs",
    ):
        assert said in err
    written = Path("lift.yaml").read_text()
    Path("lift.yaml").unlink()
    words = [*SEGMENT[:3], "revolute angles=-30,30 link=40", "--repeat", "10", "--end-stops", "both", "--boards", "5"]
    assert hyperbit("new", "lift.yaml", *words, "--defaults")[0] == 0
    again = Path("lift.yaml").read_text()
    first, second = ([it for it in text.splitlines() if "#   " not in it] for text in (written, again))
    assert first == second


def test_answers_that_end_write_nothing(told, monkeypatch: pytest.MonkeyPatch) -> None:
    asked(monkeypatch, "lift", "mm")
    assert "the answers end here; nothing is written" in told("new", "lift.yaml", code=1)
    assert not list(Path().iterdir())
