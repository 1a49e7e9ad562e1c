"""A command's session with the boards of some buses, while no executor uses these buses."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping

from hyperbit.drivers.canopen.faults import ArmFault, BusError
from hyperbit.drivers.canopen.sdo.procedure import Order, Procedure, Runner, Wait
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.bus import CanBus
from hyperbit.drivers.canopen.wire.cia301 import STATES, Command, Frame, State
from hyperbit.drivers.canopen.wire.events import BusChanged, Event, FrameEchoed, FrameReceived
from hyperbit.drivers.canopen.wire.link import Link, Outgoing
from hyperbit.drivers.canopen.wiring import MASTER

LISTEN, PERIODS = 1.2, 1.5  # time to listen before the first frame: [s], and in heartbeat periods of the master
_STUCK_AFTER = 0.5  # [s]
_POLL = 0.001  # [s] between two polls of the buses
_ANSWER = 0.3  # [s] for the answer to a remote frame
_STATE = 0x7F  # bits of the answer to a remote frame; the bit above alternates
_CHECK = "check cable, termination, bit rate, and that a board on this bus has power"

Node = tuple[str, int]  # name of the bus, and node id


class MasterHeard(Exception):
    """A master, such as an executor, sends its heartbeat on a bus; the text is the bus's name."""


class Session:
    """Open buses, and the procedures with their nodes. Use it in a `with` statement; each method blocks until its end.

    `heartbeat`: a master's heartbeat period [s], if known.
    """

    clock, sleep = staticmethod(time.monotonic), staticmethod(time.sleep)  # [s]

    def __init__(self, buses: Iterable[CanBus], heartbeat: float = 0.0) -> None:
        self.states: dict[Node, State] = {}  # the last ones, by heartbeats and remote frames (CiA 301, 7.2.8.3.2)
        self.heard: list[Frame] = []  # frames of other nodes since the caller's last `clear`
        self._buses = {bus.name: bus for bus in buses}
        self._listen = max(LISTEN, PERIODS * heartbeat)
        self._outbox: list[tuple[str, Frame]] = []
        self._links = {
            bus.name: Link(bus.wiring, lambda name, frame: self._outbox.append((name, frame)), _STUCK_AFTER)
            for bus in self._buses.values()
        }
        self._faults: dict[str, ArmFault] = {}
        self._runners: dict[Node, Runner] = {}
        self._came_back: set[str] = set()  # buses from which a frame came, or the echo of one
        self._master: str | None = None

    def __enter__(self) -> Session:
        try:
            for bus in self._buses.values():
                bus.open()
                self._links[bus.name].changed("active", "", None, self.clock())
            self.listen()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *raised: object) -> None:
        for bus in self._buses.values():
            bus.close()

    def listen(self) -> None:
        """Listens for a master, and raises MasterHeard; call it again after each question to the user."""
        self.wait(lambda: False, self._listen)

    def wait(self, until: Callable[[], bool], seconds: float) -> bool:
        """Waits until a condition holds, up to `seconds`; returns whether it holds. Raises MasterHeard."""
        end = self.clock() + seconds
        while not until():
            now = self.clock()
            if now >= end:
                return False
            for bus in self._buses.values():
                for event in bus.poll():
                    self._receive(event, now)
                    self._flush(now)
            if self._master is not None:
                raise MasterHeard(self._master)
            for link in self._links.values():
                link.armed = link.usable  # to detect a stuck bus; nothing is switched here
                if (fault := link.tick(now, now)) is not None:
                    self._faults.setdefault(link.name, fault)
            for runner in self._runners.values():
                runner.tick(now)
            self._flush(now)
            self.sleep(_POLL)
        return True

    def run(self, procedures: Mapping[Node, Procedure]) -> dict[Node, ArmFault | None]:
        """Runs procedures with nodes in parallel; returns the fault of each, or None. Raises MasterHeard."""
        ended: dict[Node, ArmFault | None] = {}
        now = self.clock()
        for node, procedure in procedures.items():
            runner = self._runners[node] = Runner(node[1], self._links[node[0]])
            runner.start(procedure, lambda fault, _, node=node: ended.update({node: fault}), now)  # type: ignore[misc]
        self._flush(now)

        def over() -> bool:
            for node in procedures:
                if node not in ended and node[0] in self._faults:
                    self._runners[node].cancel()
                    ended[node] = self._faults[node[0]]
            return len(ended) == len(procedures)

        self.wait(over, math.inf)
        return ended

    def trouble(self, bus: str) -> ArmFault | None:
        """Returns why no board of a bus can be reached, or None: call it after `run`."""
        if bus in self._faults:
            return self._faults[bus]
        if self._links[bus].state == "passive":
            return ArmFault("bus-passive", bus, f"no frame leaves {bus}, its controller is error-passive: {_CHECK}")
        if bus not in self._came_back:
            return ArmFault("bus-busy", bus, f"nothing came back from {bus}, not even a frame of its own: {_CHECK}")
        return None

    def poll_state(self, node: Node) -> Procedure:
        """Polls a node by a remote frame, unless it was heard already; waits 0.3 s for the answer.

        Call this only for a node that answers no SDO: the remote frame starts the node guarding of an operational node.
        """
        if node not in self.states:
            poll = Outgoing(Frame(cia301.REMOTE | cia301.HEARTBEAT + node[1]))
            self._links[node[0]].queue(poll, self.clock())
            yield Wait(lambda: node in self.states, _ANSWER)
            poll.cancelled = True

    def reset(self, node: Node, timeout: float, command: Command = Command.RESET_NODE) -> float | None:
        """Resets a node by NMT; returns the time to its boot-up message [s], or None (CiA 301, 7.2.8.3.1).

        Raises MasterHeard, and BusError if the bus does not take the command.
        """
        self.states.pop(node, None)
        began = self.clock()

        def steps() -> Procedure:
            yield Order(command)
            yield Wait(lambda: self.states.get(node) is State.BOOT_UP, timeout)

        self.run({node: steps()})
        if (fault := self.trouble(node[0])) is not None:
            raise BusError(fault.message)
        return self.clock() - began if node in self.states else None

    def send_frame(self, bus: str, frame: Frame) -> None:
        """Sends a frame at once, outside procedures. Raises BusError if the bus does not accept it."""
        if (why := self._buses[bus].send_frame(frame)) is not None:
            raise BusError(f"{bus}: {why}")

    def _receive(self, event: Event, now: float) -> None:
        link = self._links[event.bus]
        if isinstance(event, BusChanged) and (fault := link.changed(event.state, event.why, event.errors, now)):
            self._faults.setdefault(link.name, fault)
        if not isinstance(event, FrameEchoed | FrameReceived):
            return
        self._came_back.add(event.bus)
        if isinstance(event, FrameEchoed) and link.echoed(event.frame, now):
            return
        frame = event.frame  # of a board; frames of a board on this computer are echoes
        self.heard.append(frame)
        function, node = cia301.split(frame.id)
        if function == cia301.HEARTBEAT and len(frame.data) == 1:
            state = STATES.get(frame.data[0] & _STATE)
            if node == MASTER and frame.data[0] == State.OPERATIONAL:  # a board with this id is not operational
                self._master = event.bus
            elif node and state is not None:
                self.states[event.bus, node] = state
        if (runner := self._runners.get((event.bus, node))) is not None:
            if function == cia301.SDO_ANSWER and len(frame.data) == 8:
                runner.receive_sdo(frame.data, now)
            runner.check(now)

    def _flush(self, now: float) -> None:
        while self._outbox:
            bus, frame = self._outbox.pop(0)
            if self._buses[bus].send_frame(frame) is not None:
                self._links[bus].send_failed(frame, now)


def stopped(board: str) -> str:
    """Returns the sentence for a stopped board; `board` is its name, e.g. "can0/5"."""
    what = f"board {board} is stopped, as after the end of an executor with on_loss: contract; it answers no SDO"
    return f"{what}: start the executor, or reset the board: hyperbit board ARM.yaml {board} reset"
