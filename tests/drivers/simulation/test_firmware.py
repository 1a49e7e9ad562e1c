"""The standard board."""

from __future__ import annotations

import canopen
import pytest

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.simulation.dictionary import EDS
from tests.drivers.simulation.rig import Rig


@pytest.fixture
def rig() -> Rig:
    rig = Rig((0, 0), (1, 1))
    assert rig.answers() == [(0x705, "00")]
    return rig


def on_sync(rig: Rig) -> None:
    assert rig.write(0x1400, 2, 1) == 0


def test_resets_boot_again(rig):
    rig.nmt(cia301.Command.START)
    rig.say(0x205, b"\x01" + bytes(7))
    assert rig.nmt(cia301.Command.RESET_COMMUNICATION) == [(0x705, "00")]
    assert rig.outputs() == 1
    assert rig.nmt(cia301.Command.RESET_NODE, 0) == [(0x705, "00")]
    assert rig.outputs() == 0
    assert rig.nmt(cia301.Command.RESET_NODE, 6) == []


def test_leaving_operational_forgets_what_was_latched(rig):
    on_sync(rig)
    rig.nmt(cia301.Command.START)
    rig.say(0x205, b"\x01" + bytes(7))
    rig.nmt(cia301.Command.PRE_OPERATIONAL)
    rig.nmt(cia301.Command.START)
    rig.say(0x080)
    assert rig.outputs() == 0


def test_tells_a_wrong_pdo_length_and_its_end(rig):
    rig.nmt(cia301.Command.START)
    assert rig.say(0x205, b"\x01") == [(0x085, "10 82 11 00 00 00 00 00")]
    assert rig.outputs() == 0
    assert rig.say(0x205, b"\x01") == []
    assert rig.say(0x205, b"\x01" + bytes(7)) == [(0x085, "00 00 00 00 00 00 00 00")]
    assert rig.board.objects.number(0x1003, 0) == 1
    assert rig.write(0x1003, 0, 0) == 0
    assert rig.board.objects.number(0x1003, 1) == 0


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
def test_refuses_what_a_board_refuses(rig, index, sub, value, size, abort):
    assert rig.write(index, sub, value, size) == abort


def test_refuses_to_map_what_is_not_there_or_too_much(rig):
    assert rig.write(0x1400, 1, 0x80000205, 4) == 0
    assert rig.write(0x1600, 0, 0) == 0
    assert rig.write(0x1600, 1, 0x62020108, 4) == 0x06040041
    assert rig.write(0x1600, 1, 0x62000110, 4) == 0x06040041
    assert rig.write(0x1600, 1, 0x00070020, 4) == 0
    assert rig.write(0x1600, 2, 0x00070020, 4) == 0
    assert rig.write(0x1600, 0, 3) == 0x06040042
    assert rig.write(0x1600, 0, 9) == 0x06040042


def test_heartbeats_by_1017h(rig):
    assert rig.wait(10) == []
    assert rig.write(0x1017, 0, 100, 2) == 0
    assert rig.wait(0.09) == []
    assert rig.wait(0.02) == [(0x705, "7f")]
    rig.nmt(cia301.Command.START)
    rig.answers()
    assert rig.wait(0.11) == [(0x705, "05")]
    assert rig.write(0x1017, 0, 0, 2) == 0
    assert rig.wait(10) == []


@pytest.mark.parametrize(
    ("mode", "value", "behaviour", "outputs", "state"),
    [
        (0x00, 0x00, 0, 3, cia301.State.PRE_OPERATIONAL),
        (0xFF, 0x00, 0, 0, cia301.State.PRE_OPERATIONAL),
        (0xFE, 0x00, 2, 1, cia301.State.STOPPED),
        (0xFF, 0x02, 1, 2, cia301.State.OPERATIONAL),
    ],
)
def test_loss_of_the_master(rig, mode, value, behaviour, outputs, state):
    assert rig.write(0x1016, 1, 127 << 16 | 300, 4) == 0
    assert rig.write(0x6206, 1, mode) == 0
    assert rig.write(0x6207, 1, value) == 0
    assert rig.write(0x1029, 1, behaviour) == 0
    rig.nmt(cia301.Command.START)
    rig.say(0x205, b"\x03" + bytes(7))
    rig.answers()
    assert rig.wait(100) == [(0x185, "03" + 7 * " 00")]  # a master never heard is not missed
    rig.say(0x77F, b"\x05")
    assert rig.wait(0.29) == []
    rig.say(0x77F, b"\x05")
    assert rig.wait(0.29) == []
    assert (0x085, "30 81 11 00 00 00 00 00") in rig.wait(0.02)
    assert (rig.board.pins, rig.outputs(), rig.board.state) == (outputs, 3, state)
    recovery = [] if state is cia301.State.STOPPED else [(0x085, "00 00 00 00 00 00 00 00")]
    assert rig.say(0x77F, b"\x05") == recovery


def test_tpdo_on_start_and_on_arrival_if_allowed(rig):
    assert rig.nmt(cia301.Command.START) == [(0x185, "00" + 7 * " 00")]
    assert rig.say(0x205, b"\x03" + bytes(7)) == []
    assert rig.wait(0.09) == []
    assert rig.wait(0.01) == [(0x185, "03" + 7 * " 00")]
    assert rig.write(0x6005, 0, 0) == 0
    rig.say(0x205, bytes(8))
    assert rig.wait(0.2) == []
    assert rig.board.objects.number(0x6000, 1) == 0


def test_nonsense_is_counted(rig):
    rig.say(0x605, b"\x40")
    rig.say(0x605, b"\x60" + bytes(7))  # a segment of nothing
    rig.say(0, b"\x63\x05")
    assert rig.board.ignored == 3


def test_eds_is_complete(caplog):
    od = canopen.import_od(str(EDS), 5)
    assert not caplog.records
    assert od[0x1000].default == 0x00030191
    assert od[0x1400][1].default == 0x205
    assert all(index in od for index in range(1, 8))
    assert len([i for i in od if 0x6000 <= i <= 0x6FFF]) == 6
    for index in (0x6000, 0x6200):
        assert all(od[index][sub].pdo_mappable for sub in range(1, 9))


def test_segments_without_end_are_aborted(rig):
    rig.say(0x605, b"\x21\x00\x62\x01\0\0\0\0")
    answers = [rig.say(0x605, bytes([0x10 * (k % 2), *range(7)])) for k in range(10)]
    assert (0x585, "80 00 62 01 05 00 04 05") in answers[-1]
    for k in range(1000):
        rig.say(0x605, bytes([0x10 * (k % 2), *range(7)]))
    assert len(rig.board.sdo._buffer) <= 64
