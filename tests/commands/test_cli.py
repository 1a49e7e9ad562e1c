"""The command line: table of commands, imports, files that users name, and errors in words."""

from __future__ import annotations

import errno
import importlib
import inspect
import json
import os
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from hyperbit.controller import cli
from hyperbit.controller.commands.common import arm_name
from hyperbit.controller.commands.table import GROUPS
from hyperbit.controller.commands.use import actuators
from hyperbit.controller.manipulator import locked
from tests.commands.conftest import ARM

HEAVY = {"numba", "numpy", "scipy", "matplotlib", "can", "canopen"}
SLOW = {"pydantic", "rich"}  # a command that stops an arm must not wait for their import
RUN = """
import contextlib, json, sys
from hyperbit.controller import cli
for words in json.loads(sys.argv[1]):
    sys.argv = ["hyperbit", *words]
    with contextlib.suppress(SystemExit):
        cli.main()
print(json.dumps(sorted(name for name in sys.modules if "." not in name)))
"""


def imported(*commands: str) -> set[str]:
    """Returns the top-level modules that commands import, run one after another in a process of their own."""
    words = [command.split() for command in commands]
    done = subprocess.run([sys.executable, "-c", RUN, json.dumps(words)], capture_output=True, text=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_the_table_agrees_with_the_commands():
    for name, entry in cli.COMMANDS.items():
        module = importlib.import_module(f"hyperbit.controller.commands.{entry.module}")
        function = getattr(module, name.replace("-", "_"))
        assert entry.summary == inspect.getdoc(function).splitlines()[0]


def test_each_command_is_in_one_group_and_has_an_example_of_itself(hyperbit):
    assert sum(map(len, GROUPS.values())) == len(cli.COMMANDS)
    assert all(entry.example.split()[:2] == ["hyperbit", name] for name, entry in cli.COMMANDS.items())
    lines = hyperbit("--help")[1].splitlines()
    assert [line.removesuffix(":") for line in lines if line.removesuffix(":") in GROUPS] == list(GROUPS)
    assert set(cli.COMMANDS) <= {line.split()[0] for line in lines if line.split()}
    for name in ("stop", "halt", "wear"):
        assert hyperbit(name, "--help")[1].rstrip().endswith(f"Example: {cli.COMMANDS[name].example}")


def test_the_page_of_the_commands_has_the_same_groups_and_examples():
    sections = (Path(cli.__file__).parent / "commands" / "README.md").read_text().split("\n## ")
    rows = {
        section.partition("\n")[0]: re.findall(r"^\| (`.*?) \|.*\| `(.*?)` \|$", section, re.M) for section in sections
    }
    for title, group in GROUPS.items():
        assert sorted(name for row, _ in rows[title] for name in re.findall("`(.*?)`", row)) == sorted(group)
        assert {example for _, example in rows[title]} <= {entry.example for entry in group.values()}


@pytest.mark.parametrize(
    ("commands", "without"),
    [
        (["--help", "--version"], {*HEAVY, "zenoh", "yaml", "msgspec"}),
        ([f"{name} planar16 NOWHERE" for name in ("stop", "cancel", "reset")], {*HEAVY, *SLOW, "yaml"}),
        (["halt planar16 --socket /nonexistent/a.sock"], {*HEAVY, *SLOW, "yaml", "zenoh"}),
        (["wear ARM --ledger /nonexistent/none.sqlite"], {"numba", "scipy", "zenoh"}),
        (
            [
                "stop --help",
                *(f"{name} ARM NOWHERE" for name in ("stop", "cancel", "reset", "watch")),
                "send ARM --to 1,2 NOWHERE",
                "lock ARM 5.left=free NOWHERE",
                "jog ARM 5.left=extended NOWHERE",
                "obstacles ARM --none NOWHERE",
            ],
            HEAVY,
        ),
    ],
    ids=["help", "stops", "halt", "wear", "requests"],
)
def test_commands_import_only_what_they_need(commands, without):
    found = imported(*(it.replace("ARM", str(ARM)).replace("NOWHERE", "--connect tcp/127.0.0.1:1") for it in commands))
    assert found.isdisjoint(without), found & without
    assert ("zenoh" in found) == any("NOWHERE" in it for it in commands)


def test_the_version_is_that_of_the_package(hyperbit):
    assert hyperbit("--version") == (0, f"hyperbit {version('hyperbit')}\n", "")


def test_bash_asks_the_command_itself():
    asked = {"_HYPERBIT_COMPLETE": "complete_bash", "COMP_WORDS": "hyperbit st", "COMP_CWORD": "1"}
    run = "import sys; sys.argv[0] = 'hyperbit'; from hyperbit.controller.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, env={**os.environ, **asked})
    assert done.stdout.split() == ["stop"], done.stderr


def test_an_arm_is_a_file_only_if_it_is_a_regular_file(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "planar16").mkdir()
    assert arm_name("planar16") == "planar16"
    (tmp_path / "arm").write_text(ARM.read_text())
    assert arm_name("arm") == "planar16"


def test_states_have_the_names_of_the_arm():
    assert actuators.STATES == locked.STATES


READERS = {
    "arm": ("check", "FILE"),
    "wiring": ("check", str(ARM), "--eds", "FILE"),
    "goals": ("plan", str(ARM), "--goals", "FILE"),
    "goal": ("send", "planar16", "FILE"),
    "obstacles": ("obstacles", "planar16", "FILE"),
    "samples": ("calibrate", str(ARM), "FILE"),
    "people": ("panel", "--people", "FILE"),
    "Zenoh": ("stop", "planar16", "--zenoh", "FILE"),
    "recording": ("replay", "FILE"),
}


def endless(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 40)


NO_FILES = {
    "directory": (Path.mkdir, "cannot be read: it is a directory, no file"),
    "device": (lambda path: path.symlink_to("/dev/zero"), "cannot be read: it is a device, no file"),
    "pipe": (os.mkfifo, "cannot be read: it is a pipe, no file"),
    "without an end": (endless, "MB, the most for such a file; is it the right file?"),
}


@pytest.mark.parametrize("name", READERS)
def test_what_is_no_file_or_has_no_end_is_refused_and_nothing_waits_for_it(told, tmp_path, name):
    for kind, (make, sentence) in NO_FILES.items():
        if (name, kind) != ("recording", "without an end"):
            path = tmp_path / kind.replace(" ", "-")
            make(path)
            words = [str(path) if word == "FILE" else word for word in READERS[name]]
            assert sentence in told(*words, code=2).replace("\n", " ")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (
            RuntimeError("cannot cache function 'f': no locator available for file 'f.py'"),
            "numba cannot write its machine code: set NUMBA_CACHE_DIR to a folder that you can write\n",
        ),
        (
            OSError(errno.ENOSPC, "No space left on device", "/out.png"),
            "/out.png: No space left on device\nNext: free it, and start the command again\n",
        ),
    ],
)
def test_an_error_of_the_computer_is_told_with_what_to_do(hyperbit, monkeypatch, error, words):
    def failing(*_: object) -> None:
        raise error

    monkeypatch.setattr("hyperbit.controller.commands.study.report.load", failing)
    assert hyperbit("fk", str(ARM), "0") == (1, "", words)


def test_a_file_that_ends_too_early_is_an_error_with_its_place(hyperbit, monkeypatch):
    def damaged(*_: object) -> None:
        raise EOFError("Ran out of input")

    monkeypatch.setattr("hyperbit.controller.commands.study.report.load", damaged)
    with pytest.raises(RuntimeError, match="a file ends too early: Ran out of input"):
        hyperbit("fk", str(ARM), "0")


def test_terminals_that_are_not_utf8_show_tables():
    command = [sys.executable, "-m", "hyperbit", "plan", str(ARM), "--configuration", "0" * 16]
    done = subprocess.run(command, capture_output=True, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"th [rad]" in done.stdout
