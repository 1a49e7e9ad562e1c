"""Simulated boards, frame by frame: the standard board, and the peculiarity of each variant."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire.cia301 import REMOTE, Command, State
from tests.drivers.simulation.rig import BOOTED, EXTEND, GUARD, LOST, OFF, OVER, Rig, booted

NO_OBJECT = "00 00 02 06"  # abort code as on the wire
ON_SYNC = (0x1400, 2, 1, 1)


# SDO.


@pytest.mark.parametrize(
    ("index", "sub", "value", "size", "abort"),
    [
        (0x1600, 0, 0, 1, 0x06010000),  # mapped while valid
        (0x1400, 1, 0x00000206, 4, 0x06090030),  # another COB-ID while valid
        (0x1400, 2, 241, 1, 0x06090030),
        (0x1800, 2, 1, 1, 0x06090030),
        (0x1000, 0, 0, 4, 0x06010002),
        (0x1017, 0, 0, 4, 0x06070010),
        (0x2000, 0, 0, 1, 0x06020000),
        (0x6200, 9, 0, 1, 0x06090011),
    ],
)
def test_refuses_what_a_board_refuses(index: int, sub: int, value: int, size: int, abort: int) -> None:
    assert booted().write(index, sub, value, size) == abort


def test_refuses_to_map_what_is_not_there_or_too_much() -> None:
    it = booted()
    it.set((0x1400, 1, 0x80000205, 4), (0x1600, 0, 0, 1))
    assert it.write(0x1600, 1, 0x62020108, 4) == 0x06040041
    assert it.write(0x1600, 1, 0x62000110, 4) == 0x06040041
    it.set((0x1600, 1, 0x00070020, 4), (0x1600, 2, 0x00070020, 4))
    assert it.write(0x1600, 0, 3) == 0x06040042
    assert it.write(0x1600, 0, 9) == 0x06040042


def test_segments_without_end_are_aborted_and_nonsense_is_counted() -> None:
    it = booted()
    it.say(0x605, "21 00 62 01 00 00 00 00")
    answers = [it.say(0x605, bytes([0x10 * (k % 2), *range(7)]).hex()) for k in range(10)]
    assert (0x585, "80 00 62 01 05 00 04 05") in answers[-1]
    it = booted()
    for cob_id, data in ((0x605, "40"), (0x605, "60" + 7 * "00"), (0, "63 05")):
        it.say(cob_id, data)
    assert it.board.ignored == 3


# NMT, heartbeats and the loss of the master.


def test_resets_boot_again_and_leaving_operational_forgets_what_was_latched() -> None:
    it = booted()
    it.extend()
    assert it.nmt(Command.RESET_COMMUNICATION) == [BOOTED]
    assert it.outputs() == 3
    assert it.nmt(Command.RESET_NODE, 0) == [BOOTED]
    assert it.outputs() == 0
    assert it.nmt(Command.RESET_NODE, 6) == []
    it.set(ON_SYNC)
    it.start()
    it.say(0x205, EXTEND)
    it.nmt(Command.PRE_OPERATIONAL)
    it.start()
    it.say(0x080)
    assert it.outputs() == 0


@pytest.mark.parametrize(
    ("mode", "value", "behaviour", "pins", "state"),
    [
        (0x00, 0x00, 0, 3, State.PRE_OPERATIONAL),
        (0xFF, 0x00, 0, 0, State.PRE_OPERATIONAL),
        (0xFE, 0x00, 2, 1, State.STOPPED),
        (0xFF, 0x02, 1, 2, State.OPERATIONAL),
    ],
)
def test_the_loss_of_the_master(mode: int, value: int, behaviour: int, pins: int, state: State) -> None:
    it = booted()
    it.set((0x1016, 1, 127 << 16 | 300, 4), (0x6206, 1, mode, 1), (0x6207, 1, value, 1), (0x1029, 1, behaviour, 1))
    it.extend()
    assert it.wait(100) == [(0x185, EXTEND)], "a master never heard is not missed"
    for _ in range(2):
        it.say(0x77F, "05")
        assert it.wait(0.29) == []
    assert LOST in it.wait(0.02)
    assert (it.board.pins, it.outputs(), it.board.state) == (pins, 3, state)
    assert it.say(0x77F, "05") == ([] if state is State.STOPPED else [OVER])
    if state is State.OPERATIONAL:
        it.say(0x205, "01" + OFF[2:])
        assert it.board.pins == 1, "the error state ends with the next RPDO"


def test_one_node_is_watched_by_one_entry_only() -> None:
    it = booted("watched-already")
    assert it.write(0x1016, 1, 127 << 16 | 300, 4) == 0x0604_0043
    it.set((0x1016, 1, 126 << 16 | 300, 4), (0x1016, 2, 127 << 16 | 300, 4))
    it.say(0x77F, "05")
    assert [cob_id for cob_id, _ in it.wait(0.31)] == [0x085]


def test_guarding_answers_with_a_toggle_bit_and_ends_after_its_life_time() -> None:
    it = booted("guarding-only")
    assert it.say(GUARD) + it.say(GUARD) == [(0x705, "7f"), (0x705, "ff")]
    it.start()
    assert it.say(GUARD) + it.say(GUARD) == [(0x705, "05"), (0x705, "85")]
    assert it.nmt(Command.RESET_COMMUNICATION) == [BOOTED]
    assert it.say(GUARD) == [(0x705, "7f")], "the toggle bit begins anew"
    assert it.say(REMOTE | 0x706) == []
    for request in ("40 16 10 01", "40 17 10", "40 29 10 01"):
        assert it.sdo(request).endswith(NO_OBJECT)
    it = booted("guarding-only")
    it.set((0x100C, 0, 100, 2), (0x100D, 0, 3, 1))
    it.extend()
    assert LOST not in it.wait(10.0), "life time begins with the first remote frame"
    for _ in range(2):
        it.say(GUARD)
        assert it.wait(0.29) == []
    assert it.wait(0.02) == [LOST]
    assert (it.board.state, it.outputs(), it.driven()) == (State.PRE_OPERATIONAL, 3, [0, 0])
    assert it.say(GUARD) == [(0x705, "7f"), OVER]


# Pins: what they show of 6200h, 6206h and 6207h in each NMT state.


@pytest.mark.parametrize("variant", ["standard", "guarding-only"])
@pytest.mark.parametrize("cause", ["stop", "loss", "loss in pre-operational"])
def test_a_start_applies_the_last_command(cause: str, variant: str) -> None:
    it = booted(variant)
    it.extend()
    if cause == "loss in pre-operational":
        it.nmt(Command.PRE_OPERATIONAL)
        assert it.board.pins == 3, "pre-operational alone is no error"
    it.nmt(Command.STOP) if cause == "stop" else it.lose_master()
    assert (it.board.pins, it.outputs(), it.driven()) == (0, 3, [0, 0])
    it.nmt(Command.PRE_OPERATIONAL)
    assert it.driven() == [0, 0], "only a start ends the error state"
    it.start()
    assert (it.board.pins, it.driven(), it.board.started) == (3, [1, 1], [(0, 0), (0, 3)])


def test_a_written_error_mode_or_value_acts_at_once_in_the_error_state() -> None:
    it = booted()
    it.extend()
    it.set((0x6206, 1, 0xFE, 1))
    assert it.board.pins == 3, "it is no error state"
    it.lose_master()
    assert it.board.pins == 1
    for index, value, pins in ((0x6207, 2, 3), (0x6206, 0xFF, 2), (0x6206, 0, 3)):
        it.set((index, 1, value, 1))
        assert it.board.pins == pins
    assert it.driven() == [1, 1], "a byte that holds follows 6200h"


def test_a_written_command_acts_at_once_on_its_byte_also_in_the_error_state() -> None:
    it = Rig(bits=((0, 0), (8, 1)))
    it.answers()
    it.set((0x6200, 1, 1, 1))
    assert it.driven() == [1, 0], "in pre-operational"
    it.start()
    it.say(0x205, "01 01" + 6 * " 00")
    it.lose_master()
    assert it.board.pins == 0
    it.set((0x6200, 2, 1, 1))
    assert it.driven() == [0, 1]
    it.set((0x6207, 2, 0, 1))
    assert it.driven() == [0, 0], "what was written last acts"


# PDOs and SYNC.


def test_a_wrong_pdo_length_is_told_until_it_is_over() -> None:
    it = booted()
    it.start()
    assert it.say(0x205, "01") == [(0x085, "10 82 11 00 00 00 00 00")]
    assert it.outputs() == 0
    assert it.say(0x205, "01") == []
    assert it.say(0x205, EXTEND) == [OVER]
    assert it.board.objects.number(0x1003, 0) == 1
    it.set((0x1003, 0, 0, 1))
    assert it.board.objects.number(0x1003, 1) == 0


def test_a_tpdo_comes_on_start_on_arrival_if_allowed_and_by_the_event_timer() -> None:
    it = booted()
    assert it.start() == [(0x185, OFF)]
    assert it.say(0x205, EXTEND) == []
    assert it.wait(0.09) == []
    assert it.wait(0.01) == [(0x185, EXTEND)]
    it.set((0x6005, 0, 0, 1))
    it.say(0x205, OFF)
    assert it.wait(0.2) == []
    assert it.board.objects.number(0x6000, 1) == 0
    it = booted()
    it.set((0x1800, 5, 100, 2))
    assert it.wait(1.0) == []
    assert it.start() == [(0x185, OFF)]
    assert it.wait(0.09) == []
    assert it.board.timer == pytest.approx(1.1)
    assert it.wait(0.011) == [(0x185, OFF)]
    it.nmt(Command.PRE_OPERATIONAL)
    assert it.wait(1.0) == []


@pytest.mark.parametrize(("timer", "after"), [(0, []), (150, [(0x185, EXTEND)])])
def test_a_lost_tpdo_comes_again_only_by_the_event_timer(timer: int, after: list[tuple[int, str]]) -> None:
    it = booted()
    it.set((0x1800, 5, timer, 2))
    it.start()
    it.board.lose_tpdo()
    it.say(0x205, EXTEND)
    assert it.wait(0.1) == [], "the change of the inputs is lost"
    assert it.board.objects.number(0x6000, 1) == 3
    assert it.wait(0.151) == after


def on_sync(name: str) -> Rig:
    """A board of which an RPDO waits for SYNC."""
    it = booted(name)
    it.set(ON_SYNC)
    it.start()
    it.say(0x205, EXTEND)
    return it


@pytest.mark.parametrize(
    ("name", "read", "told", "right", "repair"),
    [
        ("foreign-sync", "43 05 10 00 85 00 00 00", [], (0x085, ""), (0x1005, 0, 0x80, 4)),
        ("sync-counter", "4f 19 10 00 0a 00 00 00", [(0x085, "40 82 11 00 00 00 00 00")], (0x080, "01"), None),
    ],
)
def test_a_board_with_another_sync_does_not_obey_the_usual_one(
    name: str, read: str, told: list[tuple[int, str]], right: tuple[int, str], repair: tuple[int, int, int, int] | None
) -> None:
    it = on_sync(name)
    assert it.sdo(f"40 {read[3:11]}") == read
    assert (it.say(0x080), it.driven()) == (told, [0, 0])
    assert it.say(*right) == ([OVER] if told else [])
    assert it.driven() == [1, 1]
    if repair:
        it.set(repair)
        it.say(0x205, OFF)
        it.say(0x080)
        assert it.driven() == [0, 0]


def test_synchronous_rpdos_after_the_window_are_dropped() -> None:
    it = on_sync("sync-window")
    it.say(0x080)
    assert it.board.pins == 3, "before the first SYNC there is no window"
    it.wait(0.009)
    it.say(0x205, OFF)
    it.wait(0.1)
    it.say(0x205, EXTEND)
    it.say(0x080)
    assert it.board.pins == 0, "the first RPDO came within the window, the second one after it"


def test_with_a_sync_period_the_end_of_syncs_is_an_error() -> None:
    it = on_sync("sync-period")
    assert it.sdo("40 06 10 00") == "43 06 10 00 a0 86 01 00"
    assert LOST not in it.wait(1.0), "it expects SYNCs from the first on"
    it.say(0x080)
    it.wait(0.14)
    it.say(0x080)
    assert it.wait(0.14) == []
    assert it.wait(0.02) == [(0x085, "00 81 11 00 00 00 00 00")]
    assert (it.driven(), it.board.state) == ([0, 0], State.PRE_OPERATIONAL)
    assert OVER in it.start()
    it.say(0x080)
    it.set((0x1006, 0, 0, 4))
    it.say(0x080)
    assert it.wait(10.0) == [], "it does not miss them any more"


# Errors and their history.


@pytest.mark.parametrize(("name", "heard"), [("standard", 1), ("no-emergencies", 0)])
def test_emergencies_come_only_if_1014h_enables_them(name: str, heard: int) -> None:
    it = booted(name)
    it.board.emergencies.report(0x2320)
    assert len(it.answers()) == heard
    assert it.board.objects.number(0x1001) == 0x03
    if not heard:
        assert it.sdo("40 14 10 00") == "43 14 10 00 85 00 00 80"
        it.set((0x1014, 0, 0x85, 4))
        it.board.emergencies.recover(0x2320)
        assert it.answers() == [OVER]


def history(it: Rig) -> list[str]:
    """Returns the entries of 1003h as on the wire; those above their count answer that there are no data."""
    count = int(it.sdo("40 03 10 00").split()[4], 16)
    for sub in range(count + 1, 9):
        assert it.sdo(f"40 03 10 {sub:02x}") == f"80 03 10 {sub:02x} 24 00 00 08"
    return [it.sdo(f"40 03 10 {sub:02x}")[12:] for sub in range(1, count + 1)]


@pytest.mark.parametrize(
    ("name", "lost", "over"),
    [
        ("standard", ["30 81 00 00"], ["30 81 00 00"]),
        ("logged-ends", ["30 81 11 1b"], ["00 00 00 1b", "30 81 11 1b"]),
        ("canopennode", ["30 81 11 1b"], ["00 00 00 1b", "30 81 11 1b"]),
    ],
)
def test_the_history_after_the_loss_of_the_master_and_its_return(name: str, lost: list[str], over: list[str]) -> None:
    it = booted(name)
    assert history(it) == []
    it.extend()
    it.lose_master()
    assert history(it) == lost
    assert it.say(0x77F, "05") == [OVER]
    assert history(it) == over
    it.set((0x1003, 0, 0, 1))
    assert history(it) == []


@pytest.mark.parametrize(
    ("name", "emergency", "entry"),
    [
        ("standing-error", "00 ff 80", "00 ff 00 00"),
        ("generic-error", "00 10 01", "00 10 00 00"),
        ("blocking-error", "00 50 01", "00 50 00 00"),
    ],
)
def test_a_standing_error_is_told_once_and_stands(name: str, emergency: str, entry: str) -> None:
    it, told = Rig(name), (0x085, emergency + " 00 00 00 00 00")
    assert it.answers() == [BOOTED, told]
    for _ in range(2):
        assert it.sdo("40 01 10 00") == f"4f 01 10 00 {emergency[-2:]} 00 00 00"
        assert history(it) == [entry]
        assert it.nmt(Command.RESET_COMMUNICATION) == [BOOTED], "it was told before"
    assert it.nmt(Command.RESET_NODE) == [BOOTED, told]
    it.set((0x1003, 0, 0, 1))
    assert history(it) == []
    it.start()
    assert (it.board.state is State.OPERATIONAL) == (name != "blocking-error")
