"""The wiring: the layout of frames, and the load of an arm's own traffic, computed by hand."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.boards.outputs import assemble
from hyperbit.drivers.canopen.layout import Layout, Unfit, lay_out, worst_case
from hyperbit.drivers.canopen.pdo import Bit, Pdo, carries
from hyperbit.drivers.canopen.wire.cia301 import wire_bits
from hyperbit.drivers.canopen.wiring import BoardId, BusWiring, Channel, Timing, Wiring

CAN0, CAN1 = BusWiring("can0", "virtual", "x"), BusWiring("can1", "virtual", "y")


def laid_out(*channels: Channel, **options: object) -> Layout:
    return lay_out(Wiring((CAN0, CAN1), channels, **options))


def test_the_layout_follows_the_wiring_not_its_order() -> None:
    layout = laid_out(
        Channel("b", "can0", 9, 12, 3),
        Channel("a", "can0", 2, 0, None),
        Channel("c", "can0", 9, 1, 40),
    )
    left, right = layout.boards
    assert (left.name, left.outputs, left.inputs, left.tpdos) == ("can0/2", (Bit(0b010, 1, False),), (), ())
    assert (left.actuators, left.sensed) == (0b010, 0)
    assert (right.name, right.outputs) == ("can0/9", (Bit(0b001, 1 << 12, False), Bit(0b100, 1 << 1, False)))
    assert right.inputs == (Bit(0b001, 1 << 3, False), Bit(0b100, 1 << 40, False))
    assert (right.actuators, right.sensed) == (0b101, 0b101)
    assert right.rpdos == (Pdo(0x1400, 0x209, (0x62000108, 0x62000208)),)
    assert right.tpdos == (Pdo(0x1800, 0x189, (0x60000108, 0x60000608)),)
    assert assemble(layout.boards, {1: right.rpdos})[0].bits == right.outputs
    assert layout.board_of == (1, 0, 1)


def test_end_stops_may_be_on_other_boards_and_other_buses() -> None:
    far, near = BoardId("can1", 3), BoardId("can0", 4)
    layout = laid_out(
        Channel("a", "can0", 2, 0, 5, input_contracted=6, input_board=far, input_contracted_board=near),
        Channel("b", "can0", 2, 1, 6, input_board=far),
        Channel("c", "can0", 4, 1, 1),
        Channel("d", "can0", 2, 2, None),
    )
    outputs, both, inputs = layout.boards
    assert [board.name for board in layout.boards] == ["can0/2", "can0/4", "can1/3"]
    assert (outputs.inputs, outputs.tpdos) == ((), ())
    assert (outputs.actuators, outputs.sensed) == (0b1011, 0b0011), "a and b have end-stops, elsewhere"
    assert both.inputs == (Bit(0b100, 1 << 1, False), Bit(0b10000, 1 << 6, False))
    assert (both.actuators, both.sensed) == (0b0101, 0b0100)
    assert (inputs.outputs, inputs.rpdos, inputs.output_bits) == ((), (), 0)
    assert inputs.inputs == (Bit(0b0001, 1 << 5, False), Bit(0b0010, 1 << 6, False))
    assert (inputs.actuators, inputs.sensed, inputs.input_lines) == (0b0011, 0, 0b0011)
    assert [pdo.cob_id for pdo in inputs.tpdos] == [0x183]
    assert layout.board_of == (0, 0, 1, 0)
    assert layout.input_boards_of == ((1, 2), (2,), (1,), ())


def test_a_board_knows_the_two_outputs_of_each_pair() -> None:
    layout = laid_out(
        Channel("a", "can0", 2, 9, None, output_off=3),
        Channel("b", "can0", 2, 0, None),
        Channel("c", "can0", 3, 4, None, output_off=5),
    )
    assert [board.pairs for board in layout.boards] == [((1 << 9, 1 << 3),), ((1 << 4, 1 << 5),)]


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
def test_a_board_knows_whether_its_loss_levels_are_all_off(channel: dict[str, object], off: bool) -> None:
    [board] = laid_out(Channel("a", "can0", 2, 0, None, **channel), on_loss="contract").boards
    assert board.loss_is_off is off


def test_outputs_beyond_the_first_64_are_in_further_pdos_up_to_four() -> None:
    [board] = laid_out(*(Channel(f"{k}", "can0", 2, k, k) for k in range(0, 140, 4))).boards
    assert [(pdo.parameters, pdo.cob_id, len(pdo.mapping)) for pdo in board.rpdos] == [
        (0x1400, 0x202, 8),
        (0x1401, 0x302, 8),
        (0x1402, 0x402, 2),
    ]
    assert [pdo.cob_id for pdo in board.tpdos] == [0x182, 0x282, 0x382]
    assert sum(frame.lines for frame in assemble([board], {0: board.rpdos})) == (1 << 35) - 1
    with pytest.raises(Unfit, match="can0/2: its outputs are in 33 bytes; 32 fit in four PDOs") as outputs:
        laid_out(*(Channel(f"{k}", "can0", 2, 8 * k, None) for k in range(33)))
    assert (outputs.value.board, outputs.value.kind, outputs.value.byte) == (("can0", 2), "output", 32)
    bytes_used = [*range(40, 70), 0, 1, 2]
    with pytest.raises(Unfit, match="can0/2: its inputs are in 33 bytes; 32 fit in four PDOs") as inputs:
        laid_out(*(Channel(f"{k}", "can0", 2, k, 8 * byte) for k, byte in enumerate(bytes_used)))
    assert (inputs.value.kind, inputs.value.byte) == ("input", 69)


def test_mappings_of_bits_words_and_double_words_carry_the_same_outputs() -> None:
    assert carries((0x62200101, 0x62200301, 0x00050008, 0x63000210), 0x6200) == [(0, 0, 1), (2, 1, 1), (16, 10, 16)]
    assert carries((0x22010108, 0x62000108), 0x2201) == [(0, 0, 8)]


# The load.

TIMING = Timing(heartbeat=0.1, travel_time=0.05)


@pytest.mark.parametrize(("size", "bits"), [(0, 55), (1, 65), (2, 75), (6, 115), (8, 135)])
def test_bits_on_the_wire(size: int, bits: int) -> None:
    """The upper bound of Davis, Burns, Bril and Lukkien for a frame of 8 bytes is 135."""
    assert wire_bits(size) == bits == 8 * size + 44 + (34 + 8 * size - 1) // 4 + 3


@pytest.mark.parametrize(
    ("shared", "rpdos", "load"),
    [
        (False, 163_800, 0.73885),  # 126 frames of 65 bits, 20 times a second
        (True, 42_800, 0.61785),  # 15 frames of 8 bytes and one of 6: 15 x 135 + 115 bits, 20 times a second
    ],
)
def test_a_full_bus(shared: bool, rpdos: int, load: float) -> None:
    """127 nodes, as many as a bus can have: the master and 126 boards of three actuators with end-stops."""
    channels = (Channel(f"{node}.{k}", "can0", node, k, k) for node in range(1, 127) for k in range(3))
    traffic = worst_case(laid_out(*channels, shared_rpdo=shared), TIMING, CAN0)
    assert traffic.heartbeats == pytest.approx(82_550)  # 127 nodes, 65 bits, 10 times a second
    assert traffic.sync == pytest.approx(1_100)  # 55 bits, 20 times a second
    assert traffic.rpdos == pytest.approx(rpdos)
    assert traffic.tpdos == pytest.approx(491_400)  # 378 end-stops, 65 bits, 20 times a second
    assert traffic.load == pytest.approx(load)


def test_each_bus_has_its_own_boards_end_stops_and_bit_rate() -> None:
    buses = (BusWiring("a", "virtual", "a", 250_000), BusWiring("b", "virtual", "b"), BusWiring("c", "virtual", "c"))
    channels = (
        Channel("1", "a", 1, 0, 0, input_board=BoardId("c", 1)),
        Channel("2", "b", 1, 0, 0),
        Channel("3", "b", 1, 9, 9),
    )
    layout = lay_out(Wiring(buses, channels))
    a, b, c = (worst_case(layout, TIMING, bus) for bus in buses)
    assert (a.heartbeats, a.sync, a.rpdos, a.tpdos) == pytest.approx((1300, 1100, 1300, 0))
    assert a.load == pytest.approx(3700 / 250_000)
    assert (b.rpdos, b.tpdos) == pytest.approx((1500, 3000))  # two bytes each; two end-stops
    assert (c.sync, c.rpdos, c.tpdos) == pytest.approx((0, 0, 1300))
