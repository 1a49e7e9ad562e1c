"""What tests of the switch journal do with its file."""

import os
import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hyperbit.controller.executor.process.journal_file import PAGE, FileJournal

LABELS = [f"1.{k}" for k in range(11)]
OFTEN = 0.02  # [s] between two copies
LIMITS = resource.getrlimit(resource.RLIMIT_FSIZE)


def killed(journal: FileJournal) -> None:
    """Releases the files like the end of the process, without a further write."""
    journal.mapped.close()
    journal.memory.close()


def switched(journal: FileJournal, states: int = 1) -> FileJournal:
    journal.intend(0, states)
    journal.resolve(states)
    return journal


def counted(path: Path, first: int = 3, memory: Any = None) -> list[int]:
    """Returns the first counts that an executor finds."""
    journal = FileJournal(path, LABELS, memory)
    assert journal.problem is None
    journal.close()
    return journal.counts[:first]


def after_power_failure(path: Path) -> int:
    """Returns the first count that an executor finds on the disk, without the file in memory."""
    other = path.with_name("after.switches")
    shutil.copyfile(path, other)
    return counted(other)[0]


@contextmanager
def full_disk(most: int) -> Iterator[Any]:
    """Cuts writes to files short after `most` bytes, as a full disk does; yields a file in memory for a journal."""
    memory = os.fdopen(os.memfd_create("journal"), "r+b", buffering=0)
    memory.truncate(16 * PAGE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, LIMITS[1]))
    try:
        yield memory
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, LIMITS)
