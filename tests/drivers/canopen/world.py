"""A master, simulated boards and CAN buses on a simulated clock."""

from __future__ import annotations

import heapq
import itertools
from collections import deque
from collections.abc import Callable, Mapping

from drivers.canopen.faults import Busy, Fault
from drivers.canopen.run.master import Master
from drivers.canopen.wire import cia301
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wiring import BusSettings, Channel, Timing, Wiring
from drivers.simulation.buses import build_actuator, wire
from drivers.simulation.firmware import SimulatedBoard
from drivers.simulation.variants import STANDARD, Variant

QUEUE = 10  # frames; the kernel's default of txqueuelen
TICK = 0.01
MASTER = "master"


class SimulatedBus:
    """One CAN bus: arbitration by identifier, the time that each frame takes, and the queue of the master's interface.

    Attributes:
        log: frames on the wire, as identifier and data.
        blocked: the master's frames do not leave.
        room: frames that the master's interface still takes; None without a limit but its queue.
        echo: whether the master's interface gives frames back.
    """

    def __init__(self, world: World, name: str, bitrate: int) -> None:
        self.world, self.name, self.bitrate = world, name, bitrate
        self.log: list[Frame] = []
        self.blocked = self.busy = False
        self.room: int | None = None
        self.echo = True
        self.queues: dict[object, deque[Frame]] = {}

    def put(self, sender: object, frame: Frame) -> bool:
        queue = self.queues.setdefault(sender, deque())
        if sender is MASTER:
            if len(queue) >= QUEUE or self.room == 0:
                return False
            if self.room is not None:
                self.room -= 1
        queue.append(frame)
        self.next()
        return True

    def next(self) -> None:
        heads = [
            (queue[0].id, i, sender)
            for i, (sender, queue) in enumerate(self.queues.items())
            if queue and not (sender is MASTER and self.blocked)
        ]
        if self.busy or not heads:
            return
        *_, sender = min(heads, key=lambda head: head[:2])
        frame = self.queues[sender].popleft()
        self.busy = True
        self.world.after(cia301.wire_bits(len(frame.data)) / self.bitrate, lambda: self.done(sender, frame))

    def done(self, sender: object, frame: Frame) -> None:
        self.busy = False
        self.log.append(frame)
        world = self.world
        function = frame.id & 0x780
        if function != cia301.SDO_ANSWER and (function != cia301.HEARTBEAT or sender is MASTER):  # for boards
            for board in world.boards_of(self.name):
                if board is not sender:
                    world.hear(self.name, board, frame)
        if sender is not MASTER:
            world.master.receive(self.name, frame, world.now)
        elif self.echo:
            world.master.echoed(self.name, frame, world.now)
        world.flush()
        self.next()


class World:
    """A master and the boards of its wiring; the boards have power, and answer after `latency` [s]."""

    def __init__(
        self,
        channels: list[Channel] | None = None,
        timing: Timing | None = None,
        *,
        latency: float = 0.001,
        bitrate: int = 1_000_000,
        variants: Mapping[str, Variant] | None = None,
        **options: object,
    ) -> None:
        channels = channels or one_board()
        names = sorted({line.bus for c in channels for line in c.lines.values()})
        buses = tuple(BusSettings(name, "none", name, bitrate) for name in names)
        self.wiring = Wiring(buses, tuple(channels), **options)
        self.timing = timing or Timing()
        self.now, self.latency = 0.0, latency
        self._order = itertools.count()
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self.buses = {bus.name: SimulatedBus(self, bus.name, bus.bitrate) for bus in buses}
        self.actuators = {c.actuator: build_actuator(c, self.timing) for c in channels}
        self.boards: dict[tuple[str, int], SimulatedBoard] = {}
        for (bus, node), wired in wire(self.wiring, self.actuators).items():
            variant = (variants or {}).get(f"{bus}/{node}", STANDARD)
            self.boards[bus, node] = SimulatedBoard(node, wired, self._mouth(bus, node), variant)
        self.lost: Callable[[str, int, Frame], bool] = lambda bus, node, frame: False  # frames of boards
        self.faults: list[Fault] = []
        self.switched: list[tuple[int, float]] = []
        self.stalled = False
        self.master = self.new_master()
        for board in self.boards.values():
            board.power_on(0.0)
            self._schedule(board)
        self.after(0.0, self._tick)

    def new_master(self) -> Master:
        self._outbox: list[tuple[str, Frame]] = []
        master = Master(self.wiring, self.timing, lambda bus, frame: self._outbox.append((bus, frame)))
        for bus in self.buses:
            master.bus_changed(bus, "active", "", None, self.now)
        return master

    def boards_of(self, bus: str) -> list[SimulatedBoard]:
        return [board for (name, _), board in self.boards.items() if name == bus]

    def after(self, delay: float, what: Callable[[], None]) -> None:
        heapq.heappush(self._events, (self.now + delay, next(self._order), what))

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self._events and self._events[0][0] <= end:
            self.now, _, what = heapq.heappop(self._events)
            what()
        self.now = end

    def until(self, condition: Callable[[], object], patience: float = 20.0) -> float:
        """Runs until the condition holds; returns the time taken [s]."""
        begun = self.now
        while not condition():
            assert self.now - begun < patience, "waited in vain"
            self.now, _, what = heapq.heappop(self._events)
            what()
        return self.now - begun

    def stall(self, seconds: float) -> None:
        """Stalls the master's loop; it takes the frames of this time afterwards, in order."""
        waiting: list[tuple[str, str, Frame]] = []
        master = self.master
        real = master.receive, master.echoed
        master.receive = lambda bus, frame, now: waiting.append(("r", bus, frame))  # type: ignore[method-assign]
        master.echoed = lambda bus, frame, now: waiting.append(("e", bus, frame))  # type: ignore[method-assign]
        self.stalled = True
        self.run(seconds)
        self.stalled = False
        master.receive, master.echoed = real  # type: ignore[method-assign]
        self.tick_once()
        for kind, bus, frame in waiting:
            (master.receive if kind == "r" else master.echoed)(bus, frame, self.now)
            self.flush()

    def hear(self, bus: str, board: SimulatedBoard, frame: Frame) -> None:
        sdo = frame.id & 0x780 == cia301.SDO_REQUEST
        if sdo and frame.id & 0x7F != board.node:
            return

        def take() -> None:
            board.receive(frame.id, frame.data, self.now)
            self._schedule(board)

        if sdo:
            self.after(self.latency, take)
        else:
            take()

    def flush(self) -> None:
        while self._outbox:
            bus, frame = self._outbox.pop(0)
            if not self.buses[bus].put(MASTER, frame):
                self.master.send_failed(bus, frame, "No buffer space available", self.now)
        self.faults += self.master.take_faults()
        self.switched += self.master.take_switched()

    def say(self, cob_id: int, data: bytes = b"", bus: str = "can0") -> None:
        """Sends a frame of another node."""
        self.buses[bus].put("another node", Frame(cob_id, data))

    def boot(self) -> World:
        self.run(0.05)  # the boards have long booted when the master comes
        self.master.boot(self.now)
        self.flush()
        self.until(lambda: not self.master.booting)
        return self

    def up(self) -> World:
        self.boot()
        assert self.master.boot_faults == []
        assert self.master.ready
        self.frames()
        return self

    def commit(self, *states: int) -> None:
        """Commits, and runs until the commit has ended."""
        self.master.commit(bits(*states), self.now)
        self.flush()
        self.until(lambda: not self.master.committing)

    def commit_when_possible(self, *states: int) -> None:
        def taken() -> bool:
            try:
                self.commit(*states)
            except Busy:
                return False
            return self.master.commit_failed is None

        while not taken():
            self.run(TICK)

    def frames(self, bus: str = "can0", sdo: bool = False) -> list[tuple[int, str]]:
        """Returns COB-ID and data of the frames since the last call, without heartbeats, and without SDO by default."""
        log, self.buses[bus].log = self.buses[bus].log, []
        left_out = (cia301.HEARTBEAT,) if sdo else (cia301.HEARTBEAT, cia301.SDO_REQUEST, cia301.SDO_ANSWER)
        return [(frame.id, frame.data.hex(" ")) for frame in log if frame.id & 0x780 not in left_out]

    def codes(self) -> list[str]:
        return [fault.code for fault in self.faults]

    def positions(self) -> list[float]:
        return [self.actuators[c.actuator].position for c in self.wiring.channels]

    def switches(self) -> list[int]:
        return [self.actuators[c.actuator].switches for c in self.wiring.channels]

    def measured(self) -> list[int]:
        """States, -1 where unknown."""
        measured, known = self.master._network.measured, self.master.known
        return [measured >> k & 1 if known >> k & 1 else -1 for k in range(len(self.wiring.channels))]

    def tick_once(self) -> None:
        self.master.tick(self.now)
        self.flush()

    def _tick(self) -> None:
        if not self.stalled:
            self.tick_once()
        self.after(TICK, self._tick)

    def _mouth(self, bus: str, node: int) -> Callable[[int, bytes], None]:
        def send(cob_id: int, data: bytes) -> None:
            frame = Frame(cob_id, data)
            if not self.lost(bus, node, frame):
                self.buses[bus].put(self.boards[bus, node], frame)

        return send

    def _schedule(self, board: SimulatedBoard) -> None:
        timer = board.timer
        if timer == float("inf"):
            return

        def step() -> None:
            if board.timer <= self.now + 1e-9:
                board.step(max(self.now, board.timer))  # sums of times may fall short of the timer by rounding
                self._schedule(board)

        self.after(max(timer - self.now, 0.0), step)


def bits(*states: int) -> int:
    return sum(state << k for k, state in enumerate(states))


def one_board() -> list[Channel]:
    return [Channel("5.left", "can0", 5, 0, 0), Channel("5.right", "can0", 5, 1, 1)]


def two_boards() -> list[Channel]:
    return [Channel("5.left", "can0", 5, 0, 0), Channel("9.left", "can0", 9, 3, 2)]


def two_buses() -> list[Channel]:
    return [Channel("a", "can0", 5, 0, 0), Channel("b", "can1", 5, 0, 0)]
