"""Real time: SCHED_FIFO and locked memory, from the service's unit or as the arm's file asks."""

import contextlib
import ctypes
import logging
import os
import resource
from pathlib import Path

from controller.scheduling import shorten_slice
from controller.settings import RealTimeSettings

log = logging.getLogger(__name__)

# Of asm-generic/mman.h. With ONFAULT, pages that were never touched stay out of memory, where they need no room.
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4
CAP_IPC_LOCK = 14  # of linux/capability.h


def enter_real_time(settings: RealTimeSettings | None) -> str:
    """Gives the process a priority of SCHED_FIFO, unless it has one, and locks its memory.

    Without a permission the executor goes on: the arm moves as safely, its periods are less even.

    Args:
        settings: of the arm's file; None: only a priority that the unit has given counts.

    Returns:
        "off", "on", or what is missing, in a sentence.
    """
    given = is_real_time()
    if settings is None and not given:
        shorten_slice()
        return "off"
    words = [None if given or settings is None else raise_priority(settings.priority), lock_memory()]
    missing = [word for word in words if word]
    for word in missing:
        log.warning("real time: %s; going on without", word)
    return "; ".join(missing) or "on"


def leave_real_time() -> None:
    """Takes back both; for tests."""
    ctypes.CDLL(None).munlockall()
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def is_real_time() -> bool:
    """Returns whether the process was started with a real-time priority."""
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)


def raise_priority(priority: int) -> str | None:
    """Gives the process, and none that it starts, a priority of SCHED_FIFO; returns what forbids it."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        return (
            f"SCHED_FIFO with priority {priority} is not permitted: CPUSchedulingPolicy=fifo in the unit is needed,"
            " or CAP_SYS_NICE"
        )
    return None


def lock_memory() -> str | None:
    """Keeps all memory of the process from being paged out; returns what forbids it."""
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit != resource.RLIM_INFINITY and not may_lock_all():  # it would be refused in the middle of a motion
        return f"memory can be locked up to {limit} bytes only: LimitMEMLOCK=infinity in the unit is needed"
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0:
        return f"memory cannot be locked: {os.strerror(ctypes.get_errno())}"
    return None


def may_lock_all() -> bool:
    """Returns whether the process has CAP_IPC_LOCK, which lifts the limit."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (effective,) = (int(line.split()[1], 16) for line in lines if line.startswith("CapEff"))
    return bool(effective >> CAP_IPC_LOCK & 1)
