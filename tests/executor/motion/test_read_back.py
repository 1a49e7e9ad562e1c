"""What is done, was read back: a goal ends when end-stops or outputs, read back, tell that it has moved the arm."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from hyperbit.controller.program import Ended, Reset, Snapshot, unpack
from hyperbit.drivers.canopen.wiring import NodeWiring
from hyperbit.drivers.simulation.variants import STANDARD
from tests.executor import rig
from tests.executor.world import World, ready

BISTABLE: dict[str, Any] = {"output_off": True, "pulse": 0.05}
ALL = 0b111111


def test_a_goal_is_done_when_its_outputs_were_read_back() -> None:
    arm = rig.ready(sensed=0)
    arm.master.unread = 0b1
    arm.run(0b000001)
    arm.go(1.0)
    assert arm.results == []
    arm.master.unread = 0
    arm.go(0.1)
    assert arm.results == [(1, "done")]


def test_a_missed_pulse_is_given_again_before_the_goal_is_done() -> None:
    arm = rig.ready(sensed=0, channel=BISTABLE)
    arm.run(0b000001)
    arm.go(1.0)
    arm.master.unread = 0b000010
    arm.run(0b000011)
    arm.go(0.06)  # the pulse has ended
    before = list(arm.switched)
    arm.master.missed = 0b000010
    arm.go(1.0)
    assert arm.switched == [*before, 0b000010]
    assert arm.results[1:] == [(2, "done")]
    assert unpack(arm.snapshot.homing) == 0


def test_a_missed_pulse_that_another_one_follows_at_once_is_not_given_again() -> None:
    arm = rig.ready(sensed=0, channel=BISTABLE)
    arm.run(0b000010)
    arm.go(1.0)
    arm.run(0b000000)
    arm.go()
    before = list(arm.switched)
    arm.master.missed = 0b000010  # of the pulse before, which was reversed
    arm.go(1.0)
    assert arm.switched == before
    assert unpack(arm.snapshot.homing) == 0


def test_an_actuator_whose_pulse_was_missed_is_unknown_after_the_goal() -> None:
    arm = rig.ready(sensed=0, channel=BISTABLE)
    arm.run(0b000001)
    arm.go(1.0)
    arm.master.missed = 0b000001
    arm.go(0.1)
    assert unpack(arm.snapshot.homing) == 0b000001
    assert "unknown-position" in {fault.code for fault in arm.snapshot.faults}


@pytest.mark.parametrize("fields", [{"sensed": 0}, {"sensed": 0, "channel": BISTABLE}])
def test_a_goal_on_a_board_that_is_not_verified_says_so(fields: dict[str, Any]) -> None:
    world = ready(nodes=(NodeWiring("can0", 1, verify=False),), **fields)
    world.run(1, 0b001000)
    world.go(2.0)
    world.run(2, 0b001001)
    world.go(2.0)
    ended = world.of(Ended)
    assert [e.status for e in ended] == ["done", "done"]
    assert ended[-1].verified is False


def test_a_goal_whose_switches_were_read_back_is_verified() -> None:
    world = ready(sensed=0)
    world.run(1, 0b001001)
    world.go(2.0)
    assert world.last(Ended).verified is True


def deaf(world: World, board: str = "can0/1") -> None:
    world.boards.board(board).pdos.receive = lambda cob_id, data, now: False


def test_a_goal_that_a_board_does_not_follow_is_not_done() -> None:
    world = ready(sensed=0)
    deaf(world)
    world.run(1, ALL)
    world.go(2.0)
    assert [e.status for e in world.of(Ended)] == ["aborted"]
    assert [fault.code for fault in world.last(Snapshot).faults] == ["not-switched"]


def test_pulses_that_a_board_did_not_get_leave_its_actuators_unknown_after_a_reset() -> None:
    world = ready(sensed=0, channel=BISTABLE)
    world.run(1, 0)
    world.go(2.0)
    board = world.boards.board("can0/1")
    receive, board.pdos.receive = board.pdos.receive, lambda cob_id, data, now: False
    world.run(2, 0b000001)
    world.go(2.0)
    board.pdos.receive = receive
    world.send(Reset(1, world.epoch))
    world.go(2.0)
    snapshot = world.last(Snapshot)
    assert (snapshot.mode, unpack(snapshot.known)) == ("ready", ALL & ~0b000001)


@pytest.mark.parametrize("verify", [True, False])
def test_a_board_that_was_unplugged_during_its_pulse_leaves_its_actuators_unknown(verify: bool) -> None:
    world = ready(nodes=(NodeWiring("can0", 1, verify=verify),), sensed=0, channel=BISTABLE)
    world.run(1, 0)
    world.go(2.0)
    world.fault("silence", "can0/1")  # neither hears nor sends; it keeps its supply
    world.run(2, 0b000001)
    world.go(2.0)
    assert world.last(Ended).status == ("aborted" if verify else "done")
    world.fault("unsilence", "can0/1")
    world.go(4.0)
    snapshot = world.last(Snapshot)
    assert (snapshot.mode, unpack(snapshot.known)) == ("ready", ALL & ~0b000001)


def test_a_snapshot_in_which_a_board_is_unknown_tells_the_fault() -> None:
    slow = replace(STANDARD, answer_delay=0.03)
    world = ready(variants={"can0/1": slow}, sensed=0, channel={"output_off": True, "pulse": 0.02})
    world.run(1, ALL)  # each pulse is over before it is read back; the third one is a fault
    world.go(3.0)
    assert [fault.code for fault in world.last(Snapshot).faults] == ["not-verified"]
    without = [told for told in world.of(Snapshot) if ALL & ~(unpack(told.known) | unpack(told.homing))]
    assert {told.mode for told in without} <= {"starting", "fault"}
