"""A commission that pages answer, and one that is killed."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import pytest
import yaml

from tests.commands.commissioning import Commission, record, right_answer
from tests.commission.rig import entries, write_arm
from tests.system.stack.processes import Process, commands
from tests.waiting import eventually

LABELS = ("1.1", "1.2")
FILE = {label: entries("one output", "both ends")[label] for label in LABELS}


def written(folder: Path, name: str) -> Path:
    """Writes an arm with two actuators of swapped outputs, and the truth beside it; returns the folder."""
    truth = copy.deepcopy(FILE)
    truth["1.1"]["output"], truth["1.2"]["output"] = 1, 0
    for path, wiring in ((folder / "arm.yaml", FILE), (folder / "true.yaml", truth)):
        arm = json.loads(write_arm(path, wiring).read_text()) | {"name": name, "planner_timeout": 10}
        arm["modules"][0]["count"] = 1
        path.write_text(
            json.dumps(arm | {"boards": {"heartbeat_timeout": 10}}, indent=1)
        )  # this machine may stand still
    return folder


def test_each_question_is_answered_once_by_whoever_comes_first(tmp_path: Path) -> None:
    it = Commission(written(tmp_path, "once"), "once", "--simulate", "--wired", "true.yaml")
    try:
        assert it.client.request("goal", {"waypoints": [{"position": [1, 0]}]})["reason"] == "commissioning"
        first = it.asked("ready to extend 1.1")
        assert it.answer(first, "x")["reason"] == "no-answer"
        assert it.answer(first, "", question=1)["reason"] == "question-not-open"
        assert it.answer(first, "", stamp=first["stamp"] - 60)["reason"] == "answer-too-late"
        assert it.client.request("answer", {"question": 1})["reason"] == "invalid-fields"
        assert it.states[-1]["commanded"] == [0, 0], "nothing has moved so far"
        assert it.answer(first, "")["accepted"]
        assert it.answer(first, "")["reason"] == "question-not-open", "one press, one motion"
        it.asked("1.1 was told to extend")
        assert it.states[-1]["commanded"] == [1, 0]
        it.type("1.2 e")  # at the terminal
        second = it.asked("ready to contract 1.1")
        assert it.client.request("stop")["accepted"]
        third = it.asked("reset")
        assert it.answer(second, "")["reason"] == "question-not-open", "a stop ends what was asked before it"
        assert it.answer(third, "r")["accepted"]
        it.says("ready to contract 1.1", "q")
    finally:
        it.close()
    assert it.process.returncode == 1
    assert record(tmp_path) == [("1.1", 1)]
    assert (it.states[-1]["mode"], it.states[-1]["reason"]) == ("unknown", "the commission has ended")
    ordered = [state["commanded"] for state in it.states if state["commanded"]]
    assert [1, 0] in ordered
    assert all(state in ([0, 0], [1, 0]) for state in ordered)


KILLS = [  # begin of a question at which the command is killed, and whether it has been answered then
    ("ready to extend 1.1", True),  # while it moves
    ("1.1 was told to extend", False),
    ("ready to contract 1.1", True),
    ("write it", False),
    ("write it", True),
]


@pytest.mark.parametrize("own", [True, False], ids=["own executor", "running executor"])
def test_a_commission_that_is_killed_goes_on_and_moves_nothing_by_itself(tmp_path: Path, own: bool) -> None:
    name, socket = f"killed-{own}".lower(), tmp_path / "executor.sock"
    file, words = written(tmp_path, name) / "arm.yaml", ["--simulate", "--wired", str(tmp_path / "true.yaml")]
    truth = yaml.safe_load((tmp_path / "true.yaml").read_text())
    executor, before = None if own else execute(file, socket, *words), file.read_bytes()
    for kill in (*KILLS, None, None):  # the last kill is before or after the proposal is written
        if executor is not None and file.read_bytes() != before:  # it was written: the executor needs the same file
            executor.end()
            executor, before = execute(file, socket, *words), file.read_bytes()
        it = Commission(tmp_path, name, *(words if own else ["--socket", str(socket)]))
        try:
            go_on(it, kill)
        finally:
            it.kill()
        if it.process.returncode == 0:
            break
    assert it.process.returncode == 0, it.told
    assert "all 2 actuators are commissioned" in it.told
    assert yaml.safe_load(file.read_text())["actuators"] == truth["actuators"]
    assert record(tmp_path) == [("1.1", 1), ("1.1", 0), ("1.2", 1), ("1.2", 0)]


def go_on(it: Commission, kill: tuple[str, bool] | None) -> None:
    """Answers up to the question of the kill, or to the end. Nothing moves but what an answer has allowed."""
    allowed: list[list[int] | None] = [None]
    while (state := it.next_question()) is not None:
        text, present = state["commission"]["question"]["text"], state["commanded"]
        allowed = [None, present] if allowed == [None] else allowed
        assert [one["commanded"] for one in it.states if one["commanded"] not in allowed] == [], text
        here = kill is not None and text.startswith(kill[0])
        if here and not kill[1]:
            return
        if text.startswith("ready"):
            allowed.append([bit ^ text.endswith(label) for bit, label in zip(present, LABELS, strict=True)])
        it.answer(state, right_answer(text, it.folder / "arm.yaml", it.folder / "true.yaml"))
        if here:
            return


def execute(file: Path, socket: Path, *words: str) -> Process:
    process = commands().start(["execute", str(file), "--socket", str(socket), *words], file.with_suffix(".log"), {})
    eventually(socket.is_socket)
    return process
