"""A short run of each reader, and of what an intruder may do; `make fuzz` makes longer ones."""

from __future__ import annotations

import logging

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hyperbit.controller.program import Program, Setpoint, pack
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.fuzz.executor import FOUND, SIZE, Act, Attack, Firmware, frames, lives, stages
from tests.fuzz.judge import Flood, Moved
from tests.fuzz.readers import MOST_LINES, READERS, Quiet, built, mutation, samples
from tests.fuzz.world import World

MUTATIONS = {"arm": 40, "recording": 20}  # of a reader, 100 of others
PROGRAM = Program(1, 0, b"\0", 0.0, stages(1, 3, 7), True, False, "goal")
QUICK = settings(suppress_health_check=[HealthCheck.too_slow], max_examples=20)


@pytest.mark.parametrize("name", READERS)
def test_no_input_ends_a_reader(name: str) -> None:
    take = built(name)
    for key, data in samples(name):
        take(key, data)
    for number in range(MUTATIONS.get(name, 100)):
        take(*mutation(name, number))


def test_nothing_that_clients_and_an_intruder_do_moves_the_arm() -> None:
    attack = Attack()
    for acts in FOUND:
        attack(acts)

    @QUICK
    @given(lives)
    def run(acts: list[Act]) -> None:
        attack(acts)

    run()


def test_no_frame_harms_a_board() -> None:
    firmware = Firmware()

    @settings(QUICK, max_examples=100)
    @given(st.lists(frames, max_size=60), st.booleans())
    def run(given: list[can.Message], started: bool) -> None:
        firmware(given, started=started)

    run()


def test_a_traceback_and_a_flood_of_lines_are_found() -> None:
    log = logging.getLogger("reader")

    def take(key: str, data: bytes) -> None:
        log.warning("%s cannot be read", key, exc_info=ValueError("odd") if data == b"odd" else None)

    with pytest.raises(AssertionError, match="ValueError: odd"):
        Quiet(take)("state", b"odd")
    attack = Quiet(take)
    for _ in range(MOST_LINES):
        attack("state", b"{}")
    with pytest.raises(Flood, match="the last: state cannot be read"):
        attack("state", b"{}")


def test_frames_and_states_that_no_goal_asks_for_are_found() -> None:
    attack = Attack()
    world = attack.world
    with pytest.raises(Moved, match="080h  was sent in mode ready without a goal"):
        world.judge.judge(Frame(cia301.SYNC), world.core, lambda node: 0)
    attack.packet(PROGRAM)
    world.judge.judge(Frame(cia301.RPDO1 + 5, bytes([0b001000])), world.core, lambda node: 0)
    with pytest.raises(Moved, match="was switched"):
        world.judge.judge(Frame(cia301.SYNC), world.core, lambda node: 0)


def test_outputs_that_differ_from_the_command_are_found() -> None:
    world = World()
    world.boards.board("can0/5").wired[0].actuator.drive(1, world.now)
    with pytest.raises(Moved, match="the outputs are 000001, switched to 000000"):
        world.check_outputs()


def test_programs_and_setpoints_are_carried_out_in_between() -> None:
    attack = Attack()
    attack([("packet", PROGRAM), ("wait", 40)])
    assert attack.switched == 3
    setpoint = Setpoint(4, 0, b"\0", (pack(0b111000, SIZE),), 0.0, False, "following")
    attack.packet(setpoint)
    attack.wait(3)
    assert attack.world.boards.drives() == [0, 0, 0, 1, 1, 1]
    assert attack.world.core.modes.mode == "executing"
    attack.world.recover()
