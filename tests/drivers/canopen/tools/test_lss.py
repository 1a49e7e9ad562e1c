"""LSS master and simulated LSS slaves, frame by frame."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hyperbit.drivers.canopen.tools.lss import Lss, LssIdentity, LssRefused
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import FrameEchoed
from hyperbit.drivers.simulation.lss import ANSWER, REQUEST, UNCONFIGURED, LssSlave
from tests.drivers.rig import World, two_boards
from tests.drivers.sessions import SessionInWorld

ONE, TWO = LssIdentity(0x21, 337, 0x10000, 0xDEADBEEF), LssIdentity(0x21, 337, 0x10000, 0xDEADBEEE)
THREE, FOUR = LssIdentity(1, 2, 3, 4), LssIdentity(7, 7, 7, 7)


class CanopenNodeSlave(LssSlave):
    """Answers each fast scan while it is selected, as CANopenNode does."""

    def scan(self, *request: int) -> None:
        if self.state:
            self.answer(b"\x4f")
        else:
            super().scan(*request)


class LelySlave(LssSlave):
    """Answers fast scans whatever its node id is, as Lely does."""

    def scan(self, *request: int) -> None:
        node, self.node = self.node, UNCONFIGURED
        super().scan(*request)
        self.node = node


class Wire:
    """A session whose slaves answer at once.

    Attributes:
        lost: whether the slaves lose a request, by its number and data.
        passes: takes the answers to a request, and returns the frames that come after it.
    """

    def __init__(self, *slaves: tuple[LssIdentity, int], kind: type[LssSlave] = LssSlave) -> None:
        self.heard: list[Frame] = []
        self.requests: list[str] = []
        self.lost: Callable[[int, bytes], bool] = lambda number, data: False
        self.passes: Callable[[list[Frame]], list[Frame]] = list
        self.slaves = [kind(identity, node, self._hear) for identity, node in slaves]
        self.lss = Lss(self, "can0")  # type: ignore[arg-type]
        self._answers: list[Frame] = []

    def _hear(self, cob_id: int, data: bytes) -> None:
        self._answers.append(Frame(cob_id, data))

    def send_frame(self, bus: str, frame: Frame) -> None:
        self.requests.append(frame.data.hex(" "))
        self._answers.clear()
        if not self.lost(len(self.requests) - 1, frame.data):
            for slave in self.slaves:
                slave.receive(frame.data)
        self.heard += self.passes(list(self._answers))

    def wait(self, until: Callable[[], bool], seconds: float) -> bool:
        return until()

    def stored(self) -> list[tuple[int, int]]:
        """Returns node id and bit rate that each slave has stored."""
        return [slave.stored for slave in self.slaves]


def test_the_only_board_gets_its_node_id_and_bit_rate() -> None:
    wire = Wire((ONE, UNCONFIGURED))
    assert wire.lss.select(None) == (ONE, UNCONFIGURED)
    wire.lss.configure(UNCONFIGURED, 5, 500_000)
    wire.lss.release()
    [slave] = wire.slaves
    assert (slave.stored, slave.node, slave.state) == ((5, 2), UNCONFIGURED, 0)
    slave.reset()
    assert slave.node == 5
    assert wire.requests[:2] == ["04 00 00 00 00 00 00 00", "04 01 00 00 00 00 00 00"]
    assert wire.requests[-4:] == [
        "11 05 00 00 00 00 00 00",
        "13 00 02 00 00 00 00 00",
        "17 00 00 00 00 00 00 00",
        "04 00 00 00 00 00 00 00",
    ]


def test_one_of_several_is_named_by_its_identity_and_without_a_name_all_keep_what_they_have() -> None:
    wire = Wire((ONE, 3), (TWO, 4))
    with pytest.raises(LssRefused, match="several boards answer"):
        wire.lss.select(None)
    assert wire.stored() == [(3, 0), (4, 0)]
    assert wire.lss.select(TWO) == (TWO, 4)
    wire.lss.configure(4, 9, None)
    assert wire.stored() == [(3, 0), (9, 0)]


def test_no_board_and_a_refusal_are_told() -> None:
    with pytest.raises(LssRefused, match="no board answers by LSS"):
        Wire().lss.select(None)
    with pytest.raises(LssRefused, match="select 0x21:0x151:0x10000:0xdeadbeee: no board answers"):
        Wire((ONE, 3)).lss.select(TWO)
    wire = Wire((ONE, 3))
    wire.lss.select(None)
    with pytest.raises(LssRefused, match=r"node id 200: the board refuses: it is out of range"):
        wire.lss.configure(3, 200, None)
    wire.lost = lambda number, data: data[0] == 0x17
    with pytest.raises(LssRefused, match="store: no board answers by LSS"):
        wire.lss.configure(3, 9, None)
    assert (wire.stored(), wire.slaves[0].pending) == ([(3, 0)], (3, 0))


@pytest.mark.parametrize("identity", [None, ONE])
def test_a_board_that_an_earlier_session_left_in_configuration_is_selected(identity: LssIdentity | None) -> None:
    wire = Wire((ONE, 3))
    [slave] = wire.slaves
    slave.state = 1
    assert wire.lss.select(identity) == (ONE, 3)
    slave.state, slave.node = 1, UNCONFIGURED
    assert wire.lss.unconfigured() == [ONE]


@pytest.mark.parametrize("identity", [None, ONE])
@pytest.mark.parametrize("number", range(12))
def test_any_lost_request_is_repeated(identity: LssIdentity | None, number: int) -> None:
    wire = Wire((ONE, 3))
    wire.lost = lambda k, data: k == number
    assert wire.lss.select(identity) == (ONE, 3)
    wire.lss.configure(3, 9, None)
    assert wire.stored() == [(9, 0)]


def late(wire: Wire, in_time: int) -> None:
    """Answers come one request late, but for the first ones."""
    waiting: list[Frame] = []

    def passes(answers: list[Frame]) -> list[Frame]:
        now, waiting[:] = waiting + answers[:in_time], answers[in_time:]
        return now

    wire.passes = passes


def test_a_slow_board_is_asked_again_and_a_late_answer_is_told_from_that_of_another_request() -> None:
    wire = Wire((ONE, 3))
    late(wire, in_time=0)
    assert wire.lss.select(None) == (ONE, 3)
    wire.lss.configure(3, 9, 250_000)
    assert wire.stored() == [(9, 3)]


def test_a_late_answer_of_a_second_board_is_noticed() -> None:
    wire = Wire((ONE, UNCONFIGURED), (TWO, UNCONFIGURED))
    late(wire, in_time=1)
    with pytest.raises(LssRefused, match="several boards answer"):
        wire.lss.select(None)
    assert wire.stored() == [(UNCONFIGURED, 0)] * 2


def test_a_board_on_this_computer_is_heard_though_its_frames_are_echoes() -> None:
    world = World()
    world.fault("silence", "can0/5")
    with SessionInWorld(world) as asking:
        bus = asking.buses["can0"]
        slave = LssSlave(ONE, 3, lambda cob_id, data: bus.events.append(FrameEchoed("can0", Frame(cob_id, data), None)))
        bus.sent = lambda frame: slave.receive(frame.data)
        assert Lss(asking, "can0").select(None) == (ONE, 3)


@pytest.mark.parametrize("kind", [LssSlave, CanopenNodeSlave, LelySlave])
def test_boards_without_a_node_id_are_listed_once(kind: type[LssSlave]) -> None:
    assert Wire().lss.unconfigured() == []
    wire = Wire((ONE, UNCONFIGURED), kind=kind)
    assert wire.lss.unconfigured() == [ONE]
    assert len(wire.requests) < 400
    if kind is not CanopenNodeSlave:
        wire = Wire((ONE, UNCONFIGURED), (FOUR, 5), (TWO, UNCONFIGURED), (THREE, UNCONFIGURED), kind=kind)
        assert sorted(wire.lss.unconfigured()) == sorted([ONE, TWO, THREE])
        assert all(slave.state == 0 for slave in wire.slaves)


def test_a_simulated_board_has_its_new_node_id_after_power_on() -> None:
    world = World(two_boards())
    world.run(0.05)
    for data in ("04 01", "11 21", "17"):
        world.say(REQUEST, bytes.fromhex(data).ljust(8, b"\0"))
        world.run(0.01)
        world.board("can0/9").lss.state = 0  # which is not meant
    assert [data for cob_id, data in world.frames() if cob_id == ANSWER] == ["11 00" + " 00" * 6, "17 00" + " 00" * 6]
    assert world.board().node == 5
    world.fault("power_on", "can0/5")
    assert world.board().node == 33
    world.frames()
    world.say(0x600 + 33, bytes.fromhex("40 00 10 00 00 00 00 00"))
    world.run(0.01)
    assert (0x5A1, "43 00 10 00 91 01 03 00") in world.frames(sdo=True)
    assert world.objects.number(0x1400, 1) == 0x200 + 33
