"""The boards of an arm on an emulated bus, in a separate process with one thread.

python -m tests.benchmarks.daemon.chain.boards RECORDS FOLDER ARM.yaml. FOLDER is the channel of the emulated interface.
RECORDS is a folder: syncs.npz and beats.npz have a row for each SYNC and each heartbeat of the master, when the
executor handed it to the interface.

Real boards do not wait for this computer's processors. So this process has a real-time priority, if that is permitted,
below the executor's.
"""

import select
import signal
import socket
import sys
import time
from pathlib import Path

from hyperbit.controller.executor.arm.arm import read_arm
from hyperbit.controller.executor.process.real_time import lock_memory, raise_priority
from hyperbit.drivers.canopen.wire.cia301 import HEARTBEAT, SYNC, Frame
from hyperbit.drivers.canopen.wiring import MASTER
from hyperbit.drivers.simulation.buses import SimulatedBuses
from tests.benchmarks.daemon.chain.records import Record
from tests.emulated import FRAME, UP

PRIORITY = 10
BEAT = HEARTBEAT + MASTER


class Bus:
    """The one bus: each frame of the executor comes back as its echo and goes to all boards.

    Args:
        syncs: keeps when each SYNC was handed over [s].
        beats: keeps the same of each heartbeat of the master [s].
    """

    def __init__(self, channel: Path, arm: Path, syncs: Record, beats: Record) -> None:
        executed = read_arm(arm)
        (self._name,) = (bus.name for bus in executed.wiring.buses)
        self._boards = SimulatedBuses(executed.wiring, executed.timing, self._send)
        self._records = {SYNC: syncs, BEAT: beats}
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.bind(str(channel / "socket"))
        self._server.listen()
        (channel / "state").write_bytes(bytes([UP, 0]))
        self._client: socket.socket | None = None
        self.ending = False

    def run(self) -> None:
        while not self.ending:
            wait = min(max(self._boards.next_due() - time.monotonic(), 0.0), 0.1)
            readable = select.select([self._client or self._server], [], [], wait)[0]
            if readable and self._client is None:
                self._client, _ = self._server.accept()
                self._client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 << 20)
                self._client.recv(1)
            elif readable:
                self._receive()
            self._boards.step(time.monotonic())

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
            if (record := self._records.get(identifier)) is not None:
                record.note(sent)
            waiting.append(Frame(identifier, data[:length]))
        for frame in waiting:
            self._boards.receive(self._name, frame, time.monotonic())

    def _send(self, bus: str, frame: Frame) -> None:
        if self._client is not None:
            self._client.send(FRAME.pack(frame.id, len(frame.data), frame.data, False, time.time()))


def main(records: Path, channel: Path, arm: Path) -> None:
    with Record(records / "syncs.npz", "at") as syncs, Record(records / "beats.npz", "at") as beats:
        bus = Bus(channel, arm, syncs, beats)

        def end(*_: object) -> None:
            bus.ending = True

        signal.signal(signal.SIGTERM, end)
        if (refused := raise_priority(PRIORITY)) is None:
            lock_memory()
        print(refused or "real time", flush=True)
        bus.run()


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
