"""The folder of an arm's recordings: names, lock against a second recorder, repair, deletion of the oldest."""

import logging
import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from hyperbit.controller.host.files import is_at, set_aside
from hyperbit.controller.host.keeper import lock_file, number_of
from hyperbit.controller.recorder.repair import repair, unfinished

log = logging.getLogger(__name__)

CAN_LOG = ".candump"  # suffix of the frames beside a recording


class Folder:
    """The folder of one arm's recordings. Recordings that are incomplete at the start are repaired.

    Args:
        path: path of the folder; created if it is missing.
        arm: name of the arm.
        keep: most bytes of all recordings; the oldest are deleted beyond it. None: no limit.

    Raises:
        FileInUse: another recorder writes this arm's recordings into the folder.
        OSError: the folder cannot be written.
    """

    def __init__(self, path: Path, arm: str, keep: int | None = None) -> None:
        self._path, self._arm, self._keep = path, arm, keep
        self._kind = f"{arm}-[0-9]*.mcap"
        self._lock = self._locked()
        self._repair()

    def close(self) -> None:
        """Releases the lock."""
        os.close(self._lock)

    def new(self, now: float) -> Path:
        """Returns the path of a recording that begins at a UNIX time [s]; deletes old recordings first.

        A folder that somebody has deleted or moved is created again.
        """
        if not is_at(self._path / f".{self._arm}.lock", self._lock):
            lock, self._lock = self._lock, self._locked()
            os.close(lock)
        self.make_room()
        stem = f"{self._arm}-{datetime.fromtimestamp(now, UTC):%Y%m%dT%H%M%SZ}"
        last = max((number_of(path.stem) for path in self._recordings()), default=0)
        return self._path / f"{stem}-{last + 1}.mcap"

    def make_room(self, current: Path | None = None) -> None:
        """Deletes the oldest recordings and their frames beyond `keep` bytes, except the current recording."""
        if self._keep is None:
            return
        recordings = sorted(self._recordings(), key=lambda path: (number_of(path.stem), path.stat().st_mtime_ns))
        sizes = {path: sum(part.stat().st_size for part in parts(path)) for path in recordings}
        total = sum(sizes.values())
        for path in recordings:
            if total <= self._keep:
                return
            if path != current:
                total -= sizes[path]
                for part in parts(path):
                    part.unlink()
                log.info("%s deleted: the recordings exceed %d bytes", path, self._keep)

    def _locked(self) -> int:
        self._path.mkdir(parents=True, exist_ok=True)
        used = f"end the other recorder of the arm {self._arm!r}, or use another --folder: {self._path} is in use by"
        return lock_file(self._path / f".{self._arm}.lock", f"{used} process")

    def _repair(self) -> None:
        for path in sorted(self._recordings()):
            try:
                if unfinished(path) and not (found := repair(path, self._kind)).damage:
                    what = f"has {found.messages} messages" if found.records else "deleted, it had no message"
                    log.warning("%s was incomplete: repaired, %s", path, what)
            except OSError as error:
                log.error("%s is incomplete and cannot be repaired: %s", path, error.strerror)
            except Exception as error:  # what is read wrongly may be written wrongly, with nearly any exception
                set_aside(path, f"{type(error).__name__}: {error}", "it is not repaired", kind=self._kind)

    def _recordings(self) -> Iterator[Path]:
        """Yields the arm's recordings, without those of arms whose longer name begins with this arm's name."""
        for path in self._path.glob(f"{self._arm}-*.mcap"):
            if path.stem[len(self._arm) + 1 :][:8].isdecimal():
                yield path


def parts(path: Path) -> list[Path]:
    """Returns the existing files of a recording: the recording itself and its frames."""
    return [part for part in (path, path.with_suffix(CAN_LOG)) if part.exists()]
