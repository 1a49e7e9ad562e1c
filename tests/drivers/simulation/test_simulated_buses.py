from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wiring import BoardId, BusWiring, Channel, Interlock, Timing, Wiring
from hyperbit.drivers.simulation import fault_commands
from hyperbit.drivers.simulation.buses import SimulatedBuses, board_names
from hyperbit.drivers.simulation.variants import VARIANTS, choose

WIRING = Wiring(
    buses=(BusWiring("can0", "virtual", "a"), BusWiring("can1", "virtual", "b")),
    channels=(
        *(Channel("5.left", "can0", 5, 0, 0), Channel("5.right", "can0", 5, 1, 1)),
        Channel("6.left", "can1", 5, 0, 0),
    ),
)
START, SYNC = Frame(0x000, b"\x01\x00"), Frame(0x080, b"")
EXTEND_BOTH = Frame(0x205, b"\x03" + bytes(7))
SPARE = 7 * "00"  # bytes of a TPDO that carry no input of these boards
SETTINGS = [  # SDO downloads: RPDO on SYNC, TPDO on change
    *(Frame(0x605, bytes.fromhex(text)) for text in ("2f 00 14 02 01 00 00 00", "2f 05 60 00 01 00 00 00"))
]


class Rig:
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
def rig() -> Rig:
    rig = Rig()
    assert rig.heard() == [("can0", 0x705, "00"), ("can1", 0x705, "00")]
    rig.receive("can0", *SETTINGS, START, now=1.0)
    rig.sent.clear()
    return rig


def test_actuators_move_while_time_passes_and_end_stops_are_sent_on_arrival(rig):
    rig.receive("can0", EXTEND_BOTH, SYNC, now=1.0)
    assert (rig.buses.drives(), rig.buses.switches()) == ([1, 1, 0], [1, 1, 0])
    assert rig.buses.next_due() == pytest.approx(1.0025), "the switches of the contracted ends open"
    rig.buses.step(1.025)
    assert rig.buses.next_due() == pytest.approx(1.05)
    assert rig.buses.positions() == pytest.approx([0.5, 0.5, 0.0])
    assert rig.heard() == []
    rig.buses.step(rig.buses.next_due())
    assert rig.buses.positions() == [1.0, 1.0, 0.0]
    assert rig.heard() == [("can0", 0x185, "03" + SPARE)]
    assert rig.buses.next_due() == float("inf")


def test_faults_by_words(rig):
    for line in ("stick 5.left extended", "slow 5.right 2", "lose_sensor 5.right", "silence can1/5"):
        fault_commands.perform(rig.buses, *line.split())
    rig.buses.step(1.05)
    assert rig.buses.positions() == [1.0, 0.0, 0.0]
    assert rig.heard() == [("can0", 0x185, "01" + SPARE)]
    rig.receive("can0", EXTEND_BOTH, SYNC, now=1.1)
    rig.buses.step(1.21)
    assert rig.buses.positions() == [1.0, 1.0, 0.0]
    assert rig.heard() == [], "the end-stop of 5.right is frozen"
    fault_commands.perform(rig.buses, "restore_sensor", "5.right")
    assert rig.heard() == [("can0", 0x185, "03" + SPARE)]
    rig.receive("can1", Frame(0x605, bytes.fromhex("4000100000000000")), now=1.21)
    assert rig.heard() == [], "can1/5 is cut off"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("", r"'' is no fault\. Faults: silence, unsilence"),
        ("explode 5.left", "'explode' is no fault"),
        ("silense can0/5", r"'silense' is no fault: did you mean silence\? Faults"),
        ("receive x", "'receive' is no fault"),
        ("silence", "'silence': needed is silence BOARD: disconnect"),
        ("silence can0/5 now", "needed is silence BOARD"),
        ("stick 5.left", "needed is stick ACTUATOR STATE"),
        ("stick 5.left 2", "'2' is no state: contracted .0. or extended .1. is needed"),
        ("slow 5.left 0", "not a positive number"),
        ("slow 5.left fast", "not a positive number"),
        ("jam 5.left -1", "not a positive number"),
        ("error can0/5 xyz", "'xyz' is no error code"),
    ],
)
def test_words_that_make_no_fault_are_refused(rig, line, said):
    with pytest.raises(ValueError, match=said):
        fault_commands.play(rig.buses, line)


def test_a_command_is_answered_and_help_names_all_verbs(rig):
    assert fault_commands.play(rig.buses, " silence  can1/5\n") == "done: silence can1/5"
    told = fault_commands.play(rig.buses, "help")
    assert all(f"  {verb} " in told for verb in fault_commands.VERBS)
    assert len(told) < 1000, "an executor sends no longer answer"


def test_names_that_are_not_there_are_refused_with_those_that_are(rig):
    with pytest.raises(
        ValueError, match=r"'7\.left' is no actuator: did you mean .*\? Actuators: 5\.left, 5\.right, 6"
    ):
        fault_commands.perform(rig.buses, "stick", "7.left", 1)
    with pytest.raises(ValueError, match=r"'can0/9' is no board: did you mean can0/5\? Boards: can0/5, can1/5"):
        fault_commands.perform(rig.buses, "power_cut", "can0/9")


def test_variants_by_words():
    names = board_names(WIRING)
    assert names == ["can0/5", "can1/5"]
    chosen = choose(["can1/5=no-sync", "guarding-only"], names)
    assert chosen == {"can0/5": VARIANTS["guarding-only"], "can1/5": VARIANTS["no-sync"]}
    assert choose([], names) == {}
    with pytest.raises(ValueError, match="no variant x of boards, there are standard, guarding-only,"):
        choose(["can0/5=x"], names)
    with pytest.raises(ValueError, match="no board can0/9, there are can0/5, can1/5"):
        choose(["can0/9=standard"], names)


KINDS = Wiring(
    buses=WIRING.buses,
    channels=(
        Channel("two", "can0", 5, 0, 0, output_off=1, input_contracted=1, travel=(0.4, 0.1)),
        Channel("resting extended", "can0", 5, 2, 2, input_contracted=3, inverted=frozenset({"output", "input"})),
    ),
    interlocks=(Interlock("door", "can1", 7, 4), Interlock("stop", "can1", 7, 5, inverted=True)),
)


@pytest.fixture
def kinds() -> Rig:
    rig = Rig.__new__(Rig)
    rig.sent = []
    rig.buses = SimulatedBuses(KINDS, Timing(), lambda *sent: rig.sent.append(sent))
    rig.buses.step(0.0)
    for bus in ("can0", "can1"):
        rig.receive(bus, Frame(0x000, b"\x01\x00"), now=0.0)
    return rig


def inputs(rig: Rig) -> list[int]:
    return [int(data[:2], 16) for _, cob_id, data in rig.heard() if cob_id & 0x780 == 0x180]


def test_two_outputs_move_an_actuator_there_and_back(kinds):
    assert inputs(kinds) == [0b0010, 0b01_0000]
    kinds.receive("can0", Frame(0x205, b"\x01" + bytes(7)), now=1.0)
    kinds.receive("can0", Frame(0x205, bytes(8)), now=1.02)
    kinds.buses.step(1.1)
    assert (kinds.buses.positions(), kinds.buses.coils()) == ([1.0, 1.0], [(0, 0), (0, 0)])
    assert inputs(kinds) == [0b0000, 0b0001]
    kinds.receive("can0", Frame(0x205, b"\x02" + bytes(7)), now=2.0)
    kinds.receive("can0", Frame(0x205, b"\x03" + bytes(7)), now=2.105)
    assert kinds.buses.positions() == pytest.approx([0.5, 1.0])
    assert kinds.buses.both_on() == [1, 0]
    kinds.buses.step(2.3)
    assert kinds.buses.positions() == [0.0, 1.0], "the last winner stays"


def test_an_actuator_that_rests_extended_contracts_by_its_output(kinds):
    assert kinds.buses.positions() == [0.0, 1.0]
    kinds.heard()
    kinds.receive("can0", Frame(0x205, b"\x04" + bytes(7)), now=1.0)
    kinds.buses.step(2.0)
    assert (kinds.buses.positions(), kinds.buses.drives()) == ([0.0, 0.0], [0, 0])
    assert inputs(kinds)[-1] == 0b1110, "the inverted end-stop reads 1 where the actuator is not"
    kinds.buses.power_cut("can0/5")
    kinds.buses.step(3.0)
    assert kinds.buses.positions() == [0.0, 1.0]


def test_interlocks_open_and_close(kinds):
    kinds.heard()
    for line, levels in (
        ("open door", 0b00_0000),
        ("open stop", 0b10_0000),
        ("close door", 0b11_0000),
        ("close stop", 0b01_0000),
    ):
        fault_commands.perform(kinds.buses, *line.split())
        assert inputs(kinds) == [levels]
    with pytest.raises(ValueError, match=r"'window' is no interlock\. Interlocks: door, stop"):
        fault_commands.perform(kinds.buses, "open", "window")


def test_an_error_is_told_once_and_stands_until_it_is_over(rig):
    fault_commands.perform(rig.buses, "error", "can0/5", "2320")
    fault_commands.perform(rig.buses, "error", "can0/5", "2320")
    assert rig.heard() == [("can0", 0x085, "2023030000000000")]
    rig.receive("can0", Frame(0x605, bytes.fromhex("4001100000000000")), now=1.0)
    assert rig.heard() == [("can0", 0x585, "4f01100003000000")]
    fault_commands.perform(rig.buses, "error_over", "can0/5", "2320")
    assert rig.heard() == [("can0", 0x085, "0000000000000000")]


def test_a_board_of_end_stops_sends_what_the_actuators_of_another_board_do():
    channel = Channel("1", "can0", 5, 0, 3, input_contracted=1, input_board=BoardId("can1", 6))
    wiring = Wiring(WIRING.buses, (channel,))
    sent: list[tuple[str, Frame]] = []
    buses = SimulatedBuses(wiring, Timing(travel_time=0.1), lambda *frame: sent.append(frame))
    assert board_names(wiring) == ["can0/5", "can1/6"]
    buses.step(0.0)
    for bus, node in (("can0", 5), ("can1", 6)):
        for frame in (*SETTINGS, Frame(0x605, bytes.fromhex("2f 06 60 01 ff 00 00 00"))):
            buses.receive(bus, Frame(0x600 + node, frame.data), 1.0)
        buses.receive(bus, START, 1.0)
    sent.clear()
    for frame in (Frame(0x205, b"\x01" + bytes(7)), SYNC):
        buses.receive("can0", frame, 1.0)
    while buses.next_due() < 2.0:
        buses.step(buses.next_due())
    assert [(bus, frame.id, frame.data[0]) for bus, frame in sent] == [("can0", 0x185, 0), ("can1", 0x186, 8)]
    buses.power_cut("can0/5")
    sent.clear()
    while buses.next_due() < 3.0:
        buses.step(buses.next_due())
    assert [(bus, frame.id, frame.data[0]) for bus, frame in sent] == [("can1", 0x186, 0)], "its board has no supply"
    with buses.actuator("1") as it:
        it.short_wires()
    assert [(bus, frame.id, frame.data[0]) for bus, frame in sent[1:]] == [("can1", 0x186, 8)]
