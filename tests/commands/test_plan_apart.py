"""plan --goals --apart: each goal by itself, by work, and results in a file that a second run goes on with."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

import hyperbit as hb
from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.commands.study import plan as plan_module
from hyperbit.controller.commands.study.plan_rows import write_line
from hyperbit.controller.host.keeper import lock_file

ARM = """name: short
tolerance: {position: 0.01}
modules: [{type: vgt, count: 4, width: 0.2, lengths: [0.2, 0.25]}]
"""
START = "7070"

pytestmark = pytest.mark.usefixtures("own_folders")


@pytest.fixture
def arm(tmp_path) -> hb.Arm:
    (tmp_path / "short.yaml").write_text(ARM)
    return hb.load(tmp_path / "short.yaml")


@pytest.fixture
def plan(hyperbit, tmp_path, arm):
    """Runs `plan` for twelve goals; each third one has a previous configuration of its own."""
    tips = arm.frames(arm.sample(12, seed=2))[:, :2, 3].tolist()
    rows = [f"{x!r},{y!r},{START if k % 3 == 0 else ''}\n" for k, (x, y) in enumerate(tips)]
    (tmp_path / "goals.csv").write_text("x,y,previous\n" + "".join(rows))
    words = "plan", str(tmp_path / "short.yaml"), "--goals", str(tmp_path / "goals.csv")
    return lambda *more: hyperbit(*words, *more)


def interrupted_after(monkeypatch, goals: int) -> None:
    """Ctrl-C comes with the search after some goals."""
    search, left = plan_module.search_one, [goals]

    def searched(*given):
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return search(*given)

    monkeypatch.setattr(plan_module, "search_one", searched)


def test_each_goal_is_searched_from_the_start_or_its_own_configuration(plan, arm, tmp_path):
    lines = [json.loads(line) for line in plan("--apart", "--effort", "20", "--json")[1].splitlines()]
    ik = hb.Solver(arm)
    for k, line in enumerate(lines):
        alone = ik.solve(line["goal"], START if k % 3 == 0 else None, effort=20)
        assert line["configuration"] == arm.format(alone.configuration)
        assert (line["switches"], line["certificate"]) == (alone.switches, alone.certificate)
        assert line["effort"] == alone.effort
        assert not {"seconds", "trajectory"} & line.keys()
    assert len(lines) == 12


@pytest.mark.parametrize("apart", [("--apart", "--effort", "20"), ()])
def test_results_are_in_the_file_line_by_line(plan, apart, tmp_path):
    output = tmp_path / "out.jsonl"
    code, out, err = plan(*apart, "--output", str(output))
    header, *lines = [json.loads(line) for line in output.read_text().splitlines()]
    assert (code, out) == (0, "")
    assert f"{output} has the results of 12 goals" in err
    assert set(header) == {"study", "hyperbit", "arm", "goals", "options"}
    printed = [json.loads(line) for line in plan(*apart, "--json")[1].splitlines()]
    assert [line["goal"] for line in lines] == [line["goal"] for line in printed]
    if apart:
        assert lines == printed
    code, _, err = plan(*apart, "--output", str(output))
    assert (code, len(output.read_text().splitlines())) == (0, 13)
    assert "has 12 of 12 goals" in err


def test_an_interrupted_study_goes_on_where_it_ended(plan, monkeypatch, tmp_path):
    words, whole, output = ("--apart", "--effort", "20", "--output"), tmp_path / "whole.jsonl", tmp_path / "out.jsonl"
    plan(*words, str(whole))
    with monkeypatch.context() as patch:
        interrupted_after(patch, 5)
        code, _, err = plan(*words, str(output))
    assert code == 130
    assert f"interrupted: {output} has 5 of 12 goals; the same command goes on after them" in err
    for cut in (0, 1, 40):
        text = output.read_bytes()
        output.write_bytes(text[: len(text) - cut])
        with monkeypatch.context() as patch:
            interrupted_after(patch, 2)
            assert plan(*words, str(output))[0] == 130
    code, _, err = plan(*words, str(output))
    assert (code, output.read_bytes()) == (0, whole.read_bytes())


def test_a_trajectory_that_was_not_finished_is_planned_again(plan, tmp_path):
    output = tmp_path / "out.jsonl"
    plan("--output", str(output))
    lines = output.read_bytes().splitlines(keepends=True)
    output.write_bytes(b"".join(lines[:6]))  # the header, one trajectory of three goals, and two goals of the next
    code, _, err = plan("--output", str(output))
    assert code == 0
    assert f"{output} has 3 of 12 goals" in err
    again = output.read_bytes().splitlines(keepends=True)
    assert again[:4] == lines[:4]
    assert [json.loads(line)["goal"] for line in again[1:]] == [json.loads(line)["goal"] for line in lines[1:]]


def test_a_file_of_another_study_is_refused_in_words(plan, tmp_path):
    output, words = tmp_path / "out.jsonl", ("--apart", "--output", str(tmp_path / "out.jsonl"))
    plan("--effort", "20", *words)
    before = output.read_bytes()

    def refusal(*more: str) -> str:
        code, _, err = plan(*more, *words)
        assert code == 2
        return err

    assert "its results belong to other options" in refusal("--effort", "21")
    arm, goals = tmp_path / "short.yaml", tmp_path / "goals.csv"
    arm.write_text(ARM + "# a remark changes nothing\n")
    assert plan("--effort", "20", *words)[0] == 0
    arm.write_text(ARM.replace("0.25", "0.26"))
    goals.write_text(goals.read_text() + "0.1,0.9,\n")
    assert "its results belong to another arm file and another file of goals" in refusal("--effort", "20")
    assert output.read_bytes() == before
    for text in ("x,y\n1,2\n", '{"study": 1}\n', "no newline"):
        output.write_text(text)
        assert "it holds no results of a study" in refusal("--effort", "20")
        assert output.read_text() == text


def test_a_damaged_line_is_named(plan, tmp_path):
    output, words = tmp_path / "out.jsonl", ("--apart", "--effort", "20", "--output", str(tmp_path / "out.jsonl"))
    plan(*words)
    lines = output.read_bytes().splitlines(keepends=True)
    output.write_bytes(b"".join([*lines[:3], b'{"goal"\n', *lines[4:]]))
    assert "line 4 is damaged" in plan(*words)[2]
    output.write_bytes(b"".join([*lines, lines[-1]]))
    assert "line 14: there are more results than goals" in plan(*words)[2]
    assert "cannot be written" in plan(*words[:-1], str(tmp_path / "no" / "out.jsonl"))[2]


@pytest.mark.parametrize("apart", [("--apart", "--effort", "20"), ()])
def test_a_file_from_which_lines_are_missing_is_refused(plan, tmp_path, apart):
    output = tmp_path / "out.jsonl"
    plan(*apart, "--output", str(output))
    lines = output.read_bytes().splitlines(keepends=True)
    output.write_bytes(b"".join([*lines[:3], *lines[4:]]))
    code, _, err = plan(*apart, "--output", str(output))
    assert (code, "line 4 is of another goal, so lines are missing" in err) == (2, True)


def test_one_study_at_a_time_writes_a_file(plan, tmp_path):
    output, lock = tmp_path / "out.jsonl", tmp_path / ".out.jsonl.lock"
    held = lock_file(lock, "")
    code, _, err = plan("--apart", "--output", str(output))
    os.close(held)
    assert (code, f"end the other study, or name another file: process {os.getpid()}" in err) == (1, True)
    assert plan("--apart", "--effort", "20", "--output", str(output))[0] == 0
    assert not lock.exists()


def test_a_full_disk_is_told_with_what_to_do():
    with Path("/dev/full").open("wb", buffering=0) as file, pytest.raises(CommandFailed) as caught:
        write_line(Path("/dev/full"), file, {})
    assert "/dev/full cannot be written: No space left on device\nNext: free disk space; the same" in str(caught.value)


@pytest.mark.parametrize(
    "remove", [Path.unlink, lambda path: path.rename("moved"), lambda path: shutil.rmtree(path.parent)]
)
def test_a_file_that_is_gone_is_written_again(tmp_path, capsys, monkeypatch, remove):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "study" / "out.jsonl"
    path.parent.mkdir()
    with path.open("w+b") as file:
        write_line(path, file, {"a": 1})
        remove(path)
        write_line(path, file, {"a": 2})
        write_line(path, file, {"a": 3})
    assert path.read_text() == '{"a": 1}\n{"a": 2}\n{"a": 3}\n'
    assert capsys.readouterr().err.count("was deleted or moved: it is written again") == 1


def test_many_results_are_lines_as_they_come_and_few_are_a_table(plan, monkeypatch):
    few = plan("--apart", "--effort", "20")[1]
    monkeypatch.setattr(plan_module, "MOST_ROWS", 11)
    many = plan("--apart", "--effort", "20")[1]
    columns = [*("goal", "configuration", "position", "th", "[rad]", "error", "switches", "ms")]
    assert plan()[1].splitlines()[0].split() == columns
    assert many.splitlines()[0].split() == few.splitlines()[0].split()
    assert len(many.splitlines()) == len(few.splitlines()) == 13
    ends = [k for k, line in enumerate(plan()[1].splitlines()) if "switches in all" in line]
    assert ends == [4, 8, 12, 16], "the sentence on a trajectory follows its three goals"
