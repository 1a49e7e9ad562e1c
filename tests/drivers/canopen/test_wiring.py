from __future__ import annotations

import pytest

from drivers.canopen.layout import lay_out
from drivers.canopen.pdo import Bit, Pdo, carries
from drivers.canopen.run.frames import assemble
from drivers.canopen.wiring import BusSettings, Channel, Timing, Wiring

CAN0 = BusSettings("can0", "virtual", "x")


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        (("a", "can0", 0, 0, 0), "node 0 is not in 1..126"),
        (("a", "can0", 127, 0, 0), "127 is the master"),
        (("a", "can0", 1, 2032, 0), "output 2032 is not in 0..2031"),
        (("a", "can0", 1, 0, -1), "input -1 is not in 0..2031"),
    ],
)
def test_a_channel_out_of_range_is_refused(channel, words):
    with pytest.raises(ValueError, match=words):
        Channel(*channel)


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ([("a", "can1", 1, 0, 0)], "bus can1 is not one of can0"),
        ([("a", "can0", 1, 0, 0), ("a", "can0", 1, 1, 1)], "actuator a is there twice"),
        ([("a", "can0", 1, 0, 0), ("b", "can0", 1, 0, 1)], "output can0/1 output 0 is there twice"),
        ([("a", "can0", 1, 0, 0), ("b", "can0", 1, 1, 0)], "input can0/1 input 0 is there twice"),
    ],
)
def test_a_wiring_that_contradicts_itself_is_refused(channels, words):
    with pytest.raises(ValueError, match=words):
        Wiring((CAN0,), tuple(Channel(*c) for c in channels))


@pytest.mark.parametrize(
    "times", [{"heartbeat": 0}, {"heartbeat": 0.4}, {"heartbeat_timeout": 70}, {"travel_time": -1}]
)
def test_times_out_of_range_are_refused(times):
    with pytest.raises(ValueError, match=next(iter(times))):
        Timing(**times)


def test_the_layout_follows_the_wiring_not_its_order():
    channels = (Channel("b", "can0", 9, 12, 3), Channel("a", "can0", 2, 0, None), Channel("c", "can0", 9, 1, 40))
    layout = lay_out(Wiring((CAN0,), channels))
    left, right = layout.boards
    assert [b.name for b in layout.boards] == ["can0/2", "can0/9"]
    assert (left.outputs, left.inputs, left.tpdos) == ((Bit(0b010, 1, False),), (), ())
    assert (left.actuators, left.sensed) == (0b010, 0)
    assert right.outputs == (Bit(0b001, 1 << 12, False), Bit(0b100, 1 << 1, False))
    assert right.inputs == (Bit(0b001, 1 << 3, False), Bit(0b100, 1 << 40, False))
    assert (right.actuators, right.sensed) == (0b101, 0b101)
    assert right.rpdos == (Pdo(0x1400, 0x209, (0x62000108, 0x62000208)),)
    assert right.tpdos == (Pdo(0x1800, 0x189, (0x60000108, 0x60000608)),)
    assert assemble(layout.boards, {1: right.rpdos})[0].bits == right.outputs
    assert layout.board_of == (1, 0, 1)


def test_neighbouring_lines_are_copied_at_once():
    outputs = (0, 1, 2, 12, 13, 3)
    channels = tuple(Channel(f"{k}", "can0", 2, output, None) for k, output in enumerate(outputs))
    [board] = lay_out(Wiring((CAN0,), channels)).boards
    [frame] = assemble([board], {0: board.rpdos})
    assert frame.runs == ((0, 0b111, 0), (3, 0b11, 12), (5, 0b1, 3))


def test_outputs_beyond_the_first_64_are_in_further_pdos():
    channels = tuple(Channel(f"{k}", "can0", 2, k, k) for k in range(0, 140, 4))
    [board] = lay_out(Wiring((CAN0,), channels)).boards
    assert [(pdo.parameters, pdo.cob_id, len(pdo.mapping)) for pdo in board.rpdos] == [
        (0x1400, 0x202, 8),
        (0x1401, 0x302, 8),
        (0x1402, 0x402, 2),
    ]
    assert [pdo.cob_id for pdo in board.tpdos] == [0x182, 0x282, 0x382]
    frames = assemble([board], {0: board.rpdos})
    assert sum(frame.lines for frame in frames) == (1 << 35) - 1


def test_more_outputs_than_four_pdos_carry_are_refused():
    channels = tuple(Channel(f"{k}", "can0", 2, 8 * k, None) for k in range(33))
    with pytest.raises(ValueError, match="can0/2: its outputs are in 33 bytes; 32 fit in four PDOs"):
        lay_out(Wiring((CAN0,), channels))


def test_mappings_of_bits_words_and_double_words_carry_the_same_outputs():
    assert carries((0x62200101, 0x62200301, 0x00050008, 0x63000210), 0x6200) == [(0, 0, 1), (2, 1, 1), (16, 10, 16)]
    assert carries((0x22010108, 0x62000108), 0x2201) == [(0, 0, 8)]
