"""The arm at a snapshot: what it keeps of the snapshot before, its mode, and the sentence on the program before."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.planning.core.arm import ArmState
from hyperbit.controller.program import Fault
from tests.planning.rig.played_core import PlayedCore


@pytest.fixture
def played(small: Arm) -> PlayedCore:
    played = PlayedCore(small)
    played.show()
    return played


def computed(state: ArmState | None) -> dict[str, Any]:
    return {name: getattr(state, name) for name, value in vars(ArmState).items() if isinstance(value, cached_property)}


def test_a_snapshot_without_a_change_of_actuators_is_not_computed_again(played: PlayedCore) -> None:
    before = computed(played.view.state)
    played.show(faults=(Fault("a", "b", "c"),), reason="holding still", epoch=9)
    assert played.view.state is not None
    assert played.view.state.snapshot.epoch == 9
    after = computed(played.view.state)
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
def test_a_change_of_actuators_is_computed_anew(played: PlayedCore, change: dict[str, Any]) -> None:
    computed(played.view.state)
    played.show(**change)
    later = played.view.state
    assert later is not None
    fresh = computed(ArmState(played.arm.manipulator, later.snapshot))
    for name, value in computed(later).items():
        np.testing.assert_equal(value, fresh[name], name)


def test_the_sentence_on_a_program_ends_with_a_fault_before_the_arm_is_ready_again(played: PlayedCore) -> None:
    for mode in ("executing", "fault", "starting"):
        played.show(mode=mode, reason=mode)
        if mode == "executing":
            played.view.ended("holding; goal a was aborted")
    played.show(mode="ready", reason="holding what the boards measured")
    assert played.view.mode() == ("ready", "holding what the boards measured")
    played.show(mode="starting", reason="booting")
    played.view.ended("holding; goal b was aborted")  # its result was owed
    played.show(mode="ready", reason="holding what the boards measured")
    assert played.view.mode() == ("ready", "holding what the boards measured")


def test_a_program_that_ended_before_the_first_snapshot_gives_no_reason(played: PlayedCore) -> None:
    played.view.lost("the executor closed the connection")
    played.view.ended("holding; goal a was reached")  # long ago, perhaps before a fault
    played.show(mode="ready", reason="holding what the boards measured")
    assert played.view.mode() == ("ready", "holding what the boards measured")


def test_the_sentence_on_a_program_stays_until_the_executor_gives_another_reason(played: PlayedCore) -> None:
    played.show(mode="executing", reason="goal a")
    played.view.ended("holding; goal a was reached")
    for _ in range(2):
        played.show(mode="ready", reason="holding; goal a is done")
        assert played.view.mode() == ("ready", "holding; goal a was reached")
    played.show(mode="ready", reason="canceled")
    assert played.view.mode() == ("ready", "canceled")
