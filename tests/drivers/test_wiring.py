from __future__ import annotations

import pytest

from drivers import cia301
from drivers.layout import lay_out
from drivers.wiring import BusSettings, Channel, Timing, Wiring

CAN0 = BusSettings("can0", "virtual", "x")


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        (("a", "can0", 0, 0, 0), "node 0 is not in 1..126"),
        (("a", "can0", 127, 0, 0), "127 is the master"),
        (("a", "can0", 1, 64, 0), "output 64 is not in 0..63"),
        (("a", "can0", 1, 0, -1), "input -1 is not in 0..63"),
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


def test_layout_follows_the_wiring_not_its_order():
    channels = (Channel("b", "can0", 9, 12, 3), Channel("a", "can0", 2, 0, None), Channel("c", "can0", 9, 1, 40))
    layout = lay_out(Wiring((CAN0,), channels))
    assert [b.name for b in layout.boards] == ["can0/2", "can0/9"]
    assert layout.boards[1].outputs == (1, 2)
    assert layout.boards[1].inputs == (1, 6)
    assert layout.board.tolist() == [1, 0, 1]
    assert layout.byte.tolist() == [2, 0, 1]
    assert layout.bit.tolist() == [4, 0, 1]
    assert layout.input_byte.tolist() == [0, 0, 1]
    assert layout.sensed.tolist() == [True, False, True]


def test_worst_case_bits_of_a_frame():
    assert cia301.frame_bits(cia301.frame(0x80)) == 34 + 13 + 8
    assert cia301.frame_bits(cia301.frame(0x205, bytes(8))) == 135
