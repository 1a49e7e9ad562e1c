"""Actuators that are held: found stuck, asked for, or declared; nothing moves by that, and goals go on."""

import threading
from typing import Any

import numpy as np
import pytest

from controller.daemon.degradation import Degradation
from controller.daemon.events import Cancel, Degrade, Reset, Stop
from controller.daemon.loop import PERIOD, RETRY
from controller.daemon.state import state_payload
from controller.manipulator.held import Held
from controller.motion.degrade import DegradeMessage
from drivers.faults import Fault
from tests.daemon.rig import ARM, LOST, A, B, Rig, states

LABELS = list(ARM.actuators)
STUCK = Fault("stuck", "1.left (can0/1 output 0)", "actuator 1.left is stuck")


class Shop:
    """A rig whose planning takes until it is let go on."""

    def __init__(self, continues: bool = True, held: Held | None = None) -> None:
        self.prepared: list[list[int]] = []
        self.open, self.broken = threading.Event(), False
        self.open.set()
        self.rig = Rig(degradation=Degradation(ARM, held, continues, self.prepare))
        self.rig.boards.returned = True
        self.rig.go()

    def prepare(self, held: Held) -> None:
        assert self.open.wait(30)
        if self.broken:
            raise RuntimeError("no memory")
        self.prepared.append(held.tolist())

    def ask(self, label: str, state: int | None) -> dict[str, Any]:
        rig = self.rig
        answers = list[dict[str, Any]]()
        rig.loop.inbox.hand_over(
            Degrade(rig.arrival(), lambda p: answers.append(dict(p)), DegradeMessage(label, state))
        )
        rig.go()
        return answers[0]

    def planned(self) -> None:
        """Waits for planning to end, and lets the loop hear of it."""
        self.open.set()
        for thread in threading.enumerate():
            if thread.name == "degradation":
                thread.join(30)
        self.rig.go(2 * PERIOD)

    @property
    def state(self) -> dict[str, Any]:
        return dict(state_payload(ARM, self.rig.snapshots[-1]))


def held(**states: int) -> list[int]:
    return [states.get(label.replace("1.", "one_"), -1) for label in LABELS]


@pytest.fixture
def shop() -> Shop:
    return Shop()


def stick(shop: Shop) -> None:
    """Has 1.left stuck contracted on the way to A, and time pass until planning is made ready."""
    shop.open.clear()
    shop.rig.boards.stuck = True
    shop.rig.run("a", A, B)
    shop.rig.go(0.2)
    shop.rig.boards.stuck = False
    assert (shop.rig.loop.mode, shop.rig.results) == ("fault", [("a", "aborted")])
    shop.rig.go(RETRY + 4 * PERIOD)


def test_the_arm_goes_on_without_an_actuator_that_is_found_stuck(shop: Shop) -> None:
    stick(shop)
    rig = shop.rig
    assert (rig.loop.mode, rig.loop.reason) == (
        "starting",
        "planning is made ready to go on, held: 1.left (contracted)",
    )
    rig.run("early", B)
    rig.go(0.5)
    assert rig.replies[-1][1]["accepted"] is False
    shop.planned()
    assert (rig.loop.mode, rig.loop.reason) == ("ready", "holding what the boards measured, held: 1.left (contracted)")
    assert shop.prepared == [held(one_left=0)]
    assert rig.boards.held == held(one_left=0)
    assert shop.state["degraded"] == [{"actuator": "1.left", "state": 0}]
    assert [(fault["code"], fault["source"]) for fault in shop.state["faults"]] == [("degraded", "1.left")]
    assert rig.boards.commits == [states(A)], "nothing moves by itself"
    rig.run("b", B)
    rig.go(0.5)
    assert rig.results[-1] == ("b", "succeeded")


def test_the_arm_holds_until_reset_and_uses_the_actuator_again_where_the_file_does_not_say_continue() -> None:
    shop = Shop(continues=False)
    rig = shop.rig
    rig.boards.stuck = True
    rig.run("a", A)
    rig.go(5 * RETRY)
    assert rig.loop.mode == "fault"
    rig.request(Reset)
    rig.go(4 * PERIOD)
    assert (rig.loop.mode, shop.prepared, shop.state["degraded"]) == ("ready", [], [])


def test_what_needs_a_look_beside_it_waits_for_reset_and_then_it_is_held(shop: Shop) -> None:
    rig = shop.rig
    rig.boards.fail(STUCK)
    rig.boards.fail(Fault("emergency", "can0/3", "look"))
    rig.go(5 * RETRY)
    assert (rig.loop.mode, shop.prepared) == ("fault", [])
    rig.request(Reset)
    rig.go(4 * PERIOD)
    shop.planned()
    assert (rig.loop.mode, shop.prepared) == ("ready", [held(one_left=0)])


def test_actuators_on_their_way_are_waited_for(shop: Shop) -> None:
    rig = shop.rig
    rig.boards.slow = True
    rig.run("a", A)
    rig.go(0.05)
    starts = rig.boards.starts
    rig.boards.fail(STUCK)
    rig.go(5 * RETRY)
    assert (rig.loop.mode, rig.boards.starts) == ("fault", starts)
    rig.boards.slow = False
    rig.go(2 * RETRY)
    shop.planned()
    assert rig.loop.mode == "ready"
    assert shop.prepared == [held(one_left=states(A)[0])], "in the state measured at last"


def test_one_more_that_is_stuck_is_held_too(shop: Shop) -> None:
    rig = shop.rig
    for fault in (STUCK, Fault("stuck", "2.right (can0/2 output 2)", "stuck")):
        rig.boards.fail(fault)
        rig.go(RETRY + 4 * PERIOD)
        shop.planned()
    assert rig.loop.mode == "ready"
    assert shop.prepared == [held(one_left=0), [0, -1, -1, -1, -1, 0]]


def test_a_board_that_is_lost_while_planning_is_made_ready_is_a_fault_and_both_are_got_over(shop: Shop) -> None:
    stick(shop)
    rig = shop.rig
    rig.boards.returned = False
    rig.boards.fail(LOST)
    rig.go()
    assert rig.loop.mode == "fault"
    shop.planned()
    assert rig.loop.mode == "fault", "planning alone does not end it"
    rig.boards.returned = True
    rig.go(2 * RETRY)
    assert (rig.loop.mode, shop.prepared) == ("ready", [held(one_left=0)])


def test_planning_that_fails_is_a_fault_and_tried_again_with_the_reset(shop: Shop) -> None:
    shop.broken = True
    stick(shop)
    shop.planned()
    assert shop.rig.loop.mode == "fault"
    assert "no memory" in shop.rig.loop.reason
    shop.broken = False
    shop.rig.request(Reset)
    shop.rig.go(4 * PERIOD)
    shop.planned()
    assert (shop.rig.loop.mode, shop.prepared) == ("ready", [held(one_left=0)])


def test_a_request_holds_an_actuator_and_another_frees_it(shop: Shop) -> None:
    rig = shop.rig
    planning = rig.goal("old", A)
    assert shop.ask("1.left", 0) == {"accepted": True, "code": 0, "message": "held: 1.left (contracted)"}
    shop.planned()
    assert (rig.loop.mode, shop.prepared, rig.boards.commits) == ("ready", [held(one_left=0)], [])
    rig.loop.inbox.hand_over(planning)
    rig.go(0.5)
    assert "before it began" in rig.replies[-1][1]["message"], "it was planned with the actuator"
    assert shop.ask("1.left", None)["message"] == "no actuator held"
    shop.planned()
    assert (rig.loop.mode, rig.loop.reason) == ("ready", "holding what the boards measured")
    assert (shop.prepared[-1], rig.boards.commits, shop.state["degraded"]) == ([-1] * 6, [], [])


def test_what_is_held_changes_once_more_while_planning_is_made_ready(shop: Shop) -> None:
    shop.open.clear()
    assert shop.ask("1.left", 0)["accepted"]
    assert shop.ask("2.right", 0)["accepted"]
    shop.planned()
    shop.planned()
    assert (shop.rig.loop.mode, shop.prepared) == ("ready", [held(one_left=0), [0, -1, -1, -1, -1, 0]])


def test_what_is_held_changes_back_while_planning_is_made_ready(shop: Shop) -> None:
    shop.open.clear()
    assert shop.ask("1.left", 0)["accepted"]
    assert shop.ask("1.left", None)["accepted"]
    assert shop.rig.loop.mode == "starting", "planning is about to go by what was held"
    shop.planned()
    shop.planned()
    assert (shop.rig.loop.mode, shop.prepared) == ("ready", [held(one_left=0), [-1] * 6])


def test_a_goal_that_runs_is_not_disturbed_nor_actuators_on_their_way(shop: Shop) -> None:
    rig = shop.rig
    rig.run("a", A, B)
    rig.go(2 * PERIOD)
    answer = shop.ask("1.left", 0)
    assert (answer["accepted"], "the arm is executing" in answer["message"]) == (False, True)
    rig.request(Cancel)
    rig.go()
    assert (rig.loop.mode, shop.ask("1.left", 0)["accepted"]) == ("ready", False)
    assert shop.prepared == []
    rig.go(0.5)
    assert shop.ask("1.left", states(A)[0])["accepted"]


def test_a_request_in_a_fault_counts_from_the_reset_on() -> None:
    shop = Shop(continues=False)
    shop.rig.boards.fail(STUCK)
    shop.rig.go()
    assert shop.ask("1.left", 0)["message"] == "held: 1.left (contracted), from the reset on"
    assert (shop.rig.loop.mode, shop.prepared) == ("fault", [])
    shop.rig.request(Reset)
    shop.rig.go(4 * PERIOD)
    shop.planned()
    assert (shop.rig.loop.mode, shop.prepared) == ("ready", [held(one_left=0)])


def test_a_stop_while_planning_is_made_ready_stays(shop: Shop) -> None:
    stick(shop)
    shop.rig.request(Stop)
    shop.rig.go()
    shop.planned()
    assert shop.rig.loop.mode == "stopped"
    shop.rig.request(Reset)
    shop.rig.go(4 * PERIOD)
    assert (shop.rig.loop.mode, shop.prepared) == ("ready", [held(one_left=0)])


@pytest.mark.parametrize(
    ("label", "state", "named"),
    [
        ("3.left", 0, "actuator: '3.left' is none of this arm's, which are 1.left to 2.right"),
        ("\ud800", 0, "actuator: '\\ud800' is none of this arm's, which are 1.left to 2.right"),
        ("1.left", 1, "state: the end-stop of 1.left reads contracted"),
    ],
)
def test_a_request_that_cannot_be_is_refused_in_words(shop: Shop, label: str, state: int, named: str) -> None:
    assert shop.ask(label, state)["message"] == named
    assert (shop.rig.loop.mode, shop.prepared, shop.state["degraded"]) == ("ready", [], [])


def test_what_an_end_stop_reads_comes_before_what_the_file_declares() -> None:
    shop = Shop(held=np.array(held(one_left=1), dtype=np.int8))
    shop.planned()
    assert (shop.rig.loop.mode, shop.prepared) == ("ready", [held(one_left=0)])


def test_what_is_declared_is_planned_with_from_the_start() -> None:
    shop = Shop(held=np.array(held(one_left=0), dtype=np.int8))
    assert (shop.rig.loop.mode, shop.prepared) == ("ready", [])
    assert shop.state["degraded"] == [{"actuator": "1.left", "state": 0}]


def test_an_actuator_that_came_free_is_held_where_it_went_once_somebody_had_a_look(shop: Shop) -> None:
    rig = shop.rig
    assert shop.ask("1.left", 0)["accepted"]
    shop.planned()
    rig.boards.states[0] = 1
    rig.boards.fail(Fault("unexpected-motion", "1.left (can0/1 output 0)", "it moved"))
    rig.go(3 * RETRY)
    assert rig.loop.mode == "fault"
    rig.request(Reset)
    rig.go(4 * PERIOD)
    shop.planned()
    assert (rig.loop.mode, shop.prepared) == ("ready", [held(one_left=0), held(one_left=1)])
