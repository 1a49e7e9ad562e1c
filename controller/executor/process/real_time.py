"""Real time: SCHED_FIFO and locked memory. The service's unit gives the priority, or the arm's file requests it."""

import ctypes
import logging
import os
import resource
from pathlib import Path

from hyperbit.controller.armfile.settings import RealTimeSettings
from hyperbit.controller.host.scheduling import shorten_slice

log = logging.getLogger(__name__)

# From asm-generic/mman.h. With ONFAULT, pages that were never touched take no memory.
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4
CAP_IPC_LOCK = 14  # from linux/capability.h


def enter_real_time(settings: RealTimeSettings | None) -> str:
    """Gives the process a priority of SCHED_FIFO, unless it has one, and locks its memory.

    Without permission the executor continues: motions are as safe, but the loop's period varies more. Without settings
    the unit alone decides. Returns "off", "on", or a sentence on what is missing.
    """
    given = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)
    if settings is None and not given:
        shorten_slice()
        return "off"
    words = [None if given or settings is None else raise_priority(settings.priority), lock_memory()]
    missing = [word for word in words if word]
    for word in missing:
        log.warning("real time: %s; continuing without it", word)
    return "; ".join(missing) or "on"


def raise_priority(priority: int) -> str | None:
    """Gives the process a priority of SCHED_FIFO, which children do not inherit; returns what is missing, or None."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        return (
            f"SCHED_FIFO with priority {priority} is not permitted: CPUSchedulingPolicy=fifo in the unit is needed,"
            " or CAP_SYS_NICE"
        )
    return None


def lock_memory() -> str | None:
    """Locks the memory of the process against paging; returns what is missing, or None."""
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit != resource.RLIM_INFINITY and not may_lock_all():  # an allocation would fail in the middle of a motion
        return f"memory can be locked up to {limit} bytes only: LimitMEMLOCK=infinity in the unit is needed"
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0:
        return f"memory cannot be locked: {os.strerror(ctypes.get_errno())}"
    return None


def may_lock_all() -> bool:
    """Returns whether the process has CAP_IPC_LOCK, which makes it exempt from the limit."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (effective,) = (int(line.split()[1], 16) for line in lines if line.startswith("CapEff"))
    return bool(effective >> CAP_IPC_LOCK & 1)
