"""What simulated boards drop, round or refuse, and TPDOs by the event timer."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command
from hyperbit.drivers.canopen.wiring import BusWiring, Timing, Wiring
from hyperbit.drivers.simulation.buses import SimulatedBuses
from hyperbit.drivers.simulation.fault_commands import perform
from tests.drivers.rig import one_board
from tests.drivers.simulation.rig import EXTEND, booted

OFF, ON = (0x185, "00" + 7 * " 00"), (0x185, EXTEND)


def test_synchronous_rpdos_after_the_window_are_dropped():
    it = booted("sync-window")
    assert it.sdo("40 07 10 00") == "43 07 10 00 10 27 00 00"
    assert it.write(0x1400, 2, 1) == 0
    it.nmt(Command.START)
    it.say(0x205, EXTEND)
    it.say(0x080)
    assert it.board.pins == 3, "before the first SYNC there is no window"
    it.wait(0.009)
    it.say(0x205, bytes(8))
    it.wait(0.1)
    it.say(0x205, EXTEND)
    it.say(0x080)
    assert it.board.pins == 0, "the first RPDO came within the window, the second one after it"
    assert it.write(0x1007, 0, 0, 4) == 0
    it.say(0x080)
    it.wait(0.1)
    it.say(0x205, EXTEND)
    it.say(0x080)
    assert it.board.pins == 3


@pytest.mark.parametrize(
    ("name", "index", "sub", "value", "size", "kept"),
    [
        ("rounded-guarding", 0x100C, 0, 88, 2, 80),
        ("rounded-heartbeats", 0x1017, 0, 99, 2, 90),
        ("rounded-heartbeats", 0x1016, 1, 127 << 16 | 355, 4, 127 << 16 | 350),
        ("standard", 0x1017, 0, 99, 2, 99),
    ],
)
def test_times_are_rounded_down(name, index, sub, value, size, kept):
    it = booted(name)
    assert it.write(index, sub, value, size) == 0
    assert it.board.objects.number(index, sub) == kept


def test_one_node_is_watched_by_one_entry_only():
    it = booted("watched-already")
    assert it.write(0x1016, 1, 127 << 16 | 300, 4) == 0x0604_0043
    assert it.write(0x1016, 1, 126 << 16 | 300, 4) == 0
    assert it.write(0x1016, 2, 127 << 16 | 300, 4) == 0, "the entry itself may change"
    it.say(0x77F, "05")
    assert [cob_id for cob_id, _ in it.wait(0.31)] == [0x085]


@pytest.mark.parametrize(("name", "heard"), [("standard", 1), ("no-emergencies", 0)])
def test_emergencies_come_only_if_1014h_enables_them(name, heard):
    it = booted(name)
    it.board.emergencies.report(0x2320)
    assert len(it.answers()) == heard
    assert it.board.objects.number(0x1001) == 0x03
    if not heard:
        assert it.sdo("40 14 10 00") == "43 14 10 00 85 00 00 80"
        assert it.write(0x1014, 0, 0x85, 4) == 0
        it.board.emergencies.recover(0x2320)
        assert it.answers() == [(0x085, "00 00 00 00 00 00 00 00")]


def test_the_event_timer_repeats_a_tpdo_while_the_board_is_operational():
    it = booted()
    assert it.write(0x1800, 5, 100, 2) == 0
    assert it.wait(1.0) == []
    assert it.nmt(Command.START) == [OFF]
    assert it.wait(0.09) == []
    assert it.board.timer == pytest.approx(1.1)
    assert it.wait(0.011) == [OFF]
    it.say(0x205, EXTEND)
    assert it.wait(0.1) == [ON]
    assert it.wait(0.1) == [ON]
    it.nmt(Command.PRE_OPERATIONAL)
    assert it.wait(1.0) == []


@pytest.mark.parametrize(("timer", "after"), [(0, []), (150, [ON])])
def test_a_lost_tpdo_comes_again_only_by_the_event_timer(timer, after):
    it = booted()
    assert it.write(0x1800, 5, timer, 2) == 0
    it.nmt(Command.START)
    it.board.lose_tpdo()
    it.say(0x205, EXTEND)
    assert it.wait(0.1) == [], "the change of the inputs is lost"
    assert it.board.objects.number(0x6000, 1) == 3
    assert it.wait(0.151) == after


def test_a_fault_command_loses_the_next_tpdo_of_a_board():
    frames: list[cia301.Frame] = []
    wiring = Wiring((BusWiring("can0", "simulated", "can0"),), tuple(one_board()))
    boards = SimulatedBuses(wiring, Timing(), lambda bus, frame: frames.append(frame))
    boards.step(0.0)
    perform(boards, "lose_tpdo", "can0/5")
    for _ in range(2):
        boards.receive("can0", cia301.command(Command.PRE_OPERATIONAL, 5), 0.0)
        boards.receive("can0", cia301.command(Command.START, 5), 0.0)
    assert [frame.id for frame in frames if frame.id == 0x185] == [0x185], "of the two starts"
