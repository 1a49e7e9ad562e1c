"""The tool plants the defects that it lists, and tells which are found."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from tests.mutants.__main__ import PLANTED
from tests.mutants.checks import ROOT, ordered_tests, room_of, simulate
from tests.mutants.forks import Result, ended, start, stop
from tests.mutants.planted import planted
from tests.mutants.results import Results, equivalents, table
from tests.mutants.sites import Mutant, listed, mutants_of, sample
from tests.mutants.started.sitecustomize import plant

EQUIVALENT = Path(__file__).with_name("equivalent.txt")


def changed(source: str) -> set[str]:
    return {mutant.place["after"] for mutant in mutants_of("room/module.py", source)}


def in_function(*lines: str) -> str:
    """Returns a function with these lines, which are not its last ones."""
    return "\n    ".join(["def f(a, b, c):", *lines, "return"])


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("x = a < b", {"x = (a <= b)"}),
        ("x = a == b", {"x = (a != b)"}),
        ("x = a not in b", {"x = (a in b)"}),
        ("x = a and b", {"x = (a or b)"}),
        ("x = not a", {"x = a"}),
        ("x = a + b", {"x = (a - b)"}),
        ("x = a + 'text'", set()),
        (in_function("x = a & ~b"), {"x = (a | ~b)", "x = a & b"}),
        ("x = 0.5", {"x = 1.5"}),
        ("x = 1", {"x = 2", "x = 0"}),
        ("x = True", {"x = False"}),
        ("x = min(a, b)", {"x = max(a, b)"}),
        ("x = f(a, b, c.d)", {"x = (f(b, a, c.d))"}),
        (in_function("a.x = b"), {"pass"}),
        (in_function("a += b"), {"pass", "a -= b"}),
        (in_function("a.b()"), {"pass"}),
        (in_function("raise ValueError(1)"), {"pass"}),
        ("def f():\n    return a", {"return None"}),
        (in_function("return a"), {"return None", "pass"}),
        ("for a in b:\n    if a: continue\n    c = a", {"if True: continue", "if (not a): continue", "if a: pass"}),
        ("x = a if b else c", {"x = a if True else c", "x = a if False else c", "x = a if (not b) else c"}),
        ("x = [a for a in b if c]", {"x = [a for a in b if True]"}),
        ("match a:\n    case B():\n        c = a", {"case B() if False:"}),
        ("match a:\n    case B() if c:\n        d = a", {"case B() if False:", "case B() if True:"}),
    ],
)
def test_each_operator_changes_one_thing(source: str, expected: set[str]) -> None:
    assert changed(source) == expected


@pytest.mark.parametrize(
    "source",
    [
        '"""A docstring with 1 < 2."""',
        "x: Annotated[int, 1 < 2]",
        "def f(a: Annotated[int, 1]) -> Annotated[int, 1]: ...",
        "if TYPE_CHECKING:\n    x = 1",
        "class A:\n    def __repr__(self):\n        return self.x + self.y",
        "assert isinstance(a, int) and b is not None",
        "log.info('text', 1 < 2)",
        "act(Log(1, f'{a + b}'))",
        "x = f'{a + b:.3f}'",
        "@dataclass(frozen=True)\nclass A(Base, tag=1): ...",
        "X = A | B",
        "def f():\n    for a in b:\n        continue",
        "def f():\n    return",
        "class A:\n    def __init__(self, x):\n        self.x = x",
    ],
)
def test_texts_types_and_what_has_no_effect_are_left(source: str) -> None:
    assert changed(source) == set()


def test_mutants_have_a_name_and_another_program() -> None:
    aside = equivalents(EQUIVALENT)
    rooms = {room_of(name.partition("::")[0]) for name in aside}
    mutants = [mutant for of_room in listed(ROOT, rooms, room_of).values() for mutant in of_room]
    names = {mutant.id for mutant in mutants}
    assert len(names) == len(mutants) > 1000
    assert set(aside) <= names
    for mutant in sample({"all": mutants}, 50, seed=1):
        assert ast.dump(ast.parse(mutant.source)) != ast.dump(ast.parse(mutant.original))


def test_each_planted_defect_is_a_program_of_a_room() -> None:
    defects = planted(ROOT, PLANTED)
    assert len({mutant.id for mutant in defects}) == len(defects) > 0
    for mutant in defects:
        assert room_of(mutant.file)
        assert mutant.source.encode() != mutant.original
        compile(mutant.source, mutant.file, "exec")


def test_lines_are_replaced_at_their_indentation(tmp_path: Path) -> None:
    (tmp_path / "m.py").write_text("def f(a):\n    if a:\n        g()\n    return a\n")
    (tmp_path / "by_hand.txt").write_text(
        "# a comment\n\nm.py: nothing runs\n- if a:\n-     g()\n+ if not a:\n+     h()\n"
    )
    [mutant] = planted(tmp_path, tmp_path)
    assert mutant.id == "planted::m.py::nothing runs"
    assert mutant.source == "def f(a):\n    if not a:\n        h()\n    return a\n"
    (tmp_path / "m.py").write_text("pass\n")
    with pytest.raises(ValueError, match=r"by_hand\.txt: m\.py: nothing runs: these lines stand in the file 0 times"):
        planted(tmp_path, tmp_path)


def test_a_name_survives_other_edits_of_the_file() -> None:
    source = "def f(a):\n    if a < 1:\n        return a + 1\n    return a + 1\n"
    edited = f"X = 7\n\n\ndef g(a):\n    return a < 1\n\n\n{source.replace('return a', 'return (  a')[:-1]})\n".replace(
        "a + 1\n    return", "a + 1)\n    return"
    )
    names = {mutant.id for mutant in mutants_of("m.py", source)}
    assert names < {mutant.id for mutant in mutants_of("m.py", edited)}
    assert "m.py::f::return a + 1::a + 1 => a - 1 #2" in names


def test_a_seed_draws_the_same_sample_by_the_sizes_of_the_rooms() -> None:
    rooms = {
        "small": mutants_of("small.py", "\n".join(f"x{k} = 0" for k in range(100))),
        "large": mutants_of("large.py", "\n".join(f"x{k} = 0" for k in range(300))),
    }
    drawn = sample(rooms, 40, seed=3)
    assert drawn == sample(rooms, 40, seed=3) != sample(rooms, 40, seed=4)
    assert [sum(mutant.file == f"{room}.py" for mutant in drawn) for room in rooms] == [10, 30]
    rooms["small"] += mutants_of("new.py", "x = 0")
    assert len(set(sample(rooms, 40, seed=3)) & set(drawn)) >= 38


TOY = "def least(a, b):\n    if a < b:\n        return a\n    return b\n"


def outcome(work: partial[Result], limit: float = 60.0) -> Result:
    children = [start("toy", work, limit, 60.0)]
    while True:
        for _, result in ended(children):
            return result


def use_toy(folder: Path, mutant: Mutant) -> Result:
    plant("toy_of_mutants", str(folder / mutant.file), mutant.source)
    sys.path.insert(0, str(folder))
    toy = __import__("toy_of_mutants")
    return {"found": (toy.least(1, 2), toy.least(2, 1), toy.least(1, 1)) != (1, 1, 1)}


def test_a_planted_defect_is_found_and_an_equivalent_one_survives(tmp_path: Path) -> None:
    (tmp_path / "toy_of_mutants.py").write_text(TOY)
    mutants = mutants_of("toy_of_mutants.py", TOY)
    found = {mutant.id.split("::", 2)[2]: outcome(partial(use_toy, tmp_path, mutant))["found"] for mutant in mutants}
    assert found.pop("if a < b::a < b => a <= b") is False
    assert len(found) >= 4
    assert all(found.values())
    assert "toy_of_mutants" not in sys.modules


def test_the_simulation_finds_a_planted_defect() -> None:
    [defect] = [mutant for mutant in planted(ROOT, PLANTED) if mutant.id.endswith("::no switch is counted")]
    assert "seed" in outcome(partial(simulate, defect, 20_000))


def never_end(folder: Path) -> Result:
    while True:
        pass


def fail_in_the_tool() -> Result:
    raise KeyError("what")


def test_a_child_that_spins_or_dies_has_found_the_defect(tmp_path: Path) -> None:
    assert outcome(partial(never_end, tmp_path), 0.1)["why"] == "does not end"
    assert outcome(partial(os._exit, 3))["why"] == "exits with status 3"
    with pytest.raises(RuntimeError, match="KeyError: 'what'"):
        outcome(partial(fail_in_the_tool))


def test_children_can_be_stopped(tmp_path: Path) -> None:
    children = [start("toy", partial(never_end, tmp_path), 600.0, 600.0)]
    pid = children[0].pid
    stop(children)
    assert not children
    with pytest.raises(ChildProcessError):
        os.waitpid(pid, 0)


def test_results_are_read_again_and_counted(tmp_path: Path) -> None:
    found, by_tests, survivor, later = mutants = mutants_of("room/m.py", "a = 0\nb = 0\nc = 0\nd = 0")
    results = Results(tmp_path / "results.jsonl")
    for mutant, phase, is_found in (
        (found, "simulation", True),
        (by_tests, "simulation", False),
        (by_tests, "tests", True),
        (survivor, "simulation", False),
    ):
        record = {"id": mutant.id, "phase": phase, "module": mutant.module, "found": is_found, "test": "t.py::test_x"}
        results.add(record)
    with (tmp_path / "results.jsonl").open("a") as file:
        file.write('{"id": "interrup')
    again = Results(tmp_path / "results.jsonl")
    assert [again.found_by(mutant) for mutant in mutants] == ["simulation", "tests", "", "open"]
    assert again.finders("hyperbit.room.m") == ["t.py"]
    again.add({"id": later.id, "phase": "simulation", "module": "hyperbit.room.m", "found": True})
    assert Results(tmp_path / "results.jsonl").found_by(later) == "simulation"
    lines = table([("room", mutant) for mutant in mutants], again).splitlines()
    assert lines[1].split() == ["room", "4", "2", "1", "1", "0"]
    assert lines[-4:] == [survivor.id, "room/m.py:3", "  - c = 0", "  + c = 1"]


def test_tests_that_mirror_the_module_run_first() -> None:
    mutants = listed(ROOT, ["drivers/canopen/run"], room_of)["drivers/canopen/run"]
    commit = next(mutant for mutant in mutants if mutant.file.endswith("commit.py"))
    files = ordered_tests("drivers/canopen/run", commit)
    assert files[0] == "tests/drivers/canopen/run/test_commit.py"
    assert sorted(files) == sorted(ordered_tests("drivers/canopen/run", None))
    assert ordered_tests("drivers/canopen/run", commit, files[-1:])[0] == files[-1]


def test_the_command_lists_planted_defects_and_a_sample() -> None:
    command = [sys.executable, "-m", "tests.mutants", "--rooms", "controller/gateway", "--sample", "2", "--list"]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    of_room = [line for line in printed if line.startswith(("planted::controller/gateway/", "controller/gateway/"))]
    ids = [line for line in of_room if "::" in line]
    assert [line.startswith("planted::") for line in ids] == [True] * (len(ids) - 2) + [False] * 2
    assert printed[-1].startswith(f"{len(ids)} of ")
