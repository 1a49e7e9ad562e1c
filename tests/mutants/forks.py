"""Runs work in forked children of a warm process, with limits of time and memory."""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

MEMORY = 3 << 30  # [bytes] that a child may take beyond the warm process

Result = dict[str, Any]


@dataclass
class Child:
    """A forked process that writes one line of JSON.

    Attributes:
        seconds: wall-clock time since its start [s].
    """

    name: Any
    pid: int
    pipe: int
    began: float
    deadline: float
    heard: bytearray = field(default_factory=bytearray)

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.began


def start(name: Any, work: Callable[[], Result], limit: float, patience: float) -> Child:
    """Forks a child that does the work and reports its result.

    Args:
        limit: processor time [s].
        patience: wall-clock time [s].
    """
    reading, writing = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        os.close(reading)
        _work(work, writing, limit)
    os.close(writing)
    now = time.monotonic()
    return Child(name, pid, reading, now, now + patience)


def _work(work: Callable[[], Result], pipe: int, limit: float) -> NoReturn:
    code = 1
    try:
        os.setsid()
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        null = os.open(os.devnull, os.O_RDWR)
        for k in range(3):
            os.dup2(null, k)
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, size + MEMORY))
        # The parent's time does not count: a child begins at zero.
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit) + 1, int(limit) + 10))
        try:
            result = work()
        except BaseException:  # a mistake of this tool
            result = {"broken": traceback.format_exc()}
        used = resource.getrusage(resource.RUSAGE_SELF)
        line = json.dumps({**result, "cpu": round(used.ru_utime + used.ru_stime, 2)})
        with os.fdopen(pipe, "w") as out:
            out.write(line + "\n")
        code = 0
    finally:
        os._exit(code)


def ended(children: list[Child]) -> Iterator[tuple[Child, Result]]:
    """Waits until a child ends or its time is over; yields those, with their results, and takes them off the list.

    A child that ends without a result has found the defect, too.
    """
    until = min(child.deadline for child in children)
    ready, _, _ = select.select([child.pipe for child in children], [], [], max(until - time.monotonic(), 0.0))
    for child in list(children):
        late = time.monotonic() >= child.deadline
        over = False
        if child.pipe in ready:
            chunk = os.read(child.pipe, 1 << 16)
            child.heard += chunk
            over = not chunk or chunk.endswith(b"\n")
        if over or late:
            children.remove(child)
            yield child, {**_end(child), "seconds": round(child.seconds, 1)}


def stop(children: list[Child]) -> None:
    while children:
        child = children.pop()
        os.kill(child.pid, signal.SIGKILL)  # it may have no group yet
        _end(child)


def _end(child: Child) -> Result:
    complete = child.heard.endswith(b"\n")
    if time.monotonic() >= child.deadline or complete:  # else it ends by itself, and its status tells why
        _kill(child.pid)
    _, status = os.waitpid(child.pid, 0)
    _kill(child.pid)  # what it has started and left
    os.close(child.pipe)
    if complete:
        result: Result = json.loads(child.heard)
        if "broken" in result:
            raise RuntimeError(f"{child.name}: {result['broken']}")
        return result
    code = os.waitstatus_to_exitcode(status)
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        return {"found": True, "why": "does not end"}
    return {"found": True, "why": f"ends with signal {-code}" if code < 0 else f"exits with status {code}"}


def _kill(group: int) -> None:
    try:
        os.killpg(group, signal.SIGKILL)
    except ProcessLookupError:
        return
