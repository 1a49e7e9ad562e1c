"""Goals that are put, sent at once or in a flood: each has one answer and one outcome."""

import itertools
import json
import threading
import time
from contextlib import ExitStack

import numpy as np
import pytest
import zenoh

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.planning.ledger_file import read
from hyperbit.controller.refusals import codes
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.observer import Observer
from tests.system.stack.places import LEFT, MIDDLE, RIGHT, tip
from tests.system.stack.system import System
from tests.waiting import PATIENCE, eventually

pytestmark = pytest.mark.buses("virtual")


def test_a_goal_can_be_put_and_its_refusal_is_published(
    client: Observer, system: System, boards: Simulation, arm: Arm, stack: ExitStack
) -> None:
    session, prefix = stack.enter_context(system.session()), f"hyperbit/{system.name}"
    client.accepted.append("a")
    client.sent["a"] = time.time()
    session.put(f"{prefix}/goal", json.dumps({"id": "a", "waypoints": [{"position": MIDDLE}]}))
    assert client.result("a")["status"] == "succeeded"
    assert np.linalg.norm(tip(boards, arm) - MIDDLE) <= arm.tolerance
    session.put(f"{prefix}/goal", json.dumps({"id": "b", "waypoints": [{"position": [9, 9]}]}))
    result = client.result("b")
    assert (result["status"], result["code"]) == ("refused", codes.GOAL_TOLERANCE_VIOLATED)
    assert result["reason"] == "beyond-length"
    session.put(f"{prefix}/goal", b"\xff")
    eventually(lambda: client.results(None))
    session.put(f"{prefix}/stop", b"")
    client.wait_now("stopped")
    session.put(f"{prefix}/goal", json.dumps({"id": "c", "waypoints": [{"position": MIDDLE}]}))
    assert client.result("c")["reason"] == "arm-stopped"
    client.reset()


def test_two_goals_at_once_have_one_outcome_each(client: Observer, system: System, stack: ExitStack) -> None:
    goals, answers, sent = {"a": MIDDLE, "b": RIGHT}, dict[str, list[bool]](), time.time()
    session, key = stack.enter_context(system.session()), f"hyperbit/{system.name}/goal"
    asked = {
        name: session.get(key, payload=json.dumps({"id": name, "waypoints": [{"position": p}]}), timeout=PATIENCE)
        for name, p in goals.items()
    }
    for name, replies in asked.items():
        answers[name] = [json.loads(reply.ok.payload.to_bytes())["accepted"] for reply in replies]
    client.accepted += goals
    client.sent |= dict.fromkeys(goals, sent)
    assert list(answers.values()) == [[True], [True]]
    ends = {name: client.result(name)["status"] for name in goals}
    assert "succeeded" in ends.values()
    assert set(ends.values()) <= {"succeeded", "replaced"}
    client.wait_now("ready")
    assert [len(client.results(name)) for name in goals] == [1, 1]


def test_a_later_client_is_as_good_as_the_first_and_all_is_in_the_ledger(client: Observer, system: System) -> None:
    with system.client() as other:
        client.move(MIDDLE, goal="first")
        other.move(LEFT, goal="second")
        assert client.result("second") == other.result("second")
        assert other.result("first") == client.result("first")
    client.accepted.append("second")
    client.sent |= other.sent
    ends = [("second", "succeeded"), ("first", "succeeded")]
    eventually(lambda: [(goal["id"], goal["status"]) for goal in read(system.ledger)[1]][:2] == ends)
    eventually(lambda: system.counts() == system.boards.switches().tolist())


def test_forty_waypoints_under_three_floods_have_forty_feedbacks_and_one_result(
    client: Observer, system: System, stack: ExitStack
) -> None:
    """Among obstacles, even distant ones, no stage is skipped, however late it is."""
    assert client.ask("obstacles", regions=[{"disc": {"centre": [9, 9], "radius": 0.1}}])["accepted"]
    over, sessions = threading.Event(), [stack.enter_context(system.session()) for _ in range(3)]

    def flood(session: zenoh.Session, key: str, payload: bytes) -> None:
        for k in itertools.count():
            if over.is_set():
                return
            session.put(f"hyperbit/{system.name}/{key}", payload)
            time.sleep(0.0 if k % 10 else 0.001)

    bad = [("goal", b"{"), ("setpoint", b'{"position": [NaN, 1]}'), ("goal", b'{"waypoints": []}')]
    floods = [threading.Thread(target=flood, args=(session, *it)) for session, it in zip(sessions, bad, strict=True)]
    for thread in floods:
        thread.start()
    try:
        points = [(LEFT, MIDDLE)[k % 2] for k in range(40)]
        answer = client.goal(*points, times=[0.12 * k for k in range(40)], id="a")
        assert answer["accepted"], answer
        assert client.result("a")["status"] == "succeeded"
    finally:
        over.set()
        for thread in floods:
            thread.join()
    assert [feedback["waypoint"] for feedback in client.last_feedback("a", 39)] == list(range(40))
