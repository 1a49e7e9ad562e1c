"""Shares of a study: what a worker computes, in this process, in a local one, or on a cluster.

A job is what all shares of a study have in common, such as an arm. It is sent with each share, so that a worker that
joins late, or replaces a lost one, has it. A worker prepares a job once, and keeps the last few.
"""

from __future__ import annotations

import hashlib
import pickle
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from importlib import metadata
from threading import Lock
from typing import Any, NamedTuple, Protocol

KEPT = 2  # prepared jobs of a process
MOST = 512  # goals of a share
MOST_BY_TIME = 16  # goals of a share that are searched by time
SHARE_EFFORT = 640.0  # of the searches of a share, unless they need more: about half a second

Run = Callable[[Any], Iterable[Any]]


class StudyFailed(Exception):
    """A study cannot begin, or cannot go on; the message tells why, and what to do."""


class Job(Protocol):
    """What all shares of a study have in common; it can be pickled."""

    def prepare(self) -> Run:
        """Builds the tables; returns the function that yields the results of a share, one call at a time."""


Spread = Callable[[Job, Iterable[Any]], Iterator[Any]]  # yields the results of all shares, in order


def alone(job: Job, shares: Iterable[Any]) -> Iterator[Any]:
    """Yields each result of the shares as soon as this process has computed it."""
    run = job.prepare()
    for share in shares:
        yield from run(share)


class PackedJob(NamedTuple):
    """A job on its way to workers.

    Attributes:
        content: the pickled job.
        digest: of the content.
        version: hyperbit's version where it was packed.
    """

    content: bytes
    digest: str
    version: str


class PreparedJobs:
    """The jobs that this process has prepared, the last few. A job has one solver for each thread that uses it."""

    def __init__(self) -> None:
        self._idle: OrderedDict[str, list[Run]] = OrderedDict()
        self._lock = Lock()

    def compute(self, job: PackedJob, share: Any) -> list[Any]:
        """Returns the results of a share."""
        run = self._take(job.digest) or unpacked(job).prepare()
        try:
            return list(run(share))
        finally:
            with self._lock:
                self._idle.get(job.digest, []).append(run)

    def _take(self, digest: str) -> Run | None:
        """Returns an idle run of a job, None if there is none; forgets the jobs that were used least recently."""
        with self._lock:
            idle = self._idle.setdefault(digest, [])
            self._idle.move_to_end(digest)
            while len(self._idle) > KEPT:
                self._idle.popitem(last=False)
            return idle.pop() if idle else None


PREPARED = PreparedJobs()


def goals_a_share(effort: float | None) -> int:
    """Returns the number of goals of a share, from the effort of each; None: they are searched by time."""
    return MOST_BY_TIME if effort is None else max(1, min(MOST, int(SHARE_EFFORT / effort)))


def pack(job: Job) -> PackedJob:
    """Returns a job as workers receive it.

    Raises:
        StudyFailed: a part of the job cannot be sent.
    """
    try:
        content = pickle.dumps(job)
    except (AttributeError, TypeError, pickle.PicklingError) as error:
        raise StudyFailed(
            f"the work cannot be sent to workers, name functions and classes at top level: {error}"
        ) from None
    return PackedJob(content, hashlib.sha256(content).hexdigest(), metadata.version("hyperbit"))


def unpacked(job: PackedJob) -> Job:
    """Returns a job that has arrived.

    Raises:
        StudyFailed: the content is not what was packed, or needs what this worker does not have.
    """
    if (found := hashlib.sha256(job.content).hexdigest()) != job.digest:
        raise StudyFailed(f"the job has arrived with the digest {found[:12]}, and was sent with {job.digest[:12]}")
    try:
        own: Job = pickle.loads(job.content)
    except Exception as error:
        raise StudyFailed(f"a worker needs the modules of this computer: {type(error).__name__}: {error}") from None
    return own


def compute(job: PackedJob, share: Any) -> list[Any]:
    """Returns the results of a share; for workers.

    Raises:
        StudyFailed: this worker has another version of hyperbit.
    """
    if (own := metadata.version("hyperbit")) != job.version:
        raise StudyFailed(wrong_version("this worker", own, job.version))
    return PREPARED.compute(job, share)


def wrong_version(worker: str, found: str, needed: str) -> str:
    """Returns the sentence about a worker with another version of hyperbit."""
    return f"{worker} has hyperbit {found}, and this study needs {needed}: install hyperbit {needed} there"
