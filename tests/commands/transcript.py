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

FOLDER = Path(__file__).with_name("transcripts")
STEP = r"^(?:> .*\n(?:  .*\n)*|(?:\d?\$ .*\n)+(?:(?!\d?\$ |> ).+\n)*)"
Hyperbit = Callable[..., tuple[int, str, str]]


def read(*, daemon: bool) -> dict[str, str]:
    """Returns the transcripts that need a daemon, those of daemon.txt, or all others, by file and title."""
    return {
        f"{file.stem}: {text.partition(chr(10))[0]}": text.partition("\n")[2]
        for file in sorted(FOLDER.glob("*.txt"))
        if (file.stem == "daemon") == daemon
        for text in re.split(r"^# ", file.read_text(), flags=re.MULTILINE)[1:]
    }


def play(transcript: str, folder: Path, hyperbit: Hyperbit, endpoint: str = "") -> None:
    text = transcript.replace("NOWHERE", "tcp/127.0.0.1:1").replace("HERE", endpoint)
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
