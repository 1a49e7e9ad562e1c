from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.boards.outputs import assemble
from hyperbit.drivers.canopen.layout import Unfit, lay_out
from hyperbit.drivers.canopen.pdo import Bit, Pdo, carries
from hyperbit.drivers.canopen.wiring import BoardId, BusWiring, Channel, Timing, Wiring

CAN0 = BusWiring("can0", "virtual", "x")
NO_MORE = (None, None, frozenset(), None, None, None, None)  # from `output_off` to `on_loss`


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        (("a", "can0", 0, 0, 0), "node 0 is not in 1..126"),
        (("a", "can0", 127, 0, 0), "127 is the master"),
        (("a", "can0", 1, 2032, 0), "output 2032 is not in 0..2031"),
        (("a", "can0", 1, 0, -1), "input -1 is not in 0..2031"),
        (("a", "can0", 1, 0, 1, *NO_MORE, BoardId("can0", 127)), "127 is the master"),
    ],
)
def test_a_channel_out_of_range_is_refused(channel, words):
    with pytest.raises(ValueError, match=words):
        Channel(*channel)


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ([("a", "can1", 1, 0, 0)], "bus can1 is not one of can0"),
        ([("a", "can0", 1, 0, 0, *NO_MORE, BoardId("can1", 2))], "actuator a: bus can1 is not one of can0"),
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


def test_end_stops_may_be_on_other_boards_and_other_buses():
    far, near = BoardId("can1", 3), BoardId("can0", 4)
    channels = (
        Channel("a", "can0", 2, 0, 5, input_contracted=6, input_board=far, input_contracted_board=near),
        Channel("b", "can0", 2, 1, 6, input_board=far),
        Channel("c", "can0", 4, 1, 1),
        Channel("d", "can0", 2, 2, None),
    )
    wiring = Wiring((CAN0, BusWiring("can1", "virtual", "y")), channels)
    assert wiring.boards == (("can0", 2), ("can0", 4), ("can1", 3))
    layout = lay_out(wiring)
    outputs, both, inputs = layout.boards
    assert (outputs.name, outputs.inputs, outputs.tpdos) == ("can0/2", (), ())
    assert (outputs.actuators, outputs.sensed) == (0b1011, 0b0011), "a and b have end-stops, elsewhere"
    assert both.inputs == (Bit(0b100, 1 << 1, False), Bit(0b10000, 1 << 6, False))
    assert (both.actuators, both.sensed) == (0b0101, 0b0100)
    assert (inputs.name, inputs.outputs, inputs.rpdos, inputs.output_bits) == ("can1/3", (), (), 0)
    assert inputs.inputs == (Bit(0b0001, 1 << 5, False), Bit(0b0010, 1 << 6, False))
    assert (inputs.actuators, inputs.sensed, inputs.input_lines) == (0b0011, 0, 0b0011)
    assert [pdo.cob_id for pdo in inputs.tpdos] == [0x183]
    assert layout.board_of == (0, 0, 1, 0)
    assert layout.input_boards_of == ((1, 2), (2,), (1,), ())


def test_a_board_knows_the_two_outputs_of_each_pair():
    channels = (
        Channel("a", "can0", 2, 9, None, output_off=3),
        Channel("b", "can0", 2, 0, None),
        Channel("c", "can0", 3, 4, None, output_off=5),
    )
    assert [board.pairs for board in lay_out(Wiring((CAN0,), channels)).boards] == [
        ((1 << 9, 1 << 3),),
        ((1 << 4, 1 << 5),),
    ]


@pytest.mark.parametrize(
    ("channel", "off"),
    [
        ({}, True),  # a spring contracts it
        ({"inverted": frozenset({"output"})}, False),
        ({"output_off": 1}, False),  # 1 in 6207h energises the coil that contracts it
        ({"output_off": 1, "inverted": frozenset({"output_off"})}, True),
        ({"output_off": 1, "pulse": 0.05, "on_loss": "hold"}, True),
    ],
)
def test_a_board_knows_whether_its_loss_levels_are_all_off(channel, off):
    [board] = lay_out(Wiring((CAN0,), (Channel("a", "can0", 2, 0, None, **channel),), on_loss="contract")).boards
    assert board.loss_is_off is off


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
    with pytest.raises(Unfit, match="can0/2: its outputs are in 33 bytes; 32 fit in four PDOs") as caught:
        lay_out(Wiring((CAN0,), channels))
    assert (caught.value.board, caught.value.kind, caught.value.byte) == (("can0", 2), "output", 32)


def test_more_inputs_than_four_pdos_carry_are_refused():
    inputs = [*range(40, 70), 0, 1, 2]
    channels = tuple(Channel(f"{k}", "can0", 2, k, 8 * byte) for k, byte in enumerate(inputs))
    with pytest.raises(Unfit, match="can0/2: its inputs are in 33 bytes; 32 fit in four PDOs") as caught:
        lay_out(Wiring((CAN0,), channels))
    assert (caught.value.kind, caught.value.byte) == ("input", 69)


def test_mappings_of_bits_words_and_double_words_carry_the_same_outputs():
    assert carries((0x62200101, 0x62200301, 0x00050008, 0x63000210), 0x6200) == [(0, 0, 1), (2, 1, 1), (16, 10, 16)]
    assert carries((0x22010108, 0x62000108), 0x2201) == [(0, 0, 8)]
