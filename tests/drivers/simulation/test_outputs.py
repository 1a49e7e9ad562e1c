"""The pins of simulated boards: what they show of 6200h, 6206h and 6207h in each NMT state."""

from __future__ import annotations

import pytest

from drivers.canopen.wire import cia301
from drivers.canopen.wire.cia301 import Command, State
from drivers.simulation.variants import STANDARD, VARIANTS, Variant
from tests.drivers.simulation.bench import Bench

GUARDED = VARIANTS["guarding-only"]
GUARD = cia301.REMOTE | 0x705


def extended(variant: Variant = STANDARD) -> Bench:
    """An operational board whose two outputs are on."""
    bench = Bench((0, 0), (1, 1), variant=variant)
    bench.nmt(Command.START)
    bench.say(0x205, "03" + 7 * " 00")
    assert bench.board.pins == 3
    return bench


def lose_master(bench: Bench) -> None:
    """The supervision of the board runs out."""
    if bench.board.objects.has(0x100C):
        assert bench.write(0x100C, 0, 100, 2) == bench.write(0x100D, 0, 3) == 0
        bench.say(GUARD)
    else:
        assert bench.write(0x1016, 1, 127 << 16 | 300, 4) == 0
        bench.say(0x77F, "05")
    assert any(cob_id == 0x085 for cob_id, _ in bench.wait(0.31))


def leave_by(cause: str, bench: Bench) -> None:
    """Makes an operational board enter its error state."""
    if cause == "stop":
        bench.nmt(Command.STOP)
        return
    if cause == "loss in pre-operational":
        bench.nmt(Command.PRE_OPERATIONAL)
        assert bench.board.pins == 3, "pre-operational alone is no error"
    lose_master(bench)


@pytest.mark.parametrize("variant", [STANDARD, GUARDED], ids=["heartbeats", "guarding"])
@pytest.mark.parametrize("cause", ["stop", "loss", "loss in pre-operational"])
def test_a_start_applies_the_last_command(cause, variant):
    bench = extended(variant)
    leave_by(cause, bench)
    assert (bench.board.pins, bench.outputs(), bench.driven()) == (0, 3, [0, 0])
    bench.nmt(Command.PRE_OPERATIONAL)
    assert bench.driven() == [0, 0], "only a start ends the error state"
    bench.nmt(Command.START)
    assert (bench.board.pins, bench.driven()) == (3, [1, 1])
    assert bench.board.started == [(0, 0), (0, 3)]


def test_a_reset_of_communication_does_not_end_the_error_state():
    bench = extended()
    bench.nmt(Command.STOP)
    bench.nmt(Command.RESET_COMMUNICATION)
    assert (bench.board.pins, bench.board.state) == (0, State.PRE_OPERATIONAL)
    bench.nmt(Command.START)
    assert bench.board.pins == 3


def test_a_written_error_mode_or_value_acts_at_once_in_the_error_state():
    bench = extended()
    assert bench.write(0x6206, 1, 0xFE) == 0
    assert bench.board.pins == 3, "it is no error state"
    lose_master(bench)
    assert bench.board.pins == 1
    assert bench.write(0x6207, 1, 2) == 0
    assert bench.board.pins == 3
    assert bench.write(0x6206, 1, 0xFF) == 0
    assert bench.board.pins == 2
    assert bench.write(0x6206, 1, 0) == 0
    assert (bench.board.pins, bench.driven()) == (3, [1, 1]), "a byte that holds follows 6200h"


def test_a_written_command_acts_at_once_on_its_byte_also_in_the_error_state():
    bench = Bench((0, 0), (8, 1))
    bench.answers()
    assert bench.write(0x6200, 1, 1) == 0
    assert bench.driven() == [1, 0], "in pre-operational"
    bench.nmt(Command.START)
    bench.say(0x205, "01 01" + 6 * " 00")
    lose_master(bench)
    assert bench.board.pins == 0
    assert bench.write(0x6200, 2, 1) == 0
    assert bench.driven() == [0, 1]
    assert bench.write(0x6207, 2, 0) == 0
    assert bench.driven() == [0, 0], "what was written last acts"


def test_with_1029h_at_1_the_error_state_of_an_operational_board_ends_with_its_next_rpdo():
    bench = extended()
    assert bench.write(0x1029, 1, 1) == 0
    lose_master(bench)
    assert (bench.board.state, bench.board.pins) == (State.OPERATIONAL, 0)
    bench.say(0x77F, "05")
    assert bench.board.pins == 0
    bench.say(0x205, "02" + 7 * " 00")
    assert bench.board.pins == 2


def test_pins_are_off_without_supply_and_after_it_returns():
    bench = extended()
    bench.board.power_cut(bench.now)
    assert bench.board.pins == 0
    bench.board.power_on(bench.now)
    bench.nmt(Command.START)
    assert (bench.board.pins, bench.board.started[-1]) == (0, (0, 0))
