"""The pins of simulated boards: what they show of 6200h, 6206h and 6207h in each NMT state."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, State
from hyperbit.drivers.simulation.variants import STANDARD, VARIANTS, Variant
from tests.drivers.simulation.rig import Rig

GUARDED = VARIANTS["guarding-only"]
GUARD = cia301.REMOTE | 0x705


def extended(variant: Variant = STANDARD) -> Rig:
    rig = Rig((0, 0), (1, 1), variant=variant)
    rig.nmt(Command.START)
    rig.say(0x205, "03" + 7 * " 00")
    assert rig.board.pins == 3
    return rig


def lose_master(rig: Rig) -> None:
    if rig.board.objects.has(0x100C):
        assert rig.write(0x100C, 0, 100, 2) == rig.write(0x100D, 0, 3) == 0
        rig.say(GUARD)
    else:
        assert rig.write(0x1016, 1, 127 << 16 | 300, 4) == 0
        rig.say(0x77F, "05")
    assert any(cob_id == 0x085 for cob_id, _ in rig.wait(0.31))


def leave_by(cause: str, rig: Rig) -> None:
    if cause == "stop":
        rig.nmt(Command.STOP)
        return
    if cause == "loss in pre-operational":
        rig.nmt(Command.PRE_OPERATIONAL)
        assert rig.board.pins == 3, "pre-operational alone is no error"
    lose_master(rig)


@pytest.mark.parametrize("variant", [STANDARD, GUARDED], ids=["heartbeats", "guarding"])
@pytest.mark.parametrize("cause", ["stop", "loss", "loss in pre-operational"])
def test_a_start_applies_the_last_command(cause, variant):
    rig = extended(variant)
    leave_by(cause, rig)
    assert (rig.board.pins, rig.outputs(), rig.driven()) == (0, 3, [0, 0])
    rig.nmt(Command.PRE_OPERATIONAL)
    assert rig.driven() == [0, 0], "only a start ends the error state"
    rig.nmt(Command.START)
    assert (rig.board.pins, rig.driven()) == (3, [1, 1])
    assert rig.board.started == [(0, 0), (0, 3)]


def test_a_written_error_mode_or_value_acts_at_once_in_the_error_state():
    rig = extended()
    assert rig.write(0x6206, 1, 0xFE) == 0
    assert rig.board.pins == 3, "it is no error state"
    lose_master(rig)
    assert rig.board.pins == 1
    assert rig.write(0x6207, 1, 2) == 0
    assert rig.board.pins == 3
    assert rig.write(0x6206, 1, 0xFF) == 0
    assert rig.board.pins == 2
    assert rig.write(0x6206, 1, 0) == 0
    assert (rig.board.pins, rig.driven()) == (3, [1, 1]), "a byte that holds follows 6200h"


def test_a_written_command_acts_at_once_on_its_byte_also_in_the_error_state():
    rig = Rig((0, 0), (8, 1))
    rig.answers()
    assert rig.write(0x6200, 1, 1) == 0
    assert rig.driven() == [1, 0], "in pre-operational"
    rig.nmt(Command.START)
    rig.say(0x205, "01 01" + 6 * " 00")
    lose_master(rig)
    assert rig.board.pins == 0
    assert rig.write(0x6200, 2, 1) == 0
    assert rig.driven() == [0, 1]
    assert rig.write(0x6207, 2, 0) == 0
    assert rig.driven() == [0, 0], "what was written last acts"


def test_with_1029h_at_1_the_error_state_of_an_operational_board_ends_with_its_next_rpdo():
    rig = extended()
    assert rig.write(0x1029, 1, 1) == 0
    lose_master(rig)
    assert (rig.board.state, rig.board.pins) == (State.OPERATIONAL, 0)
    rig.say(0x77F, "05")
    assert rig.board.pins == 0
    rig.say(0x205, "02" + 7 * " 00")
    assert rig.board.pins == 2
