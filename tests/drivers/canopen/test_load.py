"""The load of an arm's own traffic against figures computed by hand."""

import pytest

from hyperbit.drivers.canopen.layout import lay_out, worst_case
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wiring import BoardId, BusWiring, Channel, Timing, Wiring

TIMING = Timing(heartbeat=0.1, travel_time=0.05)


def full(shared: bool) -> Wiring:
    """127 nodes, as many as a bus can have: the master and 126 boards of three actuators with end-stops."""
    channels = (Channel(f"{node}.{k}", "can0", node, k, k) for node in range(1, 127) for k in range(3))
    return Wiring((BusWiring("can0", "virtual", "x", 1_000_000),), tuple(channels), shared_rpdo=shared)


@pytest.mark.parametrize(("size", "bits"), [(0, 55), (1, 65), (2, 75), (6, 115), (8, 135)])
def test_bits_on_the_wire(size, bits):
    """The upper bound of Davis, Burns, Bril and Lukkien for a frame of 8 bytes is 135."""
    assert cia301.wire_bits(size) == bits == 8 * size + 44 + (34 + 8 * size - 1) // 4 + 3


@pytest.mark.parametrize(
    ("shared", "rpdos", "load"),
    [
        (False, 163_800, 0.73885),  # 126 frames of 65 bits, 20 times a second
        (True, 42_800, 0.61785),  # 15 frames of 8 bytes and one of 6: 15 x 135 + 115 bits, 20 times a second
    ],
)
def test_a_full_bus(shared, rpdos, load):
    wiring = full(shared)
    traffic = worst_case(lay_out(wiring), TIMING, wiring.buses[0])
    assert traffic.heartbeats == pytest.approx(82_550)  # 127 nodes, 65 bits, 10 times a second
    assert traffic.sync == pytest.approx(1_100)  # 55 bits, 20 times a second
    assert traffic.rpdos == pytest.approx(rpdos)
    assert traffic.tpdos == pytest.approx(491_400)  # 378 end-stops, 65 bits, 20 times a second
    assert traffic.load == pytest.approx(load)


def test_each_bus_has_its_own_boards_and_bit_rate():
    buses = (BusWiring("a", "virtual", "a", 250_000), BusWiring("b", "virtual", "b"), BusWiring("c", "virtual", "c"))
    channels = Channel("1", "a", 1, 0, None), Channel("2", "b", 1, 0, 0), Channel("3", "b", 1, 9, 9)
    layout = lay_out(Wiring(buses, channels))
    a, b, c = (worst_case(layout, TIMING, bus) for bus in buses)
    assert (a.heartbeats, a.sync, a.rpdos, a.tpdos) == pytest.approx((1300, 1100, 1300, 0))
    assert a.load == pytest.approx(3700 / 250_000)
    assert (b.rpdos, b.tpdos) == pytest.approx((1500, 3000))  # two bytes each; two end-stops
    assert (c.heartbeats, c.sync, c.rpdos, c.tpdos) == pytest.approx((650, 0, 0, 0))


def test_end_stops_on_a_bus_of_their_own_load_that_bus():
    buses = BusWiring("a", "virtual", "a"), BusWiring("b", "virtual", "b")
    layout = lay_out(Wiring(buses, (Channel("1", "a", 1, 0, 0, input_board=BoardId("b", 1)),)))
    a, b = (worst_case(layout, TIMING, bus) for bus in buses)
    assert (a.rpdos, a.tpdos) == pytest.approx((1300, 0))
    assert (b.sync, b.rpdos, b.tpdos) == pytest.approx((0, 0, 1300))
