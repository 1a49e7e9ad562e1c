"""All simulated boards and actuators of an arm, on their buses: no threads, no clock, no I/O."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from drivers.canopen import cia301
from drivers.canopen.cia301 import Frame
from drivers.canopen.wiring import Timing, Wiring
from drivers.simulation.actuator import Actuator
from drivers.simulation.firmware import SimulatedBoard, Wired

_ORDINARY = 0.5  # travel time of an actuator in good order, as a share of the greatest travel time


class SimulatedBuses:
    """The boards of a wiring, each on its bus, with their actuators.

    The caller brings frames by `receive` and time by `step`, and hands in `send` what takes the frames of the boards.
    A board answers before `receive` returns. Times never decrease. Faults take effect at the time of the last call.

    An executor that runs these boards in its own event loop needs two lines: a frame that it sends goes into its events
    as its own echo and then to `receive`, and `send` puts frames of the boards into its events.

    Args:
        wiring: buses, boards and actuators.
        timing: the actuators take half of its travel time.
        send: takes the name of a bus and a frame that a board sends on it.
    """

    def __init__(self, wiring: Wiring, timing: Timing, send: Callable[[str, Frame], None]) -> None:
        self._now = 0.0
        self._take = send
        self._booted = False
        self._actuators = {c.actuator: Actuator(c.actuator, _ORDINARY * timing.travel_time) for c in wiring.channels}
        self._boards: dict[str, dict[int, SimulatedBoard]] = {bus.name: {} for bus in wiring.buses}
        for bus, node in sorted({(c.bus, c.node) for c in wiring.channels}):
            here = [c for c in wiring.channels if (c.bus, c.node) == (bus, node)]
            wired = [Wired(self._actuators[c.actuator], c.output, c.input) for c in here]
            self._boards[bus][node] = SimulatedBoard(node, wired, partial(self._send, bus))
        self._by_name = {f"{bus}/{n}": board for bus, boards in self._boards.items() for n, board in boards.items()}
        self._due = dict.fromkeys(self._by_name.values(), 0.0)

    def receive(self, bus: str, frame: Frame, now: float) -> None:
        """Brings a data frame with an 11 bit identifier to the boards of a bus; `now` in [s]."""
        self._now = now
        boards = self._boards[bus]
        function, node = cia301.split(frame.id)
        if function == cia301.SDO_REQUEST:  # for one board only; most frames of a boot are
            boards = {node: boards[node]} if node in boards else {}
        for board in boards.values():
            if self._due[board] <= now:
                board.step(now)
            board.receive(*frame, now)
            self._due[board] = board.timer

    def step(self, now: float) -> None:
        """Does what time brings up to `now` [s]; the first call switches the supply of all boards on."""
        self._now = now
        if not self._booted:
            self._booted = True
            for board in self._by_name.values():
                board.power_on(now)
        for board, due in self._due.items():
            if due <= now:
                board.step(now)
                self._due[board] = board.timer

    def next_due(self) -> float:
        """When `step` is to be called at the latest [s]; infinity if only a frame can bring anything."""
        if not self._booted:
            return self._now
        return min(self._due.values(), default=float("inf"))

    def positions(self) -> list[float]:
        """(A,) position of each actuator at the time of the last call, 0 contracted to 1 extended."""
        return [actuator.position_at(self._now) for actuator in self._actuators.values()]

    def drives(self) -> list[int]:
        """(A,) whether each actuator's drive is on, 0 or 1."""
        return [actuator.driven for actuator in self._actuators.values()]

    def switches(self) -> list[int]:
        """(A,) how often each actuator's drive changed."""
        return [actuator.switches for actuator in self._actuators.values()]

    @property
    def labels(self) -> list[str]:
        """(A,) labels of the actuators."""
        return list(self._actuators)

    def board(self, name: str) -> SimulatedBoard:
        """A board by its name, e.g. "can0/5".

        Raises:
            KeyError: there is no such board.
        """
        if name not in self._by_name:
            raise KeyError(f"no board {name}, there are {', '.join(self._by_name)}")
        return self._by_name[name]

    # --- faults, and their ends

    def stick(self, label: str, state: int) -> None:
        """Lets an actuator go to an end, 0 or 1, and stay there whatever its drive."""
        with self._changing(label) as actuator:
            actuator.stick(state)

    def release(self, label: str) -> None:
        """Lets an actuator follow its drive again."""
        with self._changing(label) as actuator:
            actuator.release()

    def slow(self, label: str, factor: float) -> None:
        """Makes an actuator's travel longer by a factor; 1 is as built."""
        with self._changing(label) as actuator:
            actuator.slow(factor)

    def lose_sensor(self, label: str) -> None:
        """Freezes what an actuator's end-stop reads."""
        with self._changing(label) as actuator:
            actuator.lose_sensor()

    def restore_sensor(self, label: str) -> None:
        """Lets an actuator's end-stop read again."""
        with self._changing(label) as actuator:
            actuator.restore_sensor()

    def silence(self, board: str) -> None:
        """Cuts a board, e.g. "can0/5", off from the bus."""
        self.board(board).silent = True

    def unsilence(self, board: str) -> None:
        """Connects a board with the bus again."""
        self.board(board).silent = False

    def power_cut(self, board: str) -> None:
        """Takes a board's supply away; its actuators spring back."""
        it = self.board(board)
        it.power_cut(self._now)
        self._due[it] = it.timer

    def power_on(self, board: str) -> None:
        """Gives a board its supply back; it boots with its outputs off."""
        it = self.board(board)
        it.power_on(self._now)
        self._due[it] = it.timer

    @contextmanager
    def _changing(self, label: str) -> Iterator[Actuator]:
        """Gives an actuator, at the time of the last call, to be changed; then the boards read their inputs."""
        if label not in self._actuators:
            raise KeyError(f"no actuator {label}, there are {', '.join(self._actuators)}")
        self.step(self._now)
        self._actuators[label].step(self._now)
        yield self._actuators[label]
        for board in self._due:
            board.step(self._now)
            self._due[board] = board.timer

    def _send(self, bus: str, cob_id: int, data: bytes) -> None:
        self._take(bus, Frame(cob_id, data))
