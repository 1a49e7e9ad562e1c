"""Invalid requests on every key of a running arm: each gets one answer, and nothing moves."""

import json
import random
from contextlib import ExitStack
from typing import Any

import pytest

from hyperbit.controller.arm.arm import Arm
from tests import told
from tests.fuzz.mutations import mutated
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import MIDDLE, RIGHT
from tests.system.stack.system import System
from tests.waiting import PATIENCE

pytestmark = pytest.mark.buses("virtual")

EACH = 150
RIGHT_ONES: dict[str, list[Any]] = {
    "goal": [told.LINE, told.CONFIGURATIONS],
    "plan": [told.LINE],
    "jog": [{"actuators": {"99.left": "extended"}}],
    "degrade": [{"actuator": "99.left", "state": 0}],
    "obstacles": [*({"regions": [*told.OBSTACLES["regions"], region]} for region in ({}, {"disc": {}}))],
    "setpoint": [{**told.SETPOINT, "stamp": 1.0}],
}


def spoiled(key: str, chance: random.Random) -> bytes:
    right = RIGHT_ONES[key]
    data = mutated(json.dumps(chance.choice(right)).encode(), chance)
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        return data
    return json.dumps({**value, "velocity": 1}).encode() if isinstance(value, dict) else data


@pytest.mark.parametrize("key", [key for key in RIGHT_ONES if key != "setpoint"])
def test_spoiled_requests_are_answered_and_move_nothing(
    client: Observer, system: System, arm: Arm, motions: Motions, stack: ExitStack, key: str
) -> None:
    client.move(MIDDLE)
    motions.clear()
    session, chance = stack.enter_context(system.session()), random.Random(key)
    asked = []
    for _ in range(EACH):
        payload = spoiled(key, chance)
        replies = session.get(f"hyperbit/{system.name}/{key}", payload=payload, timeout=PATIENCE)
        asked.append((payload, [json.loads(reply.ok.payload.to_bytes()) for reply in replies]))
    for payload, answers in asked:
        assert len(answers) == 1, payload
        assert not answers[0]["accepted"], (payload, answers)
        assert 0 < len(answers[0]["message"]) < 5_000
        assert "internal error" not in answers[0]["message"], payload
    assert client.wait_now("ready")["faults"] == []
    assert motions.still()
    client.move(RIGHT, goal="after")


def test_spoiled_puts_on_all_keys_disturb_no_goal(client: Observer, system: System, stack: ExitStack) -> None:
    session, chance = stack.enter_context(system.session()), random.Random(1)
    client.move(MIDDLE)
    told = len(client.heard["result"])
    for _ in range(EACH):
        for key in RIGHT_ONES:
            session.put(f"hyperbit/{system.name}/{key}", spoiled(key, chance))
    client.move(RIGHT, goal="after")
    assert {result["status"] for result in client.heard["result"][told:]} <= {"refused", "succeeded"}
    assert client.wait_now("ready")["faults"] == []
