"""The arm at a snapshot, and the sentence on its program; prepared searches; measured tips and their bias."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import msgspec
import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.planning.core.arm import ArmState, ExecutorView
from hyperbit.controller.planning.core.goals import IDLE, REHEARSE_EVERY, REHEARSE_FOR
from hyperbit.controller.planning.core.tasks import PrepareSearch
from hyperbit.controller.program import Fault, Program, Snapshot
from hyperbit.controller.refusals.reasons import Reason
from tests.planning.conftest import HOLD
from tests.planning.rig.desk import Desk

NONE, ALL = bytes(2), b"\xff\x0f"


class View(ExecutorView):
    """The planner's view of an executor that the test plays."""

    def __init__(self, arm: Arm) -> None:
        super().__init__(arm.manipulator, arm.travel_time, pace_of(arm.settings))
        self._told = Snapshot(0.0, "ready", "holding", 1, NONE, NONE, ALL, ALL, NONE, False, 0.0, -1, -1, ())
        self.show()

    def show(self, **changes: Any) -> None:
        """Takes a snapshot with changes; new outputs are measured, too."""
        changes.setdefault("measured", changes.get("outputs", self._told.measured))
        self._told = msgspec.structs.replace(self._told, **changes)
        self.receive_snapshot(self._told)


@pytest.fixture
def view(small: Arm) -> View:
    return View(small)


def computed(state: ArmState | None) -> dict[str, Any]:
    return {name: getattr(state, name) for name, value in vars(ArmState).items() if isinstance(value, cached_property)}


def test_a_snapshot_without_a_change_of_actuators_is_not_computed_again(view: View) -> None:
    before = computed(view.state)
    view.show(faults=(Fault("a", "b", "c"),), reason="holding still", epoch=9)
    assert view.state is not None
    assert view.state.snapshot.epoch == 9
    after = computed(view.state)
    assert all(after[name] is before[name] for name in before)


@pytest.mark.parametrize(
    "change",
    [
        {"outputs": b"\x07\x00"},
        {"measured": b"\x07\x00"},
        {"known": b"\xfe\x0f"},
        {"sensed": b"\x00\x00"},
        {"known": b"\xfe\x0f", "homing": b"\x01\x00"},
        {"locked": b"\x01\x00"},
        {"unread": b"\x01\x00"},
        {"outputs": b"\x07\x00", "measured": b"\x00\x00", "moving": True},
    ],
    ids=lambda change: ", ".join(change),
)
def test_a_change_of_actuators_is_computed_anew(view: View, change: dict[str, Any]) -> None:
    computed(view.state)
    view.show(**change)
    later = view.state
    assert later is not None
    fresh = computed(ArmState(view.manipulator, later.snapshot))
    for name, value in computed(later).items():
        np.testing.assert_equal(value, fresh[name], name)


def test_an_end_that_was_owed_gives_no_reason(view: View) -> None:
    view.show(mode="starting", reason="booting")
    view.ended("holding; goal a was aborted")
    view.show(mode="ready", reason="holding what the boards measured")
    assert view.mode() == ("ready", "holding what the boards measured")
    view.lost("the executor closed the connection")
    view.ended("holding; goal b was reached")  # long ago, perhaps before a fault
    view.show()
    assert view.mode() == ("ready", "holding what the boards measured")


def test_a_search_is_prepared_after_a_pause_and_rehearsed_for_a_while(desk: Desk) -> None:
    desk.goal((1, 2, 0, 0))
    desk.executor.decline(desk.executor.expect(Program), Reason.OVERTAKEN)
    desk.held = {PrepareSearch}
    desk.started.clear()
    desk.pass_time(IDLE - 0.001)
    assert desk.started[PrepareSearch] == 0
    desk.pass_time(0.5)
    assert desk.started[PrepareSearch] == 1, "one at a time"
    desk.release(PrepareSearch)
    desk.pass_time(10 * REHEARSE_EVERY)
    assert desk.started[PrepareSearch] in range(9, 13)
    desk.pass_time(REHEARSE_FOR)
    desk.started.clear()
    desk.pass_time(1.0)
    assert desk.started[PrepareSearch] == 0, "the arm is where it was"


OFFSET = np.array([0.002, -0.001])


@pytest.fixture
def tracked(make_tracked: Callable[[], Desk]) -> Desk:
    return make_tracked()


def measure(desk: Desk, age: float = 0.01, **fields: Any) -> None:
    desk.measure((np.array(desk.tip(0, 0, 0, 0)) + OFFSET).tolist(), age, **fields)


def test_the_bias_is_measured_minus_computed_tip(tracked: Desk) -> None:
    status = tracked.diagnostics()["tracker"]
    assert (tracked.state()["bias"], status["received"], status["estimate"]) == ([0, 0], 0, None)
    for _ in range(50):
        tracked.pass_time(0.05)
        measure(tracked)
    assert tracked.state()["bias"] == pytest.approx(OFFSET, abs=1e-4)
    status = tracked.diagnostics()["tracker"]
    assert (status["accepted"], status["refused"], status["last_refusal"]) == (50, 0, None)
    assert status["estimate"] == pytest.approx(OFFSET, abs=1e-4)
    assert 0 < status["deviation"] < 1e-4
    tracked.pass_time(HOLD + 1)
    assert tracked.state()["bias"] == [0, 0]


@pytest.mark.parametrize(
    ("changes", "fields", "refused"),
    [
        ({}, {"age": 1.1}, "stamp: 1.100 s old on arrival"),
        ({}, {"age": -0.1}, "stamp: 0.100 s in the future"),
        ({}, {"position": [1.0]}, ""),
        ({}, {"position": [9.0, 9.0]}, ""),
        ({"moving": True}, {}, "stamp: the arm was moving, or not yet settled"),
        ({"free_in": -0.005}, {}, "stamp: the arm was moving, or not yet settled"),
        ({"mode": "fault"}, {}, "the arm is fault, or its configuration is not known"),
        ({"known": NONE}, {}, "the arm is ready, or its configuration is not known"),
        (None, {}, "the arm is fault, or its configuration is not known"),
    ],
)
def test_a_tip_that_cannot_be_used_is_refused(
    tracked: Desk, changes: dict[str, Any] | None, fields: dict[str, Any], refused: str
) -> None:
    if changes is None:
        tracked.drop()
    elif "free_in" in changes:
        tracked.executor.show(free_at=tracked.now + changes["free_in"])
    else:
        tracked.executor.show(**changes)
    at = fields.pop("position", None)
    measure(tracked, **fields) if at is None else tracked.measure(at)
    status = tracked.diagnostics()["tracker"]
    assert (status["received"], status["accepted"], status["refused"]) == (1, 0, 1)
    assert status["last_refusal"].startswith(refused)
