"""Simulated boards on real or virtual CAN buses, and their faults on demand."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import can
import numpy as np
from numpy.typing import NDArray

from drivers import cia301
from drivers.simulation.actuator import Actuator
from drivers.simulation.firmware import SimulatedBoard, Wired
from drivers.wiring import BusSettings, Timing, Wiring

_LONGEST_WAIT = 0.01  # [s] for a frame, so that a fault asked for acts soon
_ORDINARY = 0.5  # share of its greatest travel time an actuator in good order takes


class Segment:
    """One bus with its boards: whatever happens on it happens in one thread at a time.

    Attributes:
        lock: to be held by who looks at or changes the boards.
        boards: by node id.
    """

    def __init__(self, settings: BusSettings) -> None:
        self.lock = threading.RLock()
        self.boards: dict[int, SimulatedBoard] = {}
        self._settings = settings
        self._bus: can.BusABC | None = self._open()
        self._booted = False
        self._next_round = 0.0

    def add(self, node: int, wired: Sequence[Wired]) -> None:
        """Puts a board on the bus."""
        self.boards[node] = SimulatedBoard(node, wired, self._send)

    def step(self, now: float, message: can.Message | None = None) -> None:
        """Takes in `message`, all frames that wait, and what time brings up to `now` [s].

        Without a message, and every so often, each board looks at its inputs, too, which somebody may have changed.
        """
        with self.lock:
            if not self._booted:
                self._booted = True
                for board in self.boards.values():
                    board.power_on(now)
            every = message is None or now >= self._next_round
            while message is not None or (message := self._receive(0.0)) is not None:
                if not (message.is_error_frame or message.is_remote_frame or message.is_extended_id or message.is_fd):
                    self._pass_on(message.arbitration_id, bytes(message.data), now)
                message = None
            if every:
                self._next_round = now + _LONGEST_WAIT
            for board in self.boards.values():
                if every or board.timer <= now:
                    board.step(now)

    def run(self, clock: Callable[[], float], ending: threading.Event) -> None:
        """Goes on until `ending`, as time goes by `clock`."""
        message = None
        while not ending.is_set():
            self.step(clock(), message)
            wait = min((board.timer for board in self.boards.values()), default=float("inf")) - clock()
            message = self._receive(min(max(wait, 0.0), _LONGEST_WAIT))

    def close(self) -> None:
        """Shuts the bus."""
        if self._bus is not None:
            self._bus.shutdown()

    def _pass_on(self, cob_id: int, data: bytes, now: float) -> None:
        function, node = cia301.split(cob_id)
        if function == cia301.SDO_REQUEST:  # for one board only; most frames of a start are
            if node in self.boards:
                self.boards[node].receive(cob_id, data, now)
            return
        for board in self.boards.values():
            board.receive(cob_id, data, now)

    def _open(self) -> can.BusABC:
        s = self._settings
        return can.Bus(interface=s.interface, channel=s.channel, bitrate=s.bitrate, ignore_config=True)

    def _receive(self, patience: float) -> can.Message | None:
        try:
            if self._bus is None:
                self._bus = self._open()
            return self._bus.recv(patience)
        except (can.CanError, OSError):  # the interface is down or gone: the boards live on and hear nothing
            self.close()
            self._bus = None  # a kernel tells a socket once only that its interface is gone
            time.sleep(patience)
            return None

    def _send(self, cob_id: int, data: bytes) -> None:
        if self._bus is not None:
            with contextlib.suppress(can.CanError, OSError):  # a board does not know, either
                self._bus.send(cia301.frame(cob_id, data))


class Simulation:
    """All boards of a wiring.

    Either `start` lets it run by itself, one thread a bus, or a test calls `step` with times of its own. Only frames
    connect it with the driver.

    Args:
        segments: buses by name, with their boards on them.
        actuators: A actuators, each with the name of its bus, in the order of the states.
        clock: gives the time [s].
    """

    def __init__(
        self,
        segments: dict[str, Segment],
        actuators: Sequence[tuple[Actuator, str]],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._segments = segments
        self._actuators = tuple(actuators)
        self._clock = clock
        self._ending = threading.Event()
        self._threads: list[threading.Thread] = []

    @classmethod
    def from_wiring(cls, wiring: Wiring, timing: Timing, clock: Callable[[], float] = time.monotonic) -> Simulation:
        """Opens the buses of a wiring and puts the boards it names on them.

        Their actuators take half the greatest travel time.
        """
        segments = {bus.name: Segment(bus) for bus in wiring.buses}
        actuators = [Actuator(c.actuator, _ORDINARY * timing.travel_time) for c in wiring.channels]
        for bus, node in sorted({(c.bus, c.node) for c in wiring.channels}):
            here = [(a, c) for a, c in zip(actuators, wiring.channels, strict=True) if (c.bus, c.node) == (bus, node)]
            segments[bus].add(node, [Wired(a, c.output, c.input) for a, c in here])
        buses = [channel.bus for channel in wiring.channels]
        return cls(segments, list(zip(actuators, buses, strict=True)), clock)

    def start(self) -> None:
        """Lets it run."""
        self._ending.clear()
        for name, segment in self._segments.items():
            thread = threading.Thread(
                target=segment.run, args=(self._clock, self._ending), name=f"simulate {name}", daemon=True
            )
            self._threads.append(thread)
            thread.start()

    def stop(self) -> None:
        """Ends it and shuts its buses."""
        self._ending.set()
        for thread in self._threads:
            thread.join()
        self._threads.clear()
        for segment in self._segments.values():
            segment.close()

    def step(self, now: float) -> None:
        """Takes in what is on the buses and what time brings up to `now` [s]; not while it runs by itself."""
        for segment in self._segments.values():
            segment.step(now)

    def positions(self) -> NDArray[np.float64]:
        """(A,) where the actuators are, 0 contracted to 1 extended."""
        return np.array([actuator.position for actuator, _ in self._actuators])

    def switches(self) -> NDArray[np.int64]:
        """(A,) how often each actuator's drive changed."""
        return np.array([actuator.switches for actuator, _ in self._actuators], dtype=np.int64)

    @contextlib.contextmanager
    def board(self, name: str) -> Iterator[tuple[SimulatedBoard, float]]:
        """A board, e.g. "can0/5", and the time [s], while nothing else happens on its bus.

        Raises:
            KeyError: there is no such board.
        """
        boards = {f"{bus}/{node}": (s, b) for bus, s in self._segments.items() for node, b in s.boards.items()}
        if name not in boards:
            raise KeyError(f"no board {name}, there are {', '.join(boards)}")
        segment, board = boards[name]
        with segment.lock:
            yield board, self._clock()

    def stick(self, label: str, state: int) -> None:
        """Lets an actuator go to an end, 0 or 1, and stay there whatever its drive."""
        with self._actuator(label) as actuator:
            actuator.stick(state)

    def release(self, label: str) -> None:
        """Lets an actuator follow its drive again."""
        with self._actuator(label) as actuator:
            actuator.release()

    def slow(self, label: str, factor: float) -> None:
        """Makes an actuator's travel longer by a factor; 1 is as built."""
        with self._actuator(label) as actuator:
            actuator.slow(factor)

    def lose_sensor(self, label: str) -> None:
        """Freezes what an actuator's end-stop reads."""
        with self._actuator(label) as actuator:
            actuator.lose_sensor()

    def restore_sensor(self, label: str) -> None:
        """Lets an actuator's end-stop read again."""
        with self._actuator(label) as actuator:
            actuator.restore_sensor()

    def silence(self, board: str) -> None:
        """Cuts a board, e.g. "can0/5", off from the bus."""
        with self.board(board) as (it, _):
            it.silent = True

    def unsilence(self, board: str) -> None:
        """Connects a board with the bus again."""
        with self.board(board) as (it, _):
            it.silent = False

    def power_cut(self, board: str) -> None:
        """Takes a board's supply away; its actuators spring back."""
        with self.board(board) as (it, now):
            it.power_cut(now)

    def power_on(self, board: str) -> None:
        """Gives a board its supply back; it boots with its outputs off."""
        with self.board(board) as (it, now):
            it.power_on(now)

    @contextlib.contextmanager
    def _actuator(self, label: str) -> Iterator[Actuator]:
        actuators = {actuator.label: (actuator, self._segments[bus]) for actuator, bus in self._actuators}
        if label not in actuators:
            raise KeyError(f"no actuator {label}, there are {', '.join(actuators)}")
        actuator, segment = actuators[label]
        with segment.lock:
            actuator.step(self._clock())
            yield actuator
