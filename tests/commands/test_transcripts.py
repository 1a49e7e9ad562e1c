"""What commands print and how they end, in the files of `transcripts`.

A title begins with `#`; each title is a test in a folder of its own. `> NAME` makes a file of the indented lines that
follow. `$ WORDS` is a command that ends with 0, `1$ WORDS` one that ends with 1. Below it are all lines of its output,
and after `!` parts of its messages in their order; without them it prints nothing there. A line `...` stands for any
lines, and `...` in a line for any text. Commands that follow one another immediately print the same. HERE is the
endpoint of a running daemon of planar16, and nobody listens at NOWHERE.
"""

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest

from hyperbit.drivers.simulation.dictionary import EDS
from tests.keys import DEPLOY
from tests.recorder.samples import written

FOLDER = Path(__file__).with_name("transcripts")
TRANSCRIPTS = {
    f"{file.stem}: {text.partition(chr(10))[0]}": text.partition("\n")[2]
    for file in sorted(FOLDER.glob("*.txt"))
    for text in re.split(r"^# ", file.read_text(), flags=re.MULTILINE)[1:]
}
SHORT = "name: short\nmodules: [{type: vgt, count: 5, width: 0.2, lengths: [0.2, 0.25]}]\ntolerance: {position: 0.01}\n"
STEP = r"^(?:> .*\n(?:  .*\n)*|(?:\d?\$ .*\n)+(?:(?!\d?\$ |> ).+\n)*)"
Hyperbit = Callable[..., tuple[int, str, str]]


@pytest.fixture
def folder(tmp_path: Path, own_folders: None, spatial: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory: arms, an EDS, and a recording without a description of its arm."""
    monkeypatch.chdir(tmp_path)
    for name, target in (("planar16.yaml", DEPLOY / "planar16.yaml"), ("deploy", DEPLOY), ("board.eds", EDS)):
        (tmp_path / name).symlink_to(target)
    (tmp_path / "short.yaml").write_text(SHORT)
    written(tmp_path / "a.mcap").close()
    return tmp_path


@pytest.mark.parametrize("title", TRANSCRIPTS)
def test_commands_print_and_end_as_in_their_transcript(
    title: str, folder: Path, hyperbit: Hyperbit, request: pytest.FixtureRequest
) -> None:
    text = TRANSCRIPTS[title].replace("NOWHERE", "tcp/127.0.0.1:1")
    if "HERE" in text:
        text = text.replace("HERE", request.getfixturevalue("endpoint"))
    for step in re.findall(STEP, text, re.MULTILINE):
        if step.startswith("> "):
            name, _, content = step[2:].partition("\n")
            (folder / name).write_text(re.sub("^  ", "", content, flags=re.MULTILINE))
            continue
        commands = re.findall(r"^(\d?)\$ (.*)\n", step, re.MULTILINE)
        shown = [line for line in step.splitlines()[len(commands) :] if line]
        for code, words in commands:
            ended, out, err = hyperbit(*shlex.split(words.replace(r"\udcff", "\udcff")))
            assert ended == int(code or 0), f"{words}\n{out}{err}"
            check(words, [line for line in shown if not line.startswith("!")], out, "\n", r"(?:.*\n)*")
            messages = [f"...{line[2:]}..." for line in shown if line.startswith("!")]
            check(words, ["".join(messages)] * bool(messages), " ".join(err.split()), "", "")


def check(words: str, shown: list[str], printed: str, end: str, any_lines: str) -> None:
    """Compares what a command has printed with the lines of its transcript."""
    lines = [any_lines if line == "..." and end else re.escape(line).replace(r"\.\.\.", ".*") + end for line in shown]
    if not re.fullmatch("".join(lines), printed):
        pytest.fail(f"{words} printed\n{printed}instead of\n" + "\n".join(shown), pytrace=False)
