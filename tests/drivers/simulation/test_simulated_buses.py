from __future__ import annotations

import pytest

from drivers.canopen.cia301 import Frame
from drivers.canopen.wiring import BusSettings, Channel, Timing, Wiring
from drivers.simulation import fault_commands
from drivers.simulation.buses import SimulatedBuses

WIRING = Wiring(
    buses=(BusSettings("can0", "virtual", "a"), BusSettings("can1", "virtual", "b")),
    channels=(
        *(Channel("5.left", "can0", 5, 0, 0), Channel("5.right", "can0", 5, 1, 1)),
        Channel("6.left", "can1", 5, 0, 0),
    ),
)
START, SYNC = Frame(0x000, b"\x01\x00"), Frame(0x080, b"")
EXTEND_BOTH = Frame(0x205, b"\x03" + bytes(7))
SPARE = 7 * "00"  # bytes of a TPDO that carry no input of these boards
SETTINGS = [  # SDO downloads: RPDO on SYNC, TPDO on change
    *(Frame(0x605, bytes.fromhex(text)) for text in ("2f 00 14 02 01 00 00 00", "2f 05 60 00 01 00 00 00")),
]


class Bench:
    def __init__(self) -> None:
        self.sent: list[tuple[str, Frame]] = []
        self.buses = SimulatedBuses(WIRING, Timing(travel_time=0.1), lambda *sent: self.sent.append(sent))
        self.buses.step(0.0)

    def receive(self, bus: str, *frames: Frame, now: float) -> None:
        for frame in frames:
            self.buses.receive(bus, frame, now)

    def heard(self) -> list[tuple[str, int, str]]:
        heard = [(bus, frame.id, frame.data.hex()) for bus, frame in self.sent]
        self.sent.clear()
        return heard


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    assert bench.heard() == [("can0", 0x705, "00"), ("can1", 0x705, "00")]
    bench.receive("can0", *SETTINGS, START, now=1.0)
    bench.sent.clear()
    return bench


def test_boards_answer_on_their_own_bus_only(bench):
    bench.receive("can1", Frame(0x605, bytes.fromhex("4000100000000000")), now=1.0)
    assert [(bus, cob_id) for bus, cob_id, _ in bench.heard()] == [("can1", 0x585)]
    bench.receive("can1", Frame(0x606, bytes.fromhex("4000100000000000")), now=1.0)
    assert bench.heard() == []


def test_actuators_move_while_time_passes_and_end_stops_are_sent_on_arrival(bench):
    bench.receive("can0", EXTEND_BOTH, SYNC, now=1.0)
    assert (bench.buses.drives(), bench.buses.switches()) == ([1, 1, 0], [1, 1, 0])
    assert bench.buses.next_due() == pytest.approx(1.0025), "the switches of the contracted ends open"
    bench.buses.step(1.025)
    assert bench.buses.next_due() == pytest.approx(1.05)
    assert bench.buses.positions() == pytest.approx([0.5, 0.5, 0.0])
    assert bench.heard() == []
    bench.buses.step(bench.buses.next_due())
    assert bench.buses.positions() == [1.0, 1.0, 0.0]
    assert bench.heard() == [("can0", 0x185, "03" + SPARE)]
    assert bench.buses.next_due() == float("inf")


def test_an_arrival_before_a_frame_is_not_passed_over(bench):
    bench.receive("can0", EXTEND_BOTH, SYNC, now=1.0)
    bench.receive("can0", Frame(0x205, bytes(8)), SYNC, now=1.2)
    assert bench.heard() == [("can0", 0x185, "03" + SPARE)]


def test_faults_by_words(bench):
    for line in ("stick 5.left 1", "slow 5.right 2", "lose_sensor 5.right", "silence can1/5"):
        fault_commands.perform(bench.buses, *line.split())
    bench.buses.step(1.05)
    assert bench.buses.positions() == [1.0, 0.0, 0.0]
    assert bench.heard() == [("can0", 0x185, "01" + SPARE)]
    bench.receive("can0", EXTEND_BOTH, SYNC, now=1.1)
    bench.buses.step(1.21)
    assert bench.buses.positions() == [1.0, 1.0, 0.0]
    assert bench.heard() == [], "the end-stop of 5.right is frozen"
    fault_commands.perform(bench.buses, "restore_sensor", "5.right")
    assert bench.heard() == [("can0", 0x185, "03" + SPARE)]
    bench.receive("can1", Frame(0x605, bytes.fromhex("4000100000000000")), now=1.21)
    assert bench.heard() == [], "can1/5 is cut off"


def test_a_board_without_supply_contracts_its_actuators(bench):
    bench.receive("can0", EXTEND_BOTH, SYNC, now=1.0)
    bench.buses.step(1.1)
    bench.buses.power_cut("can0/5")
    bench.buses.step(1.2)
    assert (bench.buses.positions(), bench.buses.switches()) == ([0.0, 0.0, 0.0], [2, 2, 0])
    bench.sent.clear()
    bench.buses.power_on("can0/5")
    assert bench.heard() == [("can0", 0x705, "00")]


@pytest.mark.parametrize("line", ["", "explode 5.left", "stick 5.left", "stick 5.left 2", "slow 5.left 0", "receive x"])
def test_words_that_make_no_fault_are_refused(bench, line):
    with pytest.raises(ValueError, match=r"no fault|not a positive number"):
        fault_commands.perform(bench.buses, *line.split())


def test_names_that_are_not_there_are_refused_with_those_that_are(bench):
    with pytest.raises(KeyError, match=r"no actuator 7\.left, there are 5\.left, 5\.right, 6\.left"):
        fault_commands.perform(bench.buses, "stick", "7.left", 1)
    with pytest.raises(KeyError, match="no board can0/9, there are can0/5, can1/5"):
        fault_commands.perform(bench.buses, "power_cut", "can0/9")
