"""Logs of the frames of the arm's buses, beside a recording, in candump's format for can-utils and decoders."""

import logging
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

import can

from hyperbit.controller.armfile.settings import BusSettings
from hyperbit.controller.host.files import is_at

log = logging.getLogger(__name__)

POLL = 0.2  # [s] a thread waits for a frame, then checks whether it must end
REOPEN = 1.0  # [s] between attempts to open a bus
MOST_WAITING = 200_000  # frames between two flushes
ERROR = 1 << 29  # flag of error frames in candump's format


class CanLog:
    """Reads all buses of an arm, each in its own thread. It sends nothing.

    Args:
        buses: buses of the arm.
    """

    def __init__(self, buses: Sequence[BusSettings]) -> None:
        self._waiting: list[tuple[float, str]] = []
        self._lock, self._ending = threading.Lock(), threading.Event()
        self._file: IO[str] | None = None
        self._dropped = 0
        self._threads = [
            threading.Thread(target=self._read, args=(bus,), name=f"frames of {bus.name}", daemon=True) for bus in buses
        ]
        for thread in self._threads:
            thread.start()

    def begin(self, path: Path) -> None:
        """Continues in a new file."""
        self.flush()
        self._open(path)

    def _open(self, path: Path) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None
        try:
            self._file = path.open("a", encoding="ascii")
        except OSError as error:
            log.error("%s: frames are not written: %s", path, error.strerror)

    def flush(self) -> None:
        """Writes the frames read since the last call, ordered by time."""
        with self._lock:
            lines, self._waiting = self._waiting, []
            dropped, self._dropped = self._dropped, 0
        if dropped:
            log.warning("%d frames were dropped: the disk is too slow", dropped)
        if self._file is not None and not is_at(path := Path(self._file.name), self._file.fileno()):
            log.error("%s was deleted or moved while it was written: it is begun again", path)
            self._open(path)
        if self._file is None:
            return
        try:
            self._file.writelines(line for _, line in sorted(lines))
            self._file.flush()
        except OSError as error:
            log.error("frames are not written: %s", error.strerror)

    def close(self) -> None:
        """Ends the threads and closes the file."""
        self._ending.set()
        for thread in self._threads:
            thread.join()
        self.flush()
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def _read(self, settings: BusSettings) -> None:
        logged = ""
        while not self._ending.is_set():
            try:
                with can.Bus(
                    interface=settings.interface,
                    channel=settings.channel,
                    bitrate=settings.bitrate,
                    ignore_config=True,
                ) as bus:
                    logged = ""
                    while not self._ending.is_set():
                        if (message := bus.recv(POLL)) is not None:
                            self._put(message.timestamp, candump(message, settings.channel))
            except Exception as error:  # interfaces of python-can raise errors of any type
                if str(error) != logged:
                    logged = str(error)
                    log.warning("%s cannot be read: %s; next attempts every %g s", settings.name, error, REOPEN)
                self._ending.wait(REOPEN)

    def _put(self, stamp: float, line: str) -> None:
        with self._lock:
            if len(self._waiting) < MOST_WAITING:
                self._waiting.append((stamp, line))
            else:
                self._dropped += 1


def candump(message: can.Message, channel: str) -> str:
    """Returns a frame as a line of candump's log format."""
    number = message.arbitration_id | (ERROR if message.is_error_frame else 0)
    name = f"{number:08X}" if message.is_extended_id or message.is_error_frame else f"{number:03X}"
    data = "R" if message.is_remote_frame else bytes(message.data or b"").hex().upper()
    return f"({message.timestamp:.6f}) {channel} {name}#{data}\n"
