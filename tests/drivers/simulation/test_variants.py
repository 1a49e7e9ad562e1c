"""The peculiarity of each variant of the simulated boards, by the frames on the wire."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire.cia301 import REMOTE, Command, State
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.simulation.rig import Rig

NO_OBJECT, READ_ONLY = "00 00 02 06", "02 00 01 06"  # abort codes as on the wire
GUARD = REMOTE | 0x705
BOOTED = (0x705, "00")
LOST, OVER = (0x085, "30 81 11 00 00 00 00 00"), (0x085, "00 00 00 00 00 00 00 00")
EXTEND = "03" + 7 * " 00"


def rig(name: str) -> Rig:
    rig = Rig((0, 0), (1, 1), variant=VARIANTS[name])
    assert rig.answers()[0] == BOOTED
    return rig


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
    it = rig("guarding-only")
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
    it = rig("guarding-only")
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


def test_one_supervision_refuses_heartbeats_until_guarding_is_off():
    it = rig("one-supervision")
    assert it.sdo("40 0c 10 00") == "4b 0c 10 00 f4 01 00 00"
    assert it.sdo("2b 17 10 00 64 00") == "80 17 10 00 43 00 04 06"
    assert it.write(0x100D, 0, 0) == 0
    assert it.sdo("2b 17 10 00 64 00") == "60 17 10 00 00 00 00 00"
    assert it.sdo("2f 0d 10 00 03") == "80 0d 10 00 43 00 04 06"
    assert it.wait(0.1) == [(0x705, "7f")]


def test_boards_without_guarding_answer_no_remote_frame_and_an_unsupervised_one_takes_no_heartbeat():
    assert rig("standard").say(GUARD) == rig("unsupervised").say(GUARD) == []
    assert rig("unsupervised").sdo("23 16 10 01 2c 01 7f 00").endswith(NO_OBJECT)


def test_outputs_in_rpdo5_wait_until_it_is_enabled():
    it = rig("outputs-in-rpdo5")
    assert it.sdo("40 04 14 01") == "43 04 14 01 00 00 00 80"
    assert it.sdo("40 04 16 01") == "43 04 16 01 08 01 00 62"
    assert it.sdo("23 04 16 01 08 01 00 62") == "80 04 16 01 " + READ_ONLY
    assert it.sdo("40 00 16 00") == "4f 00 16 00 00 00 00 00"
    it.nmt(Command.START)
    it.say(0x205, EXTEND)
    assert it.outputs() == 0
    assert it.write(0x1404, 2, 1) == 0
    assert it.sdo("23 04 14 01 01 05 00 00") == "60 04 14 01 00 00 00 00"
    it.say(0x501, EXTEND)
    assert it.driven() == [0, 0]
    it.say(0x080)
    assert it.driven() == [1, 1]


def test_of_many_outputs_those_beyond_64_are_in_rpdo5():
    it = Rig((0, 0), (64, 64), variant=VARIANTS["many-outputs"])
    it.answers()
    assert it.sdo("40 00 62 00") == "4f 00 62 00 10 00 00 00"
    assert it.sdo("40 04 14 01") == "43 04 14 01 00 00 00 80"
    for index in (0x1400, 0x1404):
        assert it.write(index, 2, 1) == 0
    assert it.write(0x1404, 1, 0x285, 4) == 0
    assert it.write(0x1804, 1, 0x4000_0285, 4) == 0
    it.nmt(Command.START)
    it.answers()
    it.say(0x205, "01" + 7 * " 00")
    it.say(0x285, "01" + 7 * " 00")
    assert it.driven() == [0, 0]
    it.say(0x080)
    assert it.driven() == [1, 1], "one SYNC switches what both RPDOs brought"
    assert it.wait(0.1) == [(0x185, "01" + 7 * " 00"), (0x285, "01" + 7 * " 00")]


def test_a_fixed_mapping_cannot_be_written():
    it = rig("fixed-mapping")
    assert it.write(0x1400, 1, 0x8000_0205, 4) == 0
    assert it.sdo("2f 00 16 00 00") == "80 00 16 00 " + READ_ONLY
    assert it.sdo("23 00 1a 01 08 01 00 60") == "80 00 1a 01 " + READ_ONLY
    assert it.sdo("40 00 16 08") == "43 00 16 08 08 08 00 62"


def test_without_sync_types_each_rpdo_acts_at_once():
    it = rig("no-sync")
    assert it.sdo("2f 00 14 02 01") == "80 00 14 02 30 00 09 06"
    assert it.sdo("2f 00 14 02 ff") == "60 00 14 02 00 00 00 00"
    it.nmt(Command.START)
    it.say(0x205, EXTEND)
    assert it.driven() == [1, 1]


def test_saved_writes_outlive_the_supply_and_are_counted():
    it = rig("saves-writes")
    assert it.write(0x1017, 0, 100, 2) == 0
    assert it.write(0x6200, 1, 3) == 0
    assert it.board.objects.flash_writes == 1
    it.board.power_cut(it.now)
    it.board.power_on(it.now)
    assert it.answers() == [BOOTED]
    assert it.sdo("40 17 10") == "4b 17 10 00 64 00 00 00"
    assert it.outputs() == 0
    assert it.wait(0.1) == [(0x705, "7f")], "the heartbeats begin by themselves"


@pytest.mark.parametrize(
    ("name", "kind"), [("no-output-bit", "91 01 00 00"), ("all-bits", "91 01 0f 00"), ("maker-object", "00 00 00 00")]
)
def test_device_types(name, kind):
    assert rig(name).sdo("40 00 10 00") == "43 00 10 00 " + kind


def test_outputs_in_an_object_of_the_maker():
    it = rig("maker-object")
    assert it.sdo("40 00 62 00").endswith(NO_OBJECT)
    assert it.sdo("40 00 16 01") == "43 00 16 01 08 01 01 22"
    assert it.sdo("2f 01 22 01 02") == "60 01 22 01 00 00 00 00"
    assert it.driven() == [0, 1]
    lose_master(it)
    assert it.driven() == [0, 0]
    assert it.sdo("40 01 22 01") == "4f 01 22 01 03 00 00 00", "the last command"
    it.nmt(Command.START)
    assert it.driven() == [1, 1]


@pytest.mark.parametrize(
    ("name", "driven"), [("no-error-mode", [1, 1]), ("no-error-mode-off", [0, 0]), ("canopennode", [0, 0])]
)
def test_without_error_modes_the_device_decides(name, driven):
    it = rig(name)
    for request in ("2f 06 62 01 ff", "2f 07 62 01 00"):
        assert it.sdo(request).endswith(NO_OBJECT)
    lose_master(it)
    assert (it.driven(), it.board.state) == (driven, State.PRE_OPERATIONAL)
    it.nmt(Command.START)
    assert it.driven() == [1, 1], "a start applies 6200h"


@pytest.mark.parametrize(
    ("name", "abort"),
    [("standard", NO_OBJECT), ("absent-unsupported", "00 00 01 06"), ("absent-general", "00 00 00 08")],
)
def test_the_answer_for_an_absent_object(name, abort):
    it = rig(name)
    assert it.sdo("40 19 10 00") == "80 19 10 00 " + abort
    assert it.sdo("2f 19 10 00 00") == "80 19 10 00 " + abort
    assert it.sdo("40 00 62 09") == "80 00 62 09 11 00 09 06"


def test_without_error_behaviour_it_goes_pre_operational():
    it = rig("no-error-behaviour")
    assert it.sdo("2f 29 10 01 01").endswith(NO_OBJECT)
    lose_master(it)
    assert it.board.state is State.PRE_OPERATIONAL


def test_deaf_error_modes_are_confirmed_and_stay():
    it = rig("deaf-error-mode")
    assert it.sdo("2f 06 62 01 00") == "60 06 62 01 00 00 00 00"
    assert it.sdo("40 06 62 01") == "4f 06 62 01 ff 00 00 00"


@pytest.mark.parametrize(("name", "shown"), [("standard", "03"), ("shows-error-state", "00")])
def test_what_6200h_shows_in_the_error_state_is_not_what_a_start_applies(name, shown):
    it = rig(name)
    lose_master(it)
    assert it.driven() == [0, 0]
    assert it.sdo("40 00 62 01") == f"4f 00 62 01 {shown} 00 00 00"
    it.nmt(Command.START)
    assert it.driven() == [1, 1]
    assert it.sdo("40 00 62 01") == "4f 00 62 01 03 00 00 00"


def test_outputs_that_are_off_in_each_state_but_operational():
    it = rig("off-in-preoperational")
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


@pytest.mark.parametrize(("name", "driven"), [("standard", [1, 1]), ("resets-outputs", [0, 0])])
def test_outputs_after_a_reset_of_communication(name, driven):
    it = rig(name)
    it.nmt(Command.START)
    it.say(0x205, EXTEND)
    assert it.nmt(Command.RESET_COMMUNICATION) == [BOOTED]
    assert it.driven() == driven
    assert it.sdo("40 00 62 01") == f"4f 00 62 01 {3 * driven[0]:02x} 00 00 00"


def test_slow_answers_come_in_order_after_their_time():
    it = rig("slow-answers")
    assert it.say(0x605, "40 00 10 00 00 00 00 00") == []
    assert it.wait(0.3) == []
    assert it.say(0x605, "40 17 10 00 00 00 00 00") == []
    assert it.board.timer == pytest.approx(0.6)
    assert it.wait(0.3) == [(0x585, "43 00 10 00 91 01 03 00")]
    assert it.wait(0.3) == [(0x585, "4b 17 10 00 00 00 00 00")]
    it.say(0x605, "40 00 10 00 00 00 00 00")
    it.nmt(Command.RESET_COMMUNICATION)
    assert it.wait(1.0) == [], "a reset forgets what was asked"


def test_late_boards_boot_late_and_are_deaf_until_then():
    it = Rig((0, 0), variant=VARIANTS["late-boot"])
    assert it.say(0x605, "40 00 10 00 00 00 00 00") == []
    assert it.wait(4.9) == []
    assert it.board.timer == pytest.approx(5.0)
    assert it.wait(0.1) == [BOOTED]
    assert it.nmt(Command.RESET_NODE) == []
    it.wait(2.0)
    it.board.power_cut(it.now)
    assert it.wait(5.0) == [], "without its supply it never boots"


def test_a_foreign_sync_identifier_is_what_it_obeys():
    it = rig("foreign-sync")
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
    it = rig("sync-counter")
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
    it = rig("sync-period")
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


def test_inverted_outputs_are_on_while_6200h_is_0():
    it = rig("inverted-outputs")
    assert it.sdo("40 02 62 01") == "4f 02 62 01 ff 00 00 00"
    assert it.driven() == [1, 1]
    assert it.write(0x6202, 1, 0) == 0
    assert it.driven() == [0, 0]


def test_masked_inputs_are_sent_at_the_start_only():
    it = rig("masked-inputs")
    assert it.nmt(Command.START) == [(0x185, "00" + 7 * " 00")]
    it.say(0x205, EXTEND)
    assert it.wait(0.1) == []
    assert it.sdo("40 00 60 01") == "4f 00 60 01 03 00 00 00"
    assert it.write(0x6006, 1, 0xFF) == 0
    it.say(0x205, bytes(8))
    assert it.wait(0.1) == [(0x185, "00" + 7 * " 00")]
