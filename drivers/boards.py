"""The boundary to the hardware: actuator states in, actuator states and faults out."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

import canopen
import numpy as np
from numpy.typing import NDArray

from drivers import cia301
from drivers.bus import CanBus
from drivers.commits import Commits
from drivers.faults import BusBusy, BusError, Fault, FaultLog
from drivers.heartbeat import Heartbeat
from drivers.layout import lay_out
from drivers.load import worst_case
from drivers.node import Node
from drivers.outputs import Outputs
from drivers.reception import Reception
from drivers.sdo import Sdo
from drivers.startup import Startup
from drivers.status import Status
from drivers.watch import Watch
from drivers.wiring import Timing, Wiring


class Boards:
    """All boards of an arm of A actuators.

    One thread, the control loop, calls everything but `start`, which blocks and is called from another while the
    control loop goes on with `tick`. `now` is always `time.monotonic()` [s], or any clock a test likes.

    Args:
        wiring: what is wired where.
        timing: times of boards and actuators.
    """

    def __init__(self, wiring: Wiring, timing: Timing) -> None:
        self._timing = timing
        self._layout = layout = lay_out(wiring)
        self._news = threading.Condition()
        self._faults = FaultLog()
        self._outputs = Outputs(layout)
        self._inputs = np.zeros(layout.input_size, dtype=np.uint8)
        self._nodes = [Node(board, self._inputs[board.input_image]) for board in layout.boards]
        self._watch = Watch(wiring, timing)
        self._held = np.full(layout.sensed.size, -1, dtype=np.int8)
        self._startup = Startup(wiring, timing, self._outputs, self._news)
        self._buses: dict[str, CanBus] = {}
        self._networks = {bus.name: canopen.Network() for bus in wiring.buses}
        for settings in wiring.buses:
            name = settings.name
            reception = Reception(name, layout, self._nodes, self._networks[name], self._news, self._faults)
            stuck_after = 0.8 * (timing.heartbeat_timeout - timing.heartbeat)  # before the boards miss the master
            self._buses[name] = CanBus(settings, reception.take, self._lose_bus, self._wake, stuck_after)
        self._sdos = [Sdo(n.board, self._buses[n.board.bus], self._networks[n.board.bus]) for n in self._nodes]
        self._worst_case = {bus.name: worst_case(layout, timing, bus) for bus in wiring.buses}
        self._heartbeat = Heartbeat(self._buses, timing)
        self._commits = Commits(self._buses, self._outputs, self._watch, self._news, timing.heartbeat_timeout / 2)

    def connect(self) -> None:
        """Opens the buses and starts reading.

        Raises:
            BusError: a bus cannot be opened; those opened before are closed again.
        """
        try:
            for bus in self._buses.values():
                bus.open()
        except BusError:
            self.close()
            raise

    def subscribe(self, callback: Callable[[Fault], None]) -> None:
        """Calls `callback` with each new fault, from a reader thread or from `tick`; it must only hand it over."""
        self._faults.subscribe(callback)

    def start(self) -> list[Fault]:
        """Brings every board up; blocks until all are operational or given up.

        It switches nothing, whatever state the boards are in, and may be called again after a fault: boards that are
        operational and configured as they should be are left alone. What is measured counts as commanded from then on.

        Returns:
            One fault for each board, or bus, that is not up; none if all are operational.
        """
        self._faults.clear()
        self._commits.forget()
        for node in self._nodes:
            node.forget()
        self._watch.reset(self.measured())  # all unknown: nothing is compared until all is up
        lost = {name: fault for name, bus in self._buses.items() if (fault := bus.rearm())}
        boards = [
            (node, self._buses[node.board.bus], sdo)
            for node, sdo in zip(self._nodes, self._sdos, strict=True)
            if node.board.bus not in lost
        ]
        faults = [*lost.values(), *self._startup.run(boards)]
        self._watch.reset(self.measured())
        return faults

    @property
    def sensed(self) -> NDArray[np.bool_]:
        """(A,) whether an actuator has an end-stop."""
        return self._layout.sensed.copy()

    def measured(self) -> NDArray[np.int8]:
        """(A,) states from the end-stops, of actuators without one the output as last switched; -1 unknown.

        An actuator without end-stop that is held is in its state, whatever its output.
        """
        ready = np.array([node.ready for node in self._nodes], dtype=np.bool_)[self._layout.board]
        states = np.where(self._held >= 0, self._held, self._outputs.states()).astype(np.int8)
        if self._inputs.size:
            ends = self._inputs[self._layout.input_byte] >> self._layout.input_bit & 1
            states = np.where(self._layout.sensed, ends, states).astype(np.int8)
        return np.where(ready, states, -1).astype(np.int8)

    def outputs(self) -> NDArray[np.uint8]:
        """(A,) states that the boards were last switched to, whatever is measured."""
        return self._outputs.states()

    def settle(self, now: float) -> bool:
        """Takes note of SYNCs that have left by `now` [s]; returns whether `outputs` are known.

        They are not while a SYNC is on its way, or a board not up.
        """
        self._commits.settle(now)
        return not self._commits.under_way and all(node.ready for node in self._nodes)

    def back(self) -> bool:
        """Whether `start` may succeed after a bus or a board was lost: all work, and all are heard.

        Boards that are not heard are asked: they may have come back with no heartbeat of their own. To be called once
        a second or so.
        """
        if not all(bus.fit for bus in self._buses.values()):
            return False
        silent = [node for node in self._nodes if not node.heard]
        for node in silent:
            self._question(node, 0x1000, 0)
        return not silent

    def halted(self, now: float) -> Fault | None:
        """Tells when `tick` was not called for so long that the boards have been without their master."""
        if (pause := self._heartbeat.halted(now)) is None:
            return None
        for node in self._nodes:
            node.ready = False  # who knows what they did meanwhile
        text = f"the daemon was halted for {pause:.2f} s, and the boards were without it: the arm holds"
        return Fault("halted", "daemon", text)

    def degrade(self, held: NDArray[np.int8]) -> None:
        """Takes actuators as held in a state from now on, (A,), -1 where they are free; sends nothing."""
        self._held = np.array(held, dtype=np.int8)

    def hold(self) -> None:
        """Takes the measured states as the commanded ones; sends nothing."""
        self._watch.accept(self.measured())

    def commit(self, states: NDArray[np.int8] | NDArray[np.uint8], now: float) -> None:
        """Switches all actuators to their states at one instant a bus: RPDOs to all buses, then one SYNC each.

        Nothing is sent when nothing is to change. A SYNC is sent only when all RPDOs have left: if the bus fails
        before, what the kernel still holds switches nothing when it comes back.

        Args:
            states: (A,) 0 contracted, 1 extended.
            now: [s].

        Raises:
            BusBusy: a frame could not be queued or has not left yet, or a bus or board is lost and `start` was not
                called since. Nothing is kept; the next commit sends the states it is given. What has switched all the
                same, on one of several buses or by a SYNC that leaves late, `outputs` tells.
            ValueError: not A states of 0 or 1.
        """
        given = np.asarray(states)
        if given.shape != self._layout.byte.shape or not np.isin(given, (0, 1)).all():
            raise ValueError(f"states must be {self._layout.byte.size} of 0 or 1, not {given.tolist()}")
        self._commits.send(given.astype(np.uint8), now, self._refuse_unless_up, self.measured)

    def tick(self, now: float) -> None:
        """Sends the master's heartbeat when due, and looks for lost boards and for actuators that went astray.

        To be called every control period, about 10 ms; no heartbeat is sent but from here, so that a control loop
        that hangs makes the boards safe.

        Args:
            now: [s].
        """
        self._commits.settle(now)
        for bus in self._buses.values():
            bus.tick(now)
        elapsed = self._heartbeat.tick(now)
        for node in self._nodes:
            if (fault := node.tick(elapsed, self._timing.heartbeat_timeout)) is not None:
                self._faults.report(fault)
        measured = self.measured()
        for board in np.unique(self._layout.board[self._watch.overdue(measured, now)]):
            self._ask(self._nodes[board])
        for fault in self._watch.check(measured, now):
            self._faults.report(fault)

    def moving(self, now: float) -> bool:
        """Whether a switched actuator has not arrived, by its end-stop or without one by the travel time.

        An actuator that was reported stuck no longer counts.
        """
        return self._watch.moving(self.measured(), now)

    def passive(self) -> tuple[Fault, ...]:
        """Buses whose controller is error-passive: they still work, and may soon not."""
        return tuple(fault for bus in self._buses.values() if (fault := bus.passive()) is not None)

    def status(self) -> Status:
        """For diagnostics."""
        return Status(
            buses=tuple(bus.status(self._worst_case[name]) for name, bus in self._buses.items()),
            boards=tuple(node.status() for node in self._nodes),
        )

    def close(self) -> None:
        """Stops reading and shuts the buses; sends nothing, so the boards do what they do on loss of the master."""
        for bus in self._buses.values():
            bus.close()

    def _ask(self, node: Node) -> None:
        """Asks a board for its inputs; the answer is read like a TPDO, which may have been lost."""
        for sub in node.ask():
            self._question(node, 0x6000, sub)

    def _question(self, node: Node, index: int, sub: int) -> None:
        with contextlib.suppress(BusBusy):
            message = cia301.frame(cia301.SDO_REQUEST + node.board.node, cia301.upload(index, sub))
            self._buses[node.board.bus].send(message)

    def _wake(self) -> None:
        with self._news:
            self._news.notify_all()

    def _refuse_unless_up(self) -> None:
        for bus in self._buses.values():
            if not bus.armed:
                raise BusBusy(f"{bus.name} is {bus.state} or was lost: nothing is sent until start is called")
        for node in self._nodes:
            if not node.ready:
                raise BusBusy(f"board {node.board.name} is not up: nothing is sent until start brings it up")

    def _lose_bus(self, fault: Fault) -> None:
        for node in self._nodes:
            if node.board.bus == fault.source:
                node.ready = False  # the bus is at fault, not each of its boards
        self._faults.report(fault)
