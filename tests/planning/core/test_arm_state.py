"""The mode of the arm at a snapshot, and the sentence on the program before."""

from __future__ import annotations

import pytest

from hyperbit.controller.arm.arm import Arm
from tests.planning.rig.played_core import PlayedCore


@pytest.fixture
def played(small: Arm) -> PlayedCore:
    played = PlayedCore(small)
    played.show()
    return played


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
