"""All simulated boards and actuators of an arm on their buses, without threads, clock and I/O."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wiring import LINES, BoardId, Channel, NodeWiring, Timing, Wiring
from hyperbit.drivers.simulation.actuator import CONTRACTED, EXTENDED, Actuator
from hyperbit.drivers.simulation.firmware import SimulatedBoard, Wired
from hyperbit.drivers.simulation.variants import STANDARD, Variant, as_wired

ORDINARY = 0.5  # travel time of an actuator without faults, as a fraction of the longest travel time
LEAST_PULSE = 0.005  # [s] for which one of two coils must be energised


class SimulatedBuses:
    """The boards of a wiring, each on its bus, with their actuators.

    The caller passes frames to `receive` and the time to `step`. `send` takes the frames of the boards.
    A board answers before `receive` returns. Times never decrease. Faults take effect at the time of the last call.

    Args:
        timing: gives the travel time; simulated actuators take half of it.
        send: takes the name of a bus and a frame that a board sends on it.
        variants: variants of boards by name, e.g. "can0/5"; the other boards are standard boards.
        report: takes the name of a bus and the new state of the computer's CAN controller, "bus-off" or "active".

    Raises:
        KeyError: `variants` names an unknown board.
    """

    def __init__(
        self,
        wiring: Wiring,
        timing: Timing,
        send: Callable[[str, Frame], None],
        variants: Mapping[str, Variant] | None = None,
        report: Callable[[str, str], None] = lambda bus, state: None,
    ) -> None:
        self._now = 0.0
        self._take, self._report = send, report
        self._off = set[str]()  # buses on which no frame passes
        self._booted = False
        self.actuators = {c.actuator: build_actuator(c, timing) for c in wiring.channels}
        self._interlocks = {lock.name: lock for lock in wiring.interlocks}
        self._boards: dict[str, dict[int, SimulatedBoard]] = {bus.name: {} for bus in wiring.buses}
        self.by_name: dict[str, SimulatedBoard] = {}
        listed = {(entry.bus, entry.node): entry for entry in wiring.nodes}
        for (bus, node), here in wire(wiring, self.actuators).items():
            variant = (variants or {}).get(f"{bus}/{node}", STANDARD)
            entry = listed.get((bus, node), NodeWiring(bus, node, object=variant.output_object))
            locks = [lock for lock in wiring.interlocks if lock.line.board == (bus, node)]
            variant = as_wired(variant, entry, wiring.error_state, locks)
            board = SimulatedBoard(node, here, partial(self._send, bus), variant)
            self._boards[bus][node] = self.by_name[f"{bus}/{node}"] = board
        for name in variants or {}:
            self.board(name)
        for lock in wiring.interlocks:
            self._boards[lock.bus][lock.node].set_level(lock.watched, lock.bit, 1 ^ lock.inverted)
        self._due = dict.fromkeys(self.by_name.values(), 0.0)

    def receive(self, bus: str, frame: Frame, now: float) -> None:
        """Passes a data or remote frame with an 11 bit identifier to the boards of a bus; `now` in [s]."""
        self._now = now
        if bus in self._off:
            return
        boards = self._boards[bus]
        if frame.id & ~0x7F == cia301.SDO_REQUEST:  # for one board only; this is the case for most frames of a boot
            node = frame.id & 0x7F
            if node in boards and boards[node].node == node:  # LSS may have changed its node id
                boards = {node: boards[node]}
        for board in boards.values():
            if self._due[board] <= now:
                board.step(now)
            board.receive(*frame, now)
            self._due[board] = board.timer

    def step(self, now: float) -> None:
        """Advances the boards to `now` [s]; the first call switches their supply on."""
        self._now = now
        if not self._booted:
            self._booted = True
            for board in self.by_name.values():
                board.power_on(now)
        for board, due in self._due.items():
            if due <= now:
                board.step(now)
                self._due[board] = board.timer

    def next_due(self) -> float:
        """Returns when `step` must be called at the latest [s]; infinity if only a frame can change anything."""
        if not self._booted:
            return self._now
        return min(self._due.values(), default=float("inf"))

    def positions(self) -> list[float]:
        """Returns the position of each actuator at the last call, 0 contracted to 1 extended, shape (A,)."""
        return [actuator.position_at(self._now) for actuator in self.actuators.values()]

    def drives(self) -> list[int]:
        """Returns the end to which each valve drives its actuator, 0 or 1, shape (A,)."""
        return [actuator.driven for actuator in self.actuators.values()]

    def switches(self) -> list[int]:
        """Returns the number of switches of each valve, shape (A,)."""
        return [actuator.switches for actuator in self.actuators.values()]

    def coils(self) -> list[tuple[int, int]]:
        """Returns whether the coils `on` and `off` of each actuator are energised, shape (A, 2)."""
        return [actuator.coils for actuator in self.actuators.values()]

    def both_on(self) -> list[int]:
        """Returns how often both coils of each actuator were energised at once, shape (A,)."""
        return [actuator.both_on for actuator in self.actuators.values()]

    def longest_pulses(self) -> list[float]:
        """Returns the longest pulse of one of two coils of each actuator, shape (A,) [s]."""
        return [actuator.longest_pulse for actuator in self.actuators.values()]

    @property
    def labels(self) -> list[str]:
        return list(self.actuators)

    @property
    def names(self) -> list[str]:
        return list(self.by_name)

    @property
    def buses(self) -> list[str]:
        return list(self._boards)

    @property
    def interlocks(self) -> list[str]:
        return list(self._interlocks)

    def board(self, name: str) -> SimulatedBoard:
        """Returns a board by its name, e.g. "can0/5". Raises KeyError if there is no such board."""
        if name not in self.by_name:
            raise KeyError(f"no board {name}, there are {', '.join(self.by_name)}")
        return self.by_name[name]

    # --- faults, and their ends

    def bus_off(self, bus: str) -> None:
        """Sets the computer's CAN controller to bus-off: no frame passes in either direction."""
        self._off.add(bus)
        self._report(bus, "bus-off")

    def bus_on(self, bus: str) -> None:
        """Restarts the computer's CAN controller after bus-off."""
        self._off.discard(bus)
        self._report(bus, "active")

    def passes(self, bus: str) -> bool:
        return bus not in self._off

    def silence(self, board: str) -> None:
        """Disconnects a board, e.g. "can0/5", from the bus."""
        self.board(board).silent = True

    def unsilence(self, board: str) -> None:
        self.board(board).silent = False

    def lose_tpdo(self, board: str) -> None:
        self.board(board).lose_tpdo()

    def power_cut(self, board: str) -> None:
        """Cuts the supply of a board; springs return its actuators."""
        it = self.board(board)
        it.power_cut(self._now)
        self._due[it] = it.timer

    def power_on(self, board: str) -> None:
        """Restores the supply of a board; it boots with its outputs off."""
        it = self.board(board)
        it.power_on(self._now)
        self._due[it] = it.timer

    def error(self, board: str, code: int) -> None:
        """Starts an error of a board, with the error code of its emergency, e.g. 2320h: short circuit of an output."""
        self.board(board).emergencies.report(code)

    def error_over(self, board: str, code: int) -> None:
        """Ends an error of a board."""
        self.board(board).emergencies.recover(code)

    def open_interlock(self, interlock: str) -> None:
        self._set_interlock(interlock, 0)

    def close_interlock(self, interlock: str) -> None:
        self._set_interlock(interlock, 1)

    def _set_interlock(self, name: str, level: int) -> None:
        lock = self._interlocks[name]
        board = self._boards[lock.bus][lock.node]
        board.set_level(lock.watched, lock.bit, level ^ lock.inverted)
        board.step(self._now)
        self._due[board] = board.timer

    @contextmanager
    def actuator(self, label: str) -> Iterator[Actuator]:
        """Yields an actuator at the time of the last call, for a change; then boards read inputs. Raises KeyError."""
        if label not in self.actuators:
            raise KeyError(f"no actuator {label}, there are {', '.join(self.actuators)}")
        self.step(self._now)
        self.actuators[label].step(self._now)
        yield self.actuators[label]
        for board in self._due:
            board.step(self._now)
            self._due[board] = board.timer

    def _send(self, bus: str, cob_id: int, data: bytes) -> None:
        if bus not in self._off:
            self._take(bus, Frame(cob_id, data))


def build_actuator(channel: Channel, timing: Timing) -> Actuator:
    to_contracted, to_extended = channel.travel or (timing.travel_time, timing.travel_time)
    single = channel.output_off is None
    return Actuator(
        channel.actuator,
        ORDINARY * to_extended,
        ORDINARY * to_contracted,
        least_pulse=None if single else LEAST_PULSE,
        rest=EXTENDED if single and "output" in channel.inverted else CONTRACTED,
        inverted=("input_contracted" in channel.inverted, "input" in channel.inverted),
    )


def wire(wiring: Wiring, actuators: Mapping[str, Actuator]) -> dict[BoardId, list[Wired]]:
    """Returns the actuators of each board, with their outputs and inputs on this board."""
    wired: dict[BoardId, list[Wired]] = {board: [] for board in wiring.boards}
    for channel in wiring.channels:
        inverted = "output" in channel.inverted, "output_off" in channel.inverted
        lines = channel.lines
        boards = dict.fromkeys(line.board for line in lines.values())
        for board in boards:
            bits: dict[str, int | None] = dict.fromkeys(LINES)
            bits |= {name: line.bit for name, line in lines.items() if line.board == board}
            one = Wired(actuators[channel.actuator], **bits, inverted=inverted, shared=len(boards) > 1)
            wired[board].append(one)
    return wired


def board_names(wiring: Wiring) -> list[str]:
    return [str(board) for board in wiring.boards]
