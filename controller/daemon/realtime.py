"""Real time, where the arm's file asks for it: the control loop's thread first, all memory kept."""

import contextlib
import ctypes
import logging
import os
import resource
from pathlib import Path

from controller.settings import RealTimeSettings

log = logging.getLogger(__name__)

# Of asm-generic/mman.h. What is mapped but was never touched is not read in: that would take three times the memory.
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4
CAP_IPC_LOCK = 14  # of linux/capability.h


class RealTime:
    """What is asked of the system while a daemon runs, and given back after it.

    What is not permitted is said in the journal and in diagnostics, and the daemon goes on without: the arm moves as
    safely, its periods are less even.

    Attributes:
        status: "off", "on", or what is missing, in a sentence.

    Args:
        settings: of the arm's file; None: nothing is asked.
    """

    def __init__(self, settings: RealTimeSettings | None) -> None:
        self.status = "off"
        self._settings = settings

    def __enter__(self) -> "RealTime":
        """Makes the calling thread, which is to run the control loop, a real-time one."""
        if self._settings is None:
            return self
        missing = [word for word in (run_first(self._settings.priority), lock_memory()) if word]
        for word in missing:
            log.warning("real time: %s; going on without", word)
        self.status = "; ".join(missing) or "on"
        return self

    def __exit__(self, *_: object) -> None:
        if self._settings is None:
            return
        ctypes.CDLL(None).munlockall()
        with contextlib.suppress(PermissionError):  # then it was not made one, either
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def run_first(priority: int) -> str | None:
    """Gives the calling thread, and none that it starts, a priority of SCHED_FIFO; returns what forbids it."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        return (
            f"SCHED_FIFO with priority {priority} is not permitted: LimitRTPRIO={priority} and RestrictRealtime=no in"
            " the unit are needed, or CAP_SYS_NICE"
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
    """Returns whether the process has CAP_IPC_LOCK, for which no limit holds."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (effective,) = (int(line.split()[1], 16) for line in lines if line.startswith("CapEff"))
    return bool(effective >> CAP_IPC_LOCK & 1)
