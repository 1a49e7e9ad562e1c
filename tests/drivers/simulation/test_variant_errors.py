"""Errors of the variants: 1001h, 1003h and emergencies."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire.cia301 import Command, State
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.simulation.rig import Rig
from tests.drivers.simulation.test_variants import BOOTED, OVER, lose_master, rig


@pytest.mark.parametrize(
    ("name", "lost", "over"),
    [
        ("standard", ["30 81 00 00"], ["30 81 00 00"]),
        ("logged-ends", ["30 81 00 1b"], ["00 00 00 1b", "30 81 00 1b"]),
        ("canopennode", ["30 81 00 1b"], ["00 00 00 1b", "30 81 00 1b"]),
    ],
)
def test_the_history_after_the_loss_of_the_master_and_its_return(name, lost, over):
    it = rig(name)
    assert history(it) == []
    lose_master(it)
    assert history(it) == lost
    assert it.say(0x77F, "05") == [OVER]
    assert history(it) == over
    assert it.write(0x1003, 0, 0) == 0
    assert history(it) == []


def history(it: Rig) -> list[str]:
    """The entries of 1003h as on the wire; those above their count answer that there are no data."""
    count = int(it.sdo("40 03 10 00").split()[4], 16)
    for sub in range(count + 1, 9):
        assert it.sdo(f"40 03 10 {sub:02x}") == f"80 03 10 {sub:02x} 24 00 00 08"
    return [it.sdo(f"40 03 10 {sub:02x}")[12:] for sub in range(1, count + 1)]


@pytest.mark.parametrize(
    ("name", "emergency", "register", "entry"),
    [
        ("standing-error", "00 ff 80", "80", "00 ff 00 00"),
        ("generic-error", "00 10 01", "01", "00 10 00 00"),
        ("blocking-error", "00 50 01", "01", "00 50 00 00"),
    ],
)
def test_a_standing_error_is_told_once_and_stands(name, emergency, register, entry):
    it = Rig((0, 0), variant=VARIANTS[name])
    assert it.answers() == [BOOTED, (0x085, emergency + " 00 00 00 00 00")]
    for _ in range(2):
        assert it.sdo("40 01 10 00") == f"4f 01 10 00 {register} 00 00 00"
        assert it.sdo("40 03 10 00") == "4f 03 10 00 01 00 00 00"
        assert it.sdo("40 03 10 01") == "43 03 10 01 " + entry
        assert it.nmt(Command.RESET_COMMUNICATION) == [BOOTED], "it was told before"
    assert it.nmt(Command.RESET_NODE) == [BOOTED, (0x085, emergency + " 00 00 00 00 00")]
    assert it.write(0x1003, 0, 0) == 0
    assert it.sdo("40 03 10 00") == "4f 03 10 00 00 00 00 00"
    it.nmt(Command.START)
    assert (it.board.state is State.OPERATIONAL) == (name != "blocking-error")
