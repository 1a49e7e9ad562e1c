"""The peculiarity of each variant of the simulated boards, by the frames on the wire."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire.cia301 import REMOTE, Command, State
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.simulation.rig import EXTEND, Rig, booted

NO_OBJECT = "00 00 02 06"  # abort code as on the wire
GUARD = REMOTE | 0x705
BOOTED = (0x705, "00")
LOST, OVER = (0x085, "30 81 11 00 00 00 00 00"), (0x085, "00 00 00 00 00 00 00 00")


def lose_master(it: Rig) -> None:
    assert it.write(0x1016, 1, 127 << 16 | 300, 4) == 0
    it.nmt(Command.START)
    it.say(0x205, EXTEND)
    it.say(0x77F, "05")
    assert LOST in it.wait(0.31)


@pytest.mark.parametrize("name", VARIANTS)
def test_each_variant_boots_when_its_time_has_come_and_answers_what_it_is(name):
    it = Rig((0, 0), variant=VARIANTS[name])
    assert (it.answers() or it.wait(5.0))[0] == BOOTED
    it.say(0x605, "40 00 10 00 00 00 00 00")
    [(_, answer)] = it.sent or it.wait(0.6) or [(0x585, it.sdo("40 00 10 00"))]
    assert answer.startswith("43 00 10 00")
    assert VARIANTS[name].text
    for index, subs in VARIANTS[name].objects.items():
        for sub in subs:
            if index != 0x1003:
                it.board.objects.get_data(index, sub)


def test_guarding_answers_with_a_toggle_bit_and_the_state():
    it = booted("guarding-only")
    assert it.say(GUARD) == [(0x705, "7f")]
    assert it.say(GUARD) == [(0x705, "ff")]
    it.nmt(Command.START)
    assert it.say(GUARD) == [(0x705, "05")]
    assert it.say(GUARD) == [(0x705, "85")]
    assert it.nmt(Command.RESET_COMMUNICATION) == [BOOTED]
    assert it.say(GUARD) == [(0x705, "7f")], "the toggle bit begins anew"
    assert it.say(REMOTE | 0x706) == []
    for request in ("40 16 10 01", "40 17 10", "40 29 10 01"):
        assert it.sdo(request).endswith(NO_OBJECT)


def test_guarding_that_ends_after_life_time_is_the_loss_of_the_master():
    it = booted("guarding-only")
    assert (it.write(0x100C, 0, 100, 2), it.write(0x100D, 0, 3)) == (0, 0)
    it.nmt(Command.START)
    it.say(0x205, EXTEND)
    assert LOST not in it.wait(10.0), "life time begins with the first remote frame"
    it.say(GUARD)
    assert it.wait(0.29) == []
    it.say(GUARD)
    assert it.wait(0.29) == []
    assert it.wait(0.02) == [LOST]
    assert (it.board.state, it.outputs(), it.driven()) == (State.PRE_OPERATIONAL, 3, [0, 0])
    assert it.say(GUARD) == [(0x705, "7f"), OVER]


def test_outputs_that_are_off_in_each_state_but_operational():
    it = booted("off-in-preoperational")
    assert it.write(0x6200, 1, 1) == 0
    assert it.driven() == [0, 0]
    it.nmt(Command.START)
    assert it.driven() == [1, 0]
    it.nmt(Command.PRE_OPERATIONAL)
    assert (it.driven(), it.outputs()) == ([0, 0], 1)
    it.nmt(Command.START)
    assert it.board.started == [(0, 1), (0, 1)]
    assert it.nmt(Command.RESET_COMMUNICATION) == [BOOTED]
    assert it.driven() == [0, 0]


def test_slow_answers_come_in_order_after_their_time():
    it = booted("slow-answers")
    assert it.say(0x605, "40 00 10 00 00 00 00 00") == []
    assert it.wait(0.3) == []
    assert it.say(0x605, "40 17 10 00 00 00 00 00") == []
    assert it.board.timer == pytest.approx(0.6)
    assert it.wait(0.3) == [(0x585, "43 00 10 00 91 01 03 00")]
    assert it.wait(0.3) == [(0x585, "4b 17 10 00 00 00 00 00")]
    it.say(0x605, "40 00 10 00 00 00 00 00")
    it.nmt(Command.RESET_COMMUNICATION)
    assert it.wait(1.0) == [], "a reset forgets what was asked"


def test_a_foreign_sync_identifier_is_what_it_obeys():
    it = booted("foreign-sync")
    assert it.sdo("40 05 10 00") == "43 05 10 00 85 00 00 00"
    assert it.write(0x1400, 2, 1) == 0
    it.nmt(Command.START)
    it.say(0x205, EXTEND)
    it.say(0x080)
    assert it.driven() == [0, 0]
    it.say(0x085)
    assert it.driven() == [1, 1]
    assert it.write(0x1005, 0, 0x80, 4) == 0
    it.say(0x205, bytes(8))
    it.say(0x080)
    assert it.driven() == [0, 0]


def test_with_a_sync_counter_a_sync_without_one_is_an_error():
    it = booted("sync-counter")
    assert it.sdo("40 19 10 00") == "4f 19 10 00 0a 00 00 00"
    assert it.write(0x1400, 2, 1) == 0
    it.nmt(Command.START)
    it.answers()
    it.say(0x205, EXTEND)
    assert it.say(0x080) == [(0x085, "40 82 11 00 00 00 00 00")]
    assert it.driven() == [0, 0]
    assert it.say(0x080, "01") == [OVER]
    assert it.driven() == [1, 1]


def test_with_a_sync_period_the_end_of_syncs_is_an_error():
    it = booted("sync-period")
    assert it.sdo("40 06 10 00") == "43 06 10 00 a0 86 01 00"
    assert it.write(0x1400, 2, 1) == 0
    it.nmt(Command.START)
    it.say(0x205, EXTEND)
    assert LOST not in it.wait(1.0), "it expects SYNCs from the first on"
    it.say(0x080)
    assert it.driven() == [1, 1]
    it.wait(0.14)
    it.say(0x080)
    assert it.wait(0.14) == []
    assert it.wait(0.02) == [(0x085, "00 81 11 00 00 00 00 00")]
    assert (it.driven(), it.board.state) == ([0, 0], State.PRE_OPERATIONAL)
    assert OVER in it.nmt(Command.START)
    it.say(0x080)
    assert it.write(0x1006, 0, 0, 4) == 0
    it.say(0x080)
    assert it.wait(10.0) == [], "it does not miss them any more"


@pytest.mark.parametrize(
    ("name", "lost", "over"),
    [
        ("standard", ["30 81 00 00"], ["30 81 00 00"]),
        ("logged-ends", ["30 81 11 1b"], ["00 00 00 1b", "30 81 11 1b"]),
        ("canopennode", ["30 81 11 1b"], ["00 00 00 1b", "30 81 11 1b"]),
    ],
)
def test_the_history_after_the_loss_of_the_master_and_its_return(name, lost, over):
    it = booted(name)
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
