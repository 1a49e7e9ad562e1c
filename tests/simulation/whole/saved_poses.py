"""The file of the saved poses: it survives the processes, cannot be written while the disk is full, or is damaged."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from random import Random
from unittest import mock

from hyperbit.controller.gateway.poses import Poses
from hyperbit.controller.host import files

MEMORY = Path("/dev/shm")


class SavedPoses:
    def __init__(self, random: Random) -> None:
        self._random = random
        self._folder = tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None)
        self._path = Path(self._folder.name, "arm.poses.json")

    def poses(self) -> Poses:
        if self._random.random() < 0.1:
            self._path.write_bytes(self._random.choice([b"{", b"\xff", b'{"": {}}', b"[]"]))
        with mock.patch.object(files.log, "disabled", True):
            return Poses(self._path, "home of the model")

    def fill(self, full: bool) -> None:
        """Lets the disk be full, or no longer: another file cannot be begun."""
        fresh = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        if full and not fresh.is_dir():
            fresh.unlink(missing_ok=True)
            fresh.mkdir()
        elif not full and fresh.is_dir():
            fresh.rmdir()
