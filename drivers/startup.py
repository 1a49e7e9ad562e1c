"""Bringing boards up without switching anything."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import can
import numpy as np

from drivers import cia301, configuration
from drivers.bus import CanBus
from drivers.cia301 import Command, State
from drivers.device_type import check_type
from drivers.faults import BusBusy, Fault
from drivers.node import Node
from drivers.outputs import Outputs
from drivers.sdo import BoardError, Sdo
from drivers.wiring import Timing, Wiring

_PROBE_TIME = 0.5  # [s] for the answers to a probe of all silent boards
_Board = tuple[Node, CanBus, Sdo]


class Startup:
    """Brings boards up: present, of the right type, configured, operational, their states read.

    Args:
        wiring: what the boards do on loss of the master.
        timing: heartbeats and patience.
        outputs: takes the outputs read back.
        news: notified by the readers with every frame of a board, and held while they take one in.
    """

    def __init__(self, wiring: Wiring, timing: Timing, outputs: Outputs, news: threading.Condition) -> None:
        self._wiring = wiring
        self._timing = timing
        self._outputs = outputs
        self._news = news

    def run(self, boards: Sequence[_Board]) -> list[Fault]:
        """Brings all boards up together and tells what stands in the way, one fault a board."""
        faults: list[Fault] = []

        def each(step: Callable[[Node, CanBus, Sdo], None], boards: Sequence[_Board]) -> list[_Board]:
            done = []
            for board in boards:
                try:
                    step(*board)
                    done.append(board)
                except BoardError as error:
                    faults.append(error.fault)
            return done

        heard = self._find(boards)
        present = each(self._configure, [b for b in boards if b[0] in heard])
        faults += [self._missing(node) for node, _, _ in boards if node not in heard]
        if not self._wait(lambda: operational(present), 3 * self._timing.heartbeat):
            # Some may have missed the heartbeat of the daemon before just now: these are brought up from there.
            fell = [board for board in present if board[0].state is State.PRE_OPERATIONAL]
            up = each(self._configure, fell)
            present = [board for board in present if board in up or board not in fell]
            self._wait(lambda: operational(present), self._timing.boot_timeout)
        each(self._finish, present)
        return faults

    def _find(self, boards: Sequence[_Board]) -> set[Node]:
        """Boards that say anything in time; a question is asked first, and again of those silent at the end."""
        before = {node: node.frames for node, _, _ in boards}

        def silent() -> list[tuple[Node, CanBus]]:
            return [(node, bus) for node, bus, _ in boards if node.frames == before[node]]

        for patience in (self._timing.boot_timeout, _PROBE_TIME):
            for node, bus in silent():
                self._send(cia301.frame(cia301.SDO_REQUEST + node.board.node, cia301.upload(0x1000, 0)), bus)
            self._wait(lambda: not silent(), patience)
        return {node for node in before if node.frames != before[node]}

    def _configure(self, node: Node, bus: CanBus, sdo: Sdo) -> None:
        board, action = node.board, self._wiring.on_loss
        if node.state is State.STOPPED:
            self._order(Command.PRE_OPERATIONAL, node, bus)
        check_type(node.board, sdo)
        self._learn_state(node, sdo)
        no_remote = sdo.read(0x1800, 1, size=4) & cia301.NO_REMOTE if board.inputs else 0
        entries = configuration.communication(board, self._timing, action, no_remote)
        loss = configuration.on_loss(board, action)
        if node.state is State.OPERATIONAL and all(sdo.holds(e) for e in configuration.final(entries) + loss):
            node.state = None  # it may have left that since its last heartbeat
            return
        # Some boards take 6207h already when they become pre-operational: the outputs hold from first to last.
        for entry in configuration.hold(board):
            sdo.write(entry)
        if node.state is not State.PRE_OPERATIONAL:
            self._order(Command.PRE_OPERATIONAL, node, bus)
        for entry in entries:
            sdo.write(entry)
        node.state = None  # so that an older heartbeat is not taken for the answer
        self._order(Command.START, node, bus)

    def _learn_state(self, node: Node, sdo: Sdo) -> None:
        """Waits for a heartbeat of a board that has only answered so far, if it sends any."""
        period = 0.0 if node.state is not None else sdo.read(0x1017, 0, size=2) / 1000
        self._wait(lambda: node.state is not None, min(2 * period, self._timing.boot_timeout))

    def _finish(self, node: Node, bus: CanBus, sdo: Sdo) -> None:
        board = node.board
        if node.state is not State.OPERATIONAL:
            seen = "no heartbeat came" if node.state is None else f"it is {node.state.words}"
            text = f"board {board.name} did not become operational within {self._timing.boot_timeout:g} s; {seen}"
            raise BoardError(Fault("board-stopped", board.name, text))
        if self._wiring.on_loss != "hold":  # only now: until here the outputs were to hold
            for entry in configuration.on_loss(board, self._wiring.on_loss):
                sdo.write(entry)
        outputs = bytes(sdo.read(0x6200, sub) for sub in board.outputs)
        before = node.input_frames
        inputs = bytes(sdo.read(0x6000, sub) for sub in board.inputs)
        with self._news:
            self._outputs.adopt(board, outputs)
            if node.input_frames == before:  # else a newer word came by TPDO
                node.inputs[:] = np.frombuffer(inputs, np.uint8)
            node.ready = True

    def _missing(self, node: Node) -> Fault:
        name = node.board.name
        text = f"board {name} neither booted nor answered within {self._timing.boot_timeout:g} s: is it powered?"
        return Fault("board-missing", name, text)

    def _order(self, order: Command, node: Node, bus: CanBus) -> None:
        if not self._send(cia301.command(order, node.board.node), bus):
            text = f"board {node.board.name} could not be told to change its state: {bus.name} takes no frames"
            raise BoardError(Fault("board-missing", node.board.name, text))

    @staticmethod
    def _send(message: can.Message, bus: CanBus) -> bool:
        try:
            bus.send(message)
        except BusBusy:
            return False
        return True

    def _wait(self, what: Callable[[], bool], patience: float) -> bool:
        with self._news:
            return self._news.wait_for(what, patience)


def operational(boards: Sequence[_Board]) -> bool:
    """Whether all boards say that they are."""
    return all(node.state is State.OPERATIONAL for node, _, _ in boards)
