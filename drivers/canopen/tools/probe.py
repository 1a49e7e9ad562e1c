"""Finds all nodes of a bus, and reads the important objects of each; writes nothing."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, field

from drivers.canopen.boot.pdo_setup import PdoState, read_pdo
from drivers.canopen.faults import ArmFault
from drivers.canopen.sdo import objects
from drivers.canopen.sdo.client import SdoOutcome, Transfer
from drivers.canopen.sdo.procedure import BoardError, Procedure, Runner, Step
from drivers.canopen.tools.conversation import converse
from drivers.canopen.tools.node_states import NodeStates
from drivers.canopen.wire import cia301
from drivers.canopen.wire.bus import CanBus
from drivers.canopen.wire.cia301 import Frame, State
from drivers.canopen.wire.events import BusChanged, Event, FrameEchoed, FrameReceived
from drivers.canopen.wire.link import Link
from drivers.canopen.wiring import MASTER, BusWiring

NODES = range(1, 128)
_FIRST, _TRIES = 0.5, 2  # [s] for the first answer of a node, and attempts
_LISTEN = 1.2  # [s] for heartbeats, at least
_STUCK_AFTER = 0.5  # [s]
_PDOS = 32  # RPDOs and TPDOs that are searched
_MOST_SUBS = 32  # entries of an array that are read

TEXTS = (0x1008, 0x1009, 0x100A)
_NUMBERS = (
    (0x1001, 0),
    (0x1005, 0),
    (0x1006, 0),
    (0x100C, 0),
    (0x100D, 0),
    (0x1010, 1),
    (0x1017, 0),
    (0x1019, 0),
    (0x1029, 1),
)
_ARRAYS = (0x1003, 0x1016, 0x1018, 0x6202, 0x6206, 0x6207)
_COUNTS = (0x6000, 0x6200)  # arrays whose sub-index 0 alone is read


@dataclass
class ProbedNode:
    """One node of a bus.

    Attributes:
        node: node id.
        state: last NMT state; None if neither a heartbeat nor an answer to a remote frame came.
        answers: whether it answers SDO requests.
        numbers: unsigned numbers by index and sub-index.
        texts: texts by index.
        refused: SDO abort codes of objects that exist and cannot be read, by index and sub-index.
        rpdos: its RPDOs.
        tpdos: its TPDOs.
        trouble: why the probe of this node ended early, as a sentence.
    """

    node: int
    state: State | None = None
    answers: bool = False
    numbers: dict[tuple[int, int], int] = field(default_factory=dict)
    texts: dict[int, str] = field(default_factory=dict)
    refused: dict[tuple[int, int], int] = field(default_factory=dict)
    rpdos: list[PdoState] = field(default_factory=list)
    tpdos: list[PdoState] = field(default_factory=list)
    trouble: str | None = None


class Probe:
    """Asks all nodes of a bus in parallel, and listens to heartbeats; without I/O and clock, like the master.

    A node that neither answers nor sends heartbeats is polled by a remote frame: it may be stopped.

    Attributes:
        fault: why the bus could not be used; None if it could.

    Args:
        bus: the bus.
        send: hands out a frame for a bus, by its name; must not call the probe.
        nodes: node ids to ask.
        in_full: read all important objects; otherwise only 1000h and 1018h.
    """

    def __init__(
        self,
        bus: BusWiring,
        send: Callable[[str, Frame], None],
        nodes: Iterable[int] = NODES,
        *,
        in_full: bool = True,
    ) -> None:
        self.fault: ArmFault | None = None
        self._link = Link(bus, send, _STUCK_AFTER)
        self._states = NodeStates(self._link)
        self._nodes = {node: ProbedNode(node) for node in nodes}
        self._runners = {node: Runner(node, self._link) for node in self._nodes}
        self._in_full = in_full
        self._until: float | None = None

    @property
    def over(self) -> bool:
        """Whether all nodes have answered or timed out, and the time for heartbeats is over."""
        if self.fault is not None:
            return True
        return self._until == -1.0 and not any(runner.running for runner in self._runners.values())

    @property
    def master_heard(self) -> bool:
        """Whether a master, such as an executor, sends its heartbeat."""
        return self._states.master_heard

    @property
    def found(self) -> list[ProbedNode]:
        """The nodes that have answered or were heard, by node id."""
        for number, node in self._nodes.items():
            node.state = self._states.states.get(number)
        return [node for node in self._nodes.values() if node.answers or node.state is not None]

    def start(self, now: float) -> None:
        """Starts to ask. The bus is open."""
        self._until = now + _LISTEN
        self._link.changed("active", "", None, now)
        for node, runner in self._runners.items():
            runner.start(self._ask(self._nodes[node]), self._note(node), now)

    def receive_event(self, event: Event, now: float) -> None:
        """Takes an event of the bus."""
        if isinstance(event, BusChanged):
            self._give_up(self._link.changed(event.state, event.why, event.errors, now))
        elif isinstance(event, FrameEchoed) and self._link.echoed(event.frame, now):
            return
        elif isinstance(event, FrameEchoed | FrameReceived):
            function, node = cia301.split(event.frame.id)
            data = event.frame.data
            if function == cia301.SDO_ANSWER and node in self._runners and len(data) == 8:
                self._runners[node].receive_sdo(data, now)
                self._runners[node].check(now)
            else:
                self._states.hear(event.frame)

    def send_failed(self, bus: str, frame: Frame, now: float) -> None:
        """Records that a frame could not be sent."""
        self._link.send_failed(frame, now)

    def tick(self, now: float) -> None:
        """Call every millisecond: handles timeouts."""
        self._link.armed = self._link.usable  # so that a stuck bus is found; nothing is switched here
        self._states.tick(now)
        self._give_up(self._link.tick(now, now))
        for runner in self._runners.values():
            runner.tick(now)
        if self._until is not None and now >= self._until:
            self._until = -1.0

    def _ask(self, it: ProbedNode) -> Procedure:
        outcome = yield Transfer(0x1000, 0, timeout=_FIRST, tries=_TRIES)
        if outcome.silence is not None:
            if it.node != MASTER:
                yield from self._states.learn(it.node)
            return
        it.answers = True
        self._store(it, 0x1000, 0, outcome)
        yield from self._array(it, 0x1018)
        if not self._in_full:
            return
        for index, sub in _NUMBERS:
            self._store(it, index, sub, (yield Transfer(index, sub)))
        for index in _COUNTS:
            self._store(it, index, 0, (yield Transfer(index, 0)))
        for index in _ARRAYS:
            yield from self._array(it, index)
        for index in TEXTS:
            outcome = yield Transfer(index, 0)
            if outcome.data is not None:
                it.texts[index] = outcome.data.decode("latin-1").rstrip("\0 ")
        for first, pdos in ((0x1400, it.rpdos), (0x1800, it.tpdos)):
            for parameters in range(first, first + _PDOS):
                if (pdo := (yield from read_pdo(str(it.node), parameters))) is not None:
                    pdos.append(pdo)

    def _array(self, it: ProbedNode, index: int) -> Generator[Step, SdoOutcome, None]:
        if (index, 0) not in it.numbers:
            self._store(it, index, 0, (yield Transfer(index, 0)))
        for sub in range(1, 1 + min(it.numbers.get((index, 0), 0), _MOST_SUBS)):
            self._store(it, index, sub, (yield Transfer(index, sub)))

    def _store(self, it: ProbedNode, index: int, sub: int, outcome: SdoOutcome) -> None:
        """Stores the value or the refusal of an object.

        Raises:
            BoardError: the node does not answer any more.
        """
        if outcome.data is not None:
            it.numbers[index, sub] = int.from_bytes(outcome.data, "little")
        elif outcome.abort is None:
            text = f"it stopped answering at {index:04X}h sub {sub}: {outcome.silence}"
            raise BoardError(ArmFault("board-missing", str(it.node), text))
        elif outcome.abort not in (objects.NO_OBJECT, objects.NO_SUB_INDEX):
            it.refused[index, sub] = outcome.abort

    def _note(self, node: int) -> Callable[[ArmFault | None, float], None]:
        def ended(fault: ArmFault | None, now: float) -> None:
            if fault is not None:
                self._nodes[node].trouble = fault.message

        return ended

    def _give_up(self, fault: ArmFault | None) -> None:
        if fault is not None and self.fault is None:
            self.fault = fault
            for runner in self._runners.values():
                runner.cancel()


def probe_bus(bus: BusWiring, nodes: Iterable[int] = NODES, *, in_full: bool = True) -> Probe:
    """Asks the nodes of a bus; blocks until they have answered or timed out.

    Raises:
        BusError: the bus cannot be opened.
    """
    outbox: list[tuple[str, Frame]] = []
    asking = Probe(bus, lambda name, frame: outbox.append((name, frame)), nodes, in_full=in_full)
    converse(asking, outbox, [CanBus(bus)])
    return asking
