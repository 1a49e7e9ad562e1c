"""The standard board."""

from __future__ import annotations

import canopen
import pytest

from drivers.canopen.wire import cia301
from drivers.simulation.dictionary import EDS
from tests.drivers.simulation.bench import Bench


@pytest.fixture
def bench() -> Bench:
    bench = Bench((0, 0), (1, 1))
    assert bench.answers() == [(0x705, "00")]
    return bench


def on_sync(bench: Bench) -> None:
    assert bench.write(0x1400, 2, 1) == 0


def test_boots_into_pre_operational_and_is_deaf_to_rpdos_there(bench):
    bench.say(0x205, bytes(8))
    assert bench.say(0x205, b"\x01" + bytes(7)) == []
    assert bench.outputs() == 0


def test_resets_boot_again(bench):
    bench.nmt(cia301.Command.START)
    bench.say(0x205, b"\x01" + bytes(7))
    assert bench.nmt(cia301.Command.RESET_COMMUNICATION) == [(0x705, "00")]
    assert bench.outputs() == 1
    assert bench.nmt(cia301.Command.RESET_NODE, 0) == [(0x705, "00")]
    assert bench.outputs() == 0
    assert bench.nmt(cia301.Command.RESET_NODE, 6) == []


def test_latches_until_sync_or_acts_at_once_by_transmission_type(bench):
    bench.nmt(cia301.Command.START)
    bench.say(0x205, b"\x01" + bytes(7))
    assert bench.outputs() == 1
    on_sync(bench)
    bench.say(0x205, b"\x02" + bytes(7))
    assert bench.outputs() == 1
    bench.say(0x205, b"\x03" + bytes(7))
    bench.say(0x080)
    assert bench.outputs() == 3


def test_leaving_operational_forgets_what_was_latched(bench):
    on_sync(bench)
    bench.nmt(cia301.Command.START)
    bench.say(0x205, b"\x01" + bytes(7))
    bench.nmt(cia301.Command.PRE_OPERATIONAL)
    bench.nmt(cia301.Command.START)
    bench.say(0x080)
    assert bench.outputs() == 0


def test_tells_a_wrong_pdo_length_and_its_end(bench):
    bench.nmt(cia301.Command.START)
    assert bench.say(0x205, b"\x01") == [(0x085, "10 82 11 00 00 00 00 00")]
    assert bench.outputs() == 0
    assert bench.say(0x205, b"\x01") == []
    assert bench.say(0x205, b"\x01" + bytes(7)) == [(0x085, "00 00 00 00 00 00 00 00")]
    assert bench.board.objects.number(0x1003, 0) == 1
    assert bench.write(0x1003, 0, 0) == 0
    assert bench.board.objects.number(0x1003, 1) == 0


def test_a_mapping_with_dummies_takes_its_own_byte(bench):
    for index, sub, value, size in (
        (0x1400, 1, 0x80000201, 4),
        (0x1600, 0, 0, 1),
        (0x1600, 1, 0x00050008, 4),
        (0x1600, 2, 0x62000108, 4),
        (0x1600, 3, 0x00070020, 4),
        (0x1600, 0, 3, 1),
        (0x1400, 1, 0x00000201, 4),
    ):
        assert bench.write(index, sub, value, size) == 0
    bench.nmt(cia301.Command.START)
    bench.say(0x201, b"\xff\x02\xff\xff\xff\xff")
    assert bench.outputs() == 2
    bench.say(0x205, bytes(8))
    assert bench.outputs() == 2


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
def test_refuses_what_a_board_refuses(bench, index, sub, value, size, abort):
    assert bench.write(index, sub, value, size) == abort


def test_refuses_to_map_what_is_not_there_or_too_much(bench):
    assert bench.write(0x1400, 1, 0x80000205, 4) == 0
    assert bench.write(0x1600, 0, 0) == 0
    assert bench.write(0x1600, 1, 0x62020108, 4) == 0x06040041
    assert bench.write(0x1600, 1, 0x62000110, 4) == 0x06040041
    assert bench.write(0x1600, 1, 0x00070020, 4) == 0
    assert bench.write(0x1600, 2, 0x00070020, 4) == 0
    assert bench.write(0x1600, 0, 3) == 0x06040042
    assert bench.write(0x1600, 0, 9) == 0x06040042


def test_heartbeats_by_1017h(bench):
    assert bench.wait(10) == []
    assert bench.write(0x1017, 0, 100, 2) == 0
    assert bench.wait(0.09) == []
    assert bench.wait(0.02) == [(0x705, "7f")]
    bench.nmt(cia301.Command.START)
    bench.answers()
    assert bench.wait(0.11) == [(0x705, "05")]
    assert bench.write(0x1017, 0, 0, 2) == 0
    assert bench.wait(10) == []


@pytest.mark.parametrize(
    ("mode", "value", "behaviour", "outputs", "state"),
    [
        (0x00, 0x00, 0, 3, cia301.State.PRE_OPERATIONAL),
        (0xFF, 0x00, 0, 0, cia301.State.PRE_OPERATIONAL),
        (0xFE, 0x00, 2, 1, cia301.State.STOPPED),
        (0xFF, 0x02, 1, 2, cia301.State.OPERATIONAL),
    ],
)
def test_loss_of_the_master(bench, mode, value, behaviour, outputs, state):
    assert bench.write(0x1016, 1, 127 << 16 | 300, 4) == 0
    assert bench.write(0x6206, 1, mode) == 0
    assert bench.write(0x6207, 1, value) == 0
    assert bench.write(0x1029, 1, behaviour) == 0
    bench.nmt(cia301.Command.START)
    bench.say(0x205, b"\x03" + bytes(7))
    bench.answers()
    assert bench.wait(100) == [(0x185, "03" + 7 * " 00")]  # a master never heard is not missed
    bench.say(0x77F, b"\x05")
    assert bench.wait(0.29) == []
    bench.say(0x77F, b"\x05")
    assert bench.wait(0.29) == []
    assert (0x085, "30 81 11 00 00 00 00 00") in bench.wait(0.02)
    assert (bench.board.pins, bench.outputs(), bench.board.state) == (outputs, 3, state)
    recovery = [] if state is cia301.State.STOPPED else [(0x085, "00 00 00 00 00 00 00 00")]
    assert bench.say(0x77F, b"\x05") == recovery


def test_stopping_takes_the_error_values_and_ends_sdo(bench):
    bench.nmt(cia301.Command.START)
    bench.say(0x205, b"\x03" + bytes(7))
    bench.nmt(cia301.Command.STOP)
    assert (bench.board.pins, bench.outputs()) == (0, 3)
    assert bench.say(0x605, b"\x40\x00\x10\x00\0\0\0\0") == []


def test_tpdo_on_start_and_on_arrival_if_allowed(bench):
    assert bench.nmt(cia301.Command.START) == [(0x185, "00" + 7 * " 00")]
    assert bench.say(0x205, b"\x03" + bytes(7)) == []
    assert bench.wait(0.09) == []
    assert bench.wait(0.01) == [(0x185, "03" + 7 * " 00")]
    assert bench.write(0x6005, 0, 0) == 0
    bench.say(0x205, bytes(8))
    assert bench.wait(0.2) == []
    assert bench.board.objects.number(0x6000, 1) == 0


def test_polarity_inverts_the_drives(bench):
    assert bench.write(0x6202, 1, 0x01) == 0
    bench.wait(1)
    assert [a.position for a in bench.actuators] == [1, 0]


def test_power_cut_silences_the_board_and_springs_the_actuators_back(bench):
    bench.nmt(cia301.Command.START)
    bench.say(0x205, b"\x03" + bytes(7))
    bench.wait(1)
    bench.board.power_cut(bench.now)
    assert bench.wait(1) == []
    assert [a.position for a in bench.actuators] == [0, 0]
    assert bench.say(0x605, b"\x40\x00\x10\x00\0\0\0\0") == []
    bench.board.power_on(bench.now)
    assert bench.answers() == [(0x705, "00")]
    assert [a.switches for a in bench.actuators] == [2, 2]


def test_nonsense_is_counted(bench):
    bench.say(0x605, b"\x40")
    bench.say(0x605, b"\x60" + bytes(7))  # a segment of nothing
    bench.say(0, b"\x63\x05")
    assert bench.board.ignored == 3


def test_a_long_value_is_read_in_segments(bench):
    assert bench.say(0x605, b"\x40\x08\x10\x00\0\0\0\0") == [(0x585, "41 08 10 00 13 00 00 00")]
    assert bench.say(0x605, b"\x60" + bytes(7)) == [(0x585, "00 " + b"simulat".hex(" "))]


def test_eds_is_complete(caplog):
    od = canopen.import_od(str(EDS), 5)
    assert not caplog.records
    assert od[0x1000].default == 0x00030191
    assert od[0x1400][1].default == 0x205
    assert all(index in od for index in range(1, 8))
    assert len([i for i in od if 0x6000 <= i <= 0x6FFF]) == 6
    for index in (0x6000, 0x6200):
        assert all(od[index][sub].pdo_mappable for sub in range(1, 9))


def test_segments_without_end_are_aborted(bench):
    bench.say(0x605, b"\x21\x00\x62\x01\0\0\0\0")
    answers = [bench.say(0x605, bytes([0x10 * (k % 2), *range(7)])) for k in range(10)]
    assert (0x585, "80 00 62 01 05 00 04 05") in answers[-1]
    for k in range(1000):
        bench.say(0x605, bytes([0x10 * (k % 2), *range(7)]))
    assert len(bench.board._sdo._buffer) <= 64
