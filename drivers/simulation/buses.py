"""All simulated boards and actuators of an arm, on their buses: no threads, no clock, no I/O."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial

from drivers.canopen import cia301
from drivers.canopen.cia301 import Frame
from drivers.canopen.wiring import Channel, Timing, Wiring
from drivers.simulation.actuator import CONTRACTED, EXTENDED, Actuator
from drivers.simulation.firmware import SimulatedBoard, Wired
from drivers.simulation.variants import STANDARD, Variant

_ORDINARY = 0.5  # travel time of an actuator in good order, as a share of the greatest travel time
_LEAST_PULSE = 0.005  # [s] that a coil of two must be energised


class SimulatedBuses:
    """The boards of a wiring, each on its bus, with their actuators.

    The caller brings frames by `receive` and time by `step`, and hands in `send` what takes the frames of the boards.
    A board answers before `receive` returns. Times never decrease. Faults take effect at the time of the last call.

    An executor that runs these boards in its own event loop needs two lines: a frame that it sends goes into its events
    as its own echo and then to `receive`, and `send` puts frames of the boards into its events.

    Args:
        wiring: buses, boards and actuators.
        timing: the actuators take half of its travel time, or of their own.
        send: takes the name of a bus and a frame that a board sends on it.
        variants: of boards, by name, e.g. "can0/5"; others are standard boards.

    Raises:
        KeyError: there is no such board.
    """

    def __init__(
        self,
        wiring: Wiring,
        timing: Timing,
        send: Callable[[str, Frame], None],
        variants: Mapping[str, Variant] | None = None,
    ) -> None:
        self._now = 0.0
        self._take = send
        self._booted = False
        self._actuators = {c.actuator: build_actuator(c, timing) for c in wiring.channels}
        self._interlocks = {lock.name: lock for lock in wiring.interlocks}
        self._boards: dict[str, dict[int, SimulatedBoard]] = {bus.name: {} for bus in wiring.buses}
        self._by_name: dict[str, SimulatedBoard] = {}
        wired: dict[tuple[str, int], list[Wired]] = {(lock.bus, lock.node): [] for lock in wiring.interlocks}
        for channel in wiring.channels:
            wired.setdefault((channel.bus, channel.node), []).append(wire(channel, self._actuators[channel.actuator]))
        for (bus, node), here in sorted(wired.items(), key=lambda item: item[0]):
            variant = (variants or {}).get(f"{bus}/{node}", STANDARD)
            board = SimulatedBoard(node, here, partial(self._send, bus), variant)
            self._boards[bus][node] = self._by_name[f"{bus}/{node}"] = board
        for name in variants or {}:
            self.board(name)
        for lock in wiring.interlocks:
            self._boards[lock.bus][lock.node].contacts[lock.input] = 1 ^ lock.inverted
        self._due = dict.fromkeys(self._by_name.values(), 0.0)

    def receive(self, bus: str, frame: Frame, now: float) -> None:
        """Brings a data or remote frame with an 11 bit identifier to the boards of a bus; `now` in [s]."""
        self._now = now
        boards = self._boards[bus]
        if frame.id & ~0x7F == cia301.SDO_REQUEST:  # for one board only; most frames of a boot are
            node = frame.id & 0x7F
            if node in boards and boards[node].node == node:  # it may have another id by LSS
                boards = {node: boards[node]}
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
        """(A,) end to which each actuator's valve drives it, 0 or 1."""
        return [actuator.driven for actuator in self._actuators.values()]

    def switches(self) -> list[int]:
        """(A,) how often each actuator's valve switched."""
        return [actuator.switches for actuator in self._actuators.values()]

    def coils(self) -> list[tuple[int, int]]:
        """(A,) whether each actuator's coils are energised: on, off."""
        return [actuator.coils for actuator in self._actuators.values()]

    def both_on(self) -> list[int]:
        """(A,) how often both coils of each actuator came to be energised at once."""
        return [actuator.both_on for actuator in self._actuators.values()]

    def longest_pulses(self) -> list[float]:
        """(A,) longest time that a coil of each actuator with two was energised [s]."""
        return [actuator.longest_pulse for actuator in self._actuators.values()]

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

    def silence(self, board: str) -> None:
        """Cuts a board, e.g. "can0/5", off from the bus."""
        self.board(board).silent = True

    def unsilence(self, board: str) -> None:
        """Connects a board with the bus again."""
        self.board(board).silent = False

    def power_cut(self, board: str) -> None:
        """Takes a board's supply away; springs return its actuators."""
        it = self.board(board)
        it.power_cut(self._now)
        self._due[it] = it.timer

    def power_on(self, board: str) -> None:
        """Gives a board its supply back; it boots with its outputs off."""
        it = self.board(board)
        it.power_on(self._now)
        self._due[it] = it.timer

    def error(self, board: str, code: int) -> None:
        """Gives a board an error with the code of its emergency, e.g. 2320h: a short circuit at an output."""
        self.board(board).emergencies.report(code)

    def error_over(self, board: str, code: int) -> None:
        """Ends an error of a board."""
        self.board(board).emergencies.recover(code)

    def open(self, interlock: str) -> None:
        """Opens an interlock."""
        self._set_interlock(interlock, 0)

    def close(self, interlock: str) -> None:
        """Closes an interlock."""
        self._set_interlock(interlock, 1)

    def _set_interlock(self, name: str, level: int) -> None:
        if name not in self._interlocks:
            raise KeyError(f"no interlock {name}, there are {', '.join(self._interlocks)}")
        lock = self._interlocks[name]
        board = self._boards[lock.bus][lock.node]
        board.contacts[lock.input] = level ^ lock.inverted
        board.step(self._now)
        self._due[board] = board.timer

    @contextmanager
    def actuator(self, label: str) -> Iterator[Actuator]:
        """Gives an actuator, at the time of the last call, to be changed; then the boards read their inputs.

        Raises:
            KeyError: there is no such actuator.
        """
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


def build_actuator(channel: Channel, timing: Timing) -> Actuator:
    """The actuator of a channel, in good order."""
    to_contracted, to_extended = channel.travel or (timing.travel_time, timing.travel_time)
    single = channel.output_off is None
    return Actuator(
        channel.actuator,
        _ORDINARY * to_extended,
        _ORDINARY * to_contracted,
        coils=1 if single else 2,
        least_pulse=0.0 if single else _LEAST_PULSE,
        rest=EXTENDED if single and "output" in channel.inverted else CONTRACTED,
        inverted=("input_contracted" in channel.inverted, "input" in channel.inverted),
    )


def wire(channel: Channel, actuator: Actuator) -> Wired:
    """An actuator on the outputs and inputs of its channel."""
    inverted = "output" in channel.inverted, "output_off" in channel.inverted
    outputs = channel.output, channel.output_off
    return Wired(actuator, outputs[0], channel.input, outputs[1], channel.input_contracted, inverted)


def board_names(wiring: Wiring) -> list[str]:
    """The names of the boards of a wiring, e.g. "can0/5"."""
    places = {(c.bus, c.node) for c in wiring.channels} | {(lock.bus, lock.node) for lock in wiring.interlocks}
    return [f"{bus}/{node}" for bus, node in sorted(places)]
