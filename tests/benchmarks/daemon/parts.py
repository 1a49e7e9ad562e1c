"""One part of a running arm, which also records times: python -m tests.benchmarks.daemon.parts KIND FOLDER ARGUMENTS

| kind | part | its file: columns [s] |
|---|---|---|
| boards | the boards of an arm's file on an emulated bus | syncs.npz, beats.npz: when the executor handed them over |
| executor | the unmodified executor | ticks.npz: begin, lateness and duration of each tick |
| polled | the executor on a bus without a file descriptor | ticks.npz |
| planner | the unmodified `hyperbit run` | solves.npz: begin and end of each search |
| bare | an empty loop with the executor's period and scheduling | bare.npz: begin and lateness |
| listener | a bare subscriber of Zenoh at an endpoint | pings.npz: when its callback began |
"""

import gc
import math
import select
import signal
import socket
import sys
import threading
import time
from collections import deque
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

import can.interfaces
import numpy as np
import zenoh

from hyperbit.controller.armfile.settings import RealTimeSettings
from hyperbit.controller.executor.__main__ import main as execute
from hyperbit.controller.executor.arm.arm import read_arm
from hyperbit.controller.executor.process.real_time import enter_real_time, lock_memory, raise_priority
from hyperbit.controller.executor.process.run import Timekeeper
from hyperbit.controller.network import session
from hyperbit.controller.program import TICK
from hyperbit.drivers.canopen.wire.cia301 import HEARTBEAT, SYNC, Frame
from hyperbit.drivers.canopen.wiring import MASTER
from hyperbit.drivers.simulation.buses import SimulatedBuses
from tests import emulated
from tests.emulated import FRAME, UP

MOST = 200_000  # rows of a record; further ones are dropped
PRIORITY = 10  # of the boards, below the executor's: real boards do not wait for this computer's processors
AHEAD = 1  # of the empty loop before the executor: it does nothing, and must not wait for the executor's tick


class Record:
    """Rows of numbers, written to a file at the end of the context, so that no I/O disturbs the measurement."""

    def __init__(self, path: Path, *columns: str) -> None:
        self._path, self._columns = path, columns
        self._rows, self._count = np.ones((MOST, len(columns))), 0  # written, so that no page is new later

    def note(self, *row: float) -> None:
        if self._count < MOST:
            self._rows[self._count] = row
            self._count += 1

    def __enter__(self) -> "Record":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        np.savez(self._path, **{name: self._rows[: self._count, k] for k, name in enumerate(self._columns)})


class Bus:
    """The one bus: each frame of the executor comes back as its echo, and goes to all boards."""

    def __init__(self, channel: Path, arm: Path, records: dict[int, Record], spread: bool) -> None:
        executed = read_arm(arm)
        (self._name,) = (bus.name for bus in executed.wiring.buses)
        self._boards, self._records = SimulatedBuses(executed.wiring, executed.timing, self._send), records
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.bind(str(channel / "socket"))
        self._server.listen()
        (channel / "state").write_bytes(bytes([UP, 0]))
        self._client: socket.socket | None = None
        boards = [board.node for board in executed.wiring.boards]
        step = executed.timing.heartbeat / len(boards) if spread else 0.0
        self._delays = {HEARTBEAT + node: k * step for k, node in enumerate(boards)}  # [s] of heartbeats
        self._late: deque[tuple[float, Frame]] = deque()

    def run(self, ending: threading.Event) -> None:
        while not ending.is_set():
            due = min(self._boards.next_due(), self._late[0][0] if self._late else math.inf)
            wait = min(max(due - time.monotonic(), 0.0), 0.1)
            readable = select.select([self._client or self._server], [], [], wait)[0]
            if readable and self._client is None:
                self._client, _ = self._server.accept()
                self._client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 << 20)
                self._client.recv(1)
            elif readable:
                self._receive()
            self._boards.step(time.monotonic())
            while self._late and self._late[0][0] <= time.monotonic():
                self._put(self._late.popleft()[1])

    def _receive(self) -> None:
        assert self._client is not None
        waiting: list[Frame] = []
        while select.select([self._client], [], [], 0.0)[0]:  # all echoes first: real boards act meanwhile
            try:
                packet = self._client.recv(FRAME.size)
            except ConnectionResetError:  # the executor has ended with frames unread
                packet = b""
            if not packet:
                self._client.close()
                self._client = None
                return
            identifier, length, data, _, sent = FRAME.unpack(packet)
            self._client.send(FRAME.pack(identifier, length, data, True, time.time()))
            if identifier in self._records:
                self._records[identifier].note(sent)
            waiting.append(Frame(identifier, data[:length]))
        for frame in waiting:
            self._boards.receive(self._name, frame, time.monotonic())

    def _send(self, bus: str, frame: Frame) -> None:
        if delay := self._delays.get(frame.id, 0.0):
            self._late = deque(sorted((*self._late, (time.monotonic() + delay, frame))))
        else:
            self._put(frame)

    def _put(self, frame: Frame) -> None:
        if self._client is not None:
            self._client.send(FRAME.pack(frame.id, len(frame.data), frame.data, False, time.time()))


def boards(folder: Path, ending: threading.Event, channel: str, arm: str, spread: str = "") -> None:
    with Record(folder / "syncs.npz", "at") as syncs, Record(folder / "beats.npz", "at") as beats:
        bus = Bus(Path(channel), Path(arm), {SYNC: syncs, HEARTBEAT + MASTER: beats}, spread != "")
        if (refused := raise_priority(PRIORITY)) is None:
            lock_memory()
        print(refused or "real time", flush=True)
        bus.run(ending)


def executor(folder: Path, ending: threading.Event, *arguments: str) -> int:
    can.interfaces.BACKENDS["virtual"] = (emulated.__name__, "EmulatedBus")
    ticked = Timekeeper.ticked
    with Record(folder / "ticks.npz", "began", "late", "work") as record:

        def noting(keeper: Timekeeper, began: float, ended: float, planned: float) -> None:
            record.note(began, began - keeper.next_tick, ended - began)
            ticked(keeper, began, ended, planned)

        Timekeeper.ticked = noting  # type: ignore[method-assign]
        return execute(list(arguments))


def polled(folder: Path, ending: threading.Event, *arguments: str) -> int:
    emulated.EmulatedBus.fileno = lambda self: -1  # type: ignore[method-assign]
    return executor(folder, ending, *arguments)


def planner(folder: Path, ending: threading.Event, *arguments: str) -> int:
    from hyperbit.controller.search.solver import Solver
    from tests.system.stack.nursery import run

    solve = Solver.solve
    with Record(folder / "solves.npz", "began", "ended") as record:

        def timing(*given: Any, **options: Any) -> Any:
            began = time.monotonic()
            try:
                return solve(*given, **options)
            finally:
                record.note(began, time.monotonic())

        Solver.solve = timing  # type: ignore[method-assign]
        return run(list(arguments))


def bare(folder: Path, ending: threading.Event) -> None:
    with Record(folder / "bare.npz", "began", "late") as record:
        print(enter_real_time(RealTimeSettings(RealTimeSettings().priority + AHEAD)), flush=True)
        gc.freeze()
        gc.disable()
        due = time.monotonic()
        while not ending.is_set():
            while (left := due - time.monotonic()) > 0:
                select.select([], [], [], left)
            began = time.monotonic()
            record.note(began, began - due)
            due = max(due + TICK, began)


def listener(folder: Path, ending: threading.Event, endpoint: str) -> None:
    with ExitStack() as stack:
        record = stack.enter_context(Record(folder / "pings.npz", "at"))
        opened = stack.enter_context(zenoh.open(session.configuration("peer", listen=endpoint)))
        opened.declare_subscriber("ping/goal", lambda sample: record.note(time.monotonic()))
        print("ready", flush=True)
        ending.wait()


KINDS = {part.__name__: part for part in (boards, executor, polled, planner, bare, listener)}


def main(kind: str, folder: str, *arguments: str) -> None:
    ending = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ending.set())  # executor and planner set their own
    sys.exit(KINDS[kind](Path(folder), ending, *arguments))


if __name__ == "__main__":
    main(*sys.argv[1:])
