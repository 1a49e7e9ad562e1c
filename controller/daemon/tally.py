"""Switch counts that outlive a killed process: written in place before each SYNC, to a small file beside the ledger."""

import logging
import os
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

log = logging.getLogger(__name__)

NOTHING = -1  # what is intended with an actuator that is to stay


def default_path(ledger: Path) -> Path:
    """Returns where the counts of a ledger are: systemd's RuntimeDirectory, which is in memory, else beside it."""
    folder = os.environ.get("RUNTIME_DIRECTORY")
    return (Path(folder) if folder else ledger.parent) / f"{ledger.name}-tally"


class Tally:
    """Counts the switches of A actuators. The control loop's.

    What a stage is to switch is written before its SYNC, beside the counts so far. A process that is killed after
    that leaves open whether the SYNC has left; the boards' outputs tell, when the next process has read them back.
    Nothing is forced to the disk, so that nothing waits for it: what was written outlives the process, not the
    computer.

    Attributes:
        counts: of each actuator, shape (A,).

    Args:
        path: of the file; where it cannot be written counts are kept in memory only.
        actuators: labels, in the order of the state vectors; counts of other actuators are not read.
        counts: known from elsewhere, shape (A,); the higher ones are right, for counts only grow.
    """

    def __init__(self, path: Path, actuators: Sequence[str], counts: NDArray[np.int64]) -> None:
        self.counts = counts.copy()
        self._intended = np.full(len(actuators), NOTHING, dtype=np.int8)
        self._labels = zlib.crc32("\n".join(actuators).encode())
        self._number = 0
        self._file: int | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            self._read()
        except OSError as error:
            log.error("%s: switches of the last half second would be lost with a killed daemon: %s", path, error)

    def intend(self, outputs: NDArray[np.uint8], states: NDArray[np.uint8]) -> None:
        """Notes that boards with these outputs (A,) are to be switched to these states (A,), before they are."""
        self._intended = np.where(outputs != states, states.astype(np.int8), np.int8(NOTHING))
        self._write()

    def resolve(self, outputs: NDArray[np.uint8]) -> NDArray[np.intp]:
        """Counts what of the intended has come about, as the boards' outputs (A,) tell; returns those actuators."""
        switched = np.flatnonzero(self._intended == outputs)
        if (self._intended != NOTHING).any():
            self.counts[switched] += 1
            self._intended[:] = NOTHING
            self._write()
        return switched

    def close(self) -> None:
        """Closes the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _write(self) -> None:
        """Writes a record over the older of two, so that one is whole whenever the process ends."""
        if self._file is None:
            return
        self._number += 1
        data = self._packed(self._number)
        try:
            os.pwrite(self._file, data, self._number % 2 * len(data))
        except OSError as error:  # the disk is full: the ledger, which finds so too, tells
            log.debug("tally not written: %s", error)

    def _packed(self, number: int) -> bytes:
        body = struct.pack("<QI", number, self._labels) + self.counts.tobytes() + self._intended.tobytes()
        return struct.pack("<I", zlib.crc32(body)) + body

    def _read(self) -> None:
        """Takes over the newer of the records that are whole and of these actuators."""
        size, known = len(self._packed(0)), self.counts
        for place in (0, size):
            data = b"" if self._file is None else os.pread(self._file, size, place)
            if len(data) < size or struct.unpack_from("<I", data)[0] != zlib.crc32(data[4:]):
                continue
            number, labels = struct.unpack_from("<QI", data, 4)
            if labels == self._labels and number > self._number:
                counts = np.frombuffer(data, np.int64, len(known), 16)
                self._number, self.counts = number, np.maximum(known, counts)
                self._intended = np.frombuffer(data, np.int8, len(known), 16 + counts.nbytes).copy()
