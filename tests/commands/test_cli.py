"""The command line: table of commands, imports, version."""

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
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import arm_name
from hyperbit.controller.commands.table import GROUPS
from hyperbit.controller.commands.use import actuators
from hyperbit.controller.manipulator import locked

ARM = Path(__file__).parents[2] / "deploy" / "planar16.yaml"
HEAVY = {"numba", "numpy", "scipy", "matplotlib", "can", "canopen"}
SLOW = {"pydantic", "rich"}  # a command that stops an arm must not wait for their import
NOWHERE = ("--connect", "tcp/127.0.0.1:1")
RUN = """
import json, sys
from hyperbit.controller import cli
sys.argv[0] = "hyperbit"
try:
    cli.main()
finally:
    print(json.dumps(sorted(name for name in sys.modules if "." not in name)))
"""


def imported(*words: str) -> set[str]:
    """Returns the top-level modules that a command imports, run in its own process."""
    done = subprocess.run([sys.executable, "-c", RUN, *words], capture_output=True, text=True, timeout=100)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_the_table_agrees_with_the_commands():
    for name, entry in cli.COMMANDS.items():
        module = importlib.import_module(f"hyperbit.controller.commands.{entry.module}")
        function = getattr(module, name.replace("-", "_"))
        assert entry.summary == inspect.getdoc(function).splitlines()[0]


def test_each_command_is_in_one_group_and_has_an_example_of_itself(hyperbit):
    assert sum(map(len, GROUPS.values())) == len(cli.COMMANDS)
    assert all(entry.example.split()[:2] == ["hyperbit", name] for name, entry in cli.COMMANDS.items())
    code, out, _ = hyperbit("--help")
    assert code == 0
    assert [line.removesuffix(":") for line in out.splitlines() if line.removesuffix(":") in GROUPS] == list(GROUPS)


def test_the_page_of_the_commands_has_the_same_groups_and_examples():
    sections = (Path(cli.__file__).parent / "commands" / "README.md").read_text().split("\n## ")
    rows = {
        section.partition("\n")[0]: re.findall(r"^\| (`.*?) \|.*\| `(.*?)` \|$", section, re.M) for section in sections
    }
    for title, group in GROUPS.items():
        assert sorted(name for row, _ in rows[title] for name in re.findall("`(.*?)`", row)) == sorted(group)
        assert {example for _, example in rows[title]} <= {entry.example for entry in group.values()}


def test_the_help_of_a_command_ends_with_its_example(hyperbit):
    for name in ("stop", "halt", "wear"):
        assert hyperbit(name, "--help")[1].rstrip().endswith(f"Example: {cli.COMMANDS[name].example}")


@pytest.mark.parametrize(
    ("words", "completed"),
    [("hyperbit st", "stop"), ("hyperbit stop --js", "--json"), ("hyperbit send --path", "--path-tolerance")],
)
def test_bash_completes_commands_and_options(words, completed):
    asked = {"_HYPERBIT_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    run = [
        sys.executable,
        "-c",
        "import sys; sys.argv[0] = 'hyperbit'; from hyperbit.controller.cli import main; main()",
    ]
    done = subprocess.run(run, capture_output=True, text=True, timeout=100, env={**os.environ, **asked})
    assert done.stdout.split() == [completed], done.stderr


@pytest.mark.parametrize("words", [("--help",), ("--version",)])
def test_help_and_version_import_no_command(words):
    assert imported(*words).isdisjoint({*HEAVY, "zenoh", "yaml", "msgspec"})


@pytest.mark.parametrize(
    "words",
    [
        ("stop", "--help"),
        ("stop", str(ARM), *NOWHERE),
        ("cancel", str(ARM), *NOWHERE),
        ("reset", str(ARM), *NOWHERE),
        ("watch", str(ARM), *NOWHERE),
        ("send", str(ARM), "--to", "1,2", *NOWHERE),
        ("lock", str(ARM), "5.left=free", *NOWHERE),
        ("jog", str(ARM), "5.left=extended", *NOWHERE),
        ("obstacles", str(ARM), "--none", *NOWHERE),
    ],
)
def test_commands_to_a_daemon_import_no_kernels(words):
    assert imported(*words).isdisjoint(HEAVY)


@pytest.mark.parametrize("command", ["stop", "cancel", "reset"])
def test_commands_that_stop_an_arm_import_only_needed_modules(command):
    found = imported(command, "planar16", *NOWHERE)
    assert "zenoh" in found
    assert found.isdisjoint({*HEAVY, *SLOW, "yaml"})


def test_a_halt_does_not_import_zenoh():
    words = ("halt", "planar16", "--socket", "/nonexistent/a.sock")
    assert imported(*words).isdisjoint({*HEAVY, *SLOW, "yaml", "zenoh"})


def test_wear_imports_no_kernels(tmp_path):
    assert imported("wear", str(ARM), "--ledger", str(tmp_path / "none.sqlite")).isdisjoint({"numba", "scipy", "zenoh"})


def test_typed_values_are_still_checked(hyperbit):
    code, out, err = hyperbit("send", str(ARM), "--to", "1,2", "--path-tolerance", "near", *NOWHERE)
    assert (code, out) == (2, "")
    assert "--path-tolerance" in err


def test_the_version_is_that_of_the_package(hyperbit):
    assert hyperbit("--version") == (0, f"hyperbit {version('hyperbit')}\n", "")


def test_a_mistyped_command_is_unusable_input(hyperbit):
    code, out, err = hyperbit("stpo")
    assert (code, out) == (2, "")
    assert "'stop'" in err


def test_an_arm_is_a_file_only_if_it_is_a_regular_file(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "planar16").mkdir()
    assert arm_name("planar16") == "planar16"
    (tmp_path / "arm").write_text(ARM.read_text())
    assert arm_name("arm") == "planar16"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "is empty"),
        ("- 1", "name: required, but missing"),
        ("name: a/b", "name: "),
        ("name: [a]", "name: "),
        ("name: {", "is not YAML"),
    ],
)
def test_a_file_without_a_name_is_unusable_input(tmp_path, text, fault):
    file = tmp_path / "arm.yaml"
    file.write_text(text)
    with pytest.raises(InputFaults, match=fault):
        arm_name(str(file))
    with pytest.raises(InputFaults, match="no such file"):
        arm_name(str(tmp_path / "missing.yaml"))


def test_states_have_the_names_of_the_arm():
    assert actuators.STATES == locked.STATES


def test_a_command_that_finds_no_folder_says_what_to_do(hyperbit, monkeypatch):
    def refuse(path: object) -> None:
        raise RuntimeError("cannot cache function 'f': no locator available for file 'f.py'")

    monkeypatch.setattr("hyperbit.controller.arm.arm.load", refuse)
    code, _, err = hyperbit("check", str(ARM))
    assert (code, err) == (
        1,
        "numba cannot write its machine code: set NUMBA_CACHE_DIR to a folder that you can write\n",
    )


def test_a_file_that_ends_too_early_is_an_error_with_its_place(hyperbit, monkeypatch):
    def damaged(*_: object) -> None:
        raise EOFError("Ran out of input")

    monkeypatch.setattr("hyperbit.controller.commands.study.report.load", damaged)
    with pytest.raises(RuntimeError, match="a file ends too early: Ran out of input"):
        hyperbit("fk", "deploy/planar16.yaml", "0")


def test_a_full_disk_is_told_in_words(hyperbit, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "/out.png")

    monkeypatch.setattr("hyperbit.controller.commands.study.report.load", full)
    code, _, err = hyperbit("fk", "deploy/planar16.yaml", "0")
    assert (code, err) == (1, "/out.png: No space left on device\nNext: free it, and start the command again\n")


@pytest.mark.parametrize("encoding", ["latin-1", "ascii"])
def test_terminals_that_are_not_utf8_show_tables(tmp_path, encoding):
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    command = [sys.executable, "-m", "hyperbit", "plan", str(ARM), "--configuration", "0" * 16]
    done = subprocess.run(command, capture_output=True, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"th [rad]" in done.stdout
