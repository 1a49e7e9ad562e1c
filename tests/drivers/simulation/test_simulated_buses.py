"""Simulated buses: boards, actuators and faults of one arm, and their commands in words."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wiring import BoardId, BusWiring, Channel, Interlock, Timing, Wiring
from hyperbit.drivers.simulation import fault_commands
from hyperbit.drivers.simulation.buses import SimulatedBuses, board_names
from hyperbit.drivers.simulation.variants import VARIANTS, choose

BUSES = (BusWiring("can0", "virtual", "a"), BusWiring("can1", "virtual", "b"))
WIRING = Wiring(
    BUSES,
    (
        Channel("5.left", "can0", 5, 0, 0, output_off=1, input_contracted=1, travel=(0.4, 0.1)),
        Channel("5.right", "can0", 5, 2, 2, input_contracted=3, inverted=frozenset({"output", "input"})),
        Channel("6.left", "can1", 5, 0, 3, input_board=BoardId("can0", 6)),
    ),
    interlocks=(Interlock("door", "can1", 7, 4), Interlock("stop", "can1", 7, 5, inverted=True)),
)
NAMES = ["can0/5", "can0/6", "can1/5", "can1/7"]


class Rig:
    """All boards, operational since 1 s."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, Frame]] = []
        self.now = 0.0
        self.buses = SimulatedBuses(WIRING, Timing(travel_time=0.1), lambda *sent: self.sent.append(sent))
        self.buses.step(0.0)
        assert [frame for _, frame in self.sent] == [Frame(0x700 + int(name[-1]), b"\0") for name in NAMES]
        self.now = 1.0
        for bus in ("can0", "can1"):
            self.say(bus, 0, bytes([Command.START, 0]).hex())
        self.heard()

    def say(self, bus: str, cob_id: int, data: str = "") -> None:
        self.buses.receive(bus, Frame(cob_id, bytes.fromhex(data)), self.now)

    def switch(self, byte: int, bus: str = "can0") -> None:
        self.say(bus, 0x205, f"{byte:02x}" + 7 * "00")

    def go(self, until: float) -> None:
        while self.buses.next_due() < until:
            self.buses.step(self.buses.next_due())
        self.now = until
        self.buses.step(until)

    def heard(self) -> list[tuple[int, str]]:
        """Returns COB-ID and first byte of each frame."""
        heard = [(frame.id, frame.data[:1].hex()) for _, frame in self.sent]
        self.sent.clear()
        return heard

    def fault(self, line: str) -> None:
        fault_commands.perform(self.buses, *line.split())


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_two_outputs_move_an_actuator_there_and_back(rig: Rig) -> None:
    rig.switch(0b0001)
    rig.go(1.02)
    assert (rig.buses.drives(), rig.buses.switches()) == ([1, 1, 0], [1, 0, 0])
    rig.switch(0)
    rig.go(1.1)
    assert (rig.buses.positions(), rig.buses.coils()) == ([1.0, 1.0, 0.0], [(0, 0), (0, 0), (0, 0)])
    assert rig.heard() == [(0x185, "00"), (0x185, "01")]
    rig.go(2.0)
    rig.switch(0b0010)
    rig.go(2.105)
    rig.switch(0b0011)
    assert rig.buses.positions()[0] == pytest.approx(0.5)
    assert rig.buses.both_on() == [1, 0, 0]
    rig.go(2.5)
    assert rig.buses.positions() == [0.0, 1.0, 0.0], "the last winner stays"


def test_an_actuator_that_rests_extended_contracts_by_its_output(rig: Rig) -> None:
    rig.switch(0b0100)
    rig.go(2.0)
    assert (rig.buses.positions(), rig.buses.drives()) == ([0.0, 0.0, 0.0], [0, 0, 0])
    assert rig.heard()[-1] == (0x185, "0e"), "the inverted end-stop reads 1 where the actuator is not"
    rig.fault("power_cut can0/5")
    rig.go(3.0)
    assert rig.buses.positions() == [0.0, 1.0, 0.0]


def test_a_board_of_end_stops_sends_what_the_actuators_of_another_board_do(rig: Rig) -> None:
    rig.switch(1, "can1")
    rig.go(2.0)
    assert rig.heard() == [(0x186, "08")]
    rig.fault("power_cut can1/5")
    rig.go(3.0)
    assert rig.heard() == [(0x186, "00")], "its board has no supply"
    rig.fault("short_wires 6.left")
    assert rig.heard() == [(0x186, "08")]


def test_faults_by_words(rig: Rig) -> None:
    for line in ("stick 6.left extended", "slow 5.left 2", "lose_sensor 5.left", "silence can1/7"):
        rig.fault(line)
    rig.switch(0b0001)
    rig.go(1.055)
    assert rig.buses.positions() == [pytest.approx(0.5), 1.0, 1.0]
    rig.go(1.3)
    assert rig.heard() == [(0x186, "08")], "the end-stops of 5.left are frozen"
    rig.fault("restore_sensor 5.left")
    assert rig.heard() == [(0x185, "01")]
    rig.say("can1", 0x607, "4000100000000000")
    assert rig.heard() == [], "can1/7 is cut off"
    rig.fault("lose_tpdo can0/5")
    for _ in range(2):
        for command in (Command.PRE_OPERATIONAL, Command.START):
            rig.buses.receive("can0", cia301.command(command, 5), rig.now)
    assert rig.heard() == [(0x185, "01")], "of the two starts"


def test_interlocks_open_and_close(rig: Rig) -> None:
    for line, levels in (("open door", "00"), ("open stop", "20"), ("close door", "30"), ("close stop", "10")):
        rig.fault(line)
        assert rig.heard() == [(0x187, levels)]


def test_an_error_is_told_once_and_stands_until_it_is_over(rig: Rig) -> None:
    rig.fault("error can0/5 2320")
    rig.fault("error can0/5 2320")
    assert [frame.data.hex() for _, frame in rig.sent] == ["2023030000000000"]
    rig.say("can0", 0x605, "4001100000000000")
    assert rig.sent.pop()[1].data.hex() == "4f01100003000000"
    rig.heard()
    rig.fault("error_over can0/5 2320")
    assert rig.heard() == [(0x085, "00")]


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
        ("stick 7.left 1", r"'7\.left' is no actuator: did you mean .*\? Actuators: 5\.left, 5\.right, 6"),
        ("slow 5.left 0", "not a positive number"),
        ("slow 5.left fast", "not a positive number"),
        ("jam 5.left -1", "not a positive number"),
        ("error can0/5 xyz", "'xyz' is no error code"),
        ("power_cut can0/9", r"'can0/9' is no board: did you mean can0/\d\? Boards: can0/5, can0/6, can1/5"),
        ("open window", r"'window' is no interlock\. Interlocks: door, stop"),
    ],
)
def test_words_that_make_no_fault_are_refused(rig: Rig, line: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        fault_commands.play(rig.buses, line)


def test_a_command_is_answered_and_help_names_all_verbs(rig: Rig) -> None:
    assert fault_commands.play(rig.buses, " silence  can1/5\n") == "done: silence can1/5"
    told = fault_commands.play(rig.buses, "help")
    assert all(f"  {verb} " in told for verb in fault_commands.VERBS)
    assert len(told) < 1000, "an executor sends no longer answer"


def test_variants_by_words() -> None:
    assert board_names(WIRING) == NAMES
    chosen = choose(["can1/5=no-sync", "guarding-only"], NAMES[:3])
    assert chosen == {**dict.fromkeys(NAMES[:2], VARIANTS["guarding-only"]), "can1/5": VARIANTS["no-sync"]}
    assert choose([], NAMES) == {}
    with pytest.raises(ValueError, match="no variant x of boards, there are standard, guarding-only,"):
        choose(["can0/5=x"], NAMES)
    with pytest.raises(ValueError, match="no board can0/9, there are can0/5, can0/6"):
        choose(["can0/9=standard"], NAMES)
