"""Short time slices, for processes that must react soon and have no real-time priority."""

import ctypes
import os
import platform
import struct

SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}  # number of the system call
SCHED_ATTR = struct.Struct("=IIQiIQQQ")  # size, policy, flags, nice, priority, runtime [ns], deadline, period
SLICE = 100_000  # [ns], the shortest slice that the kernel accepts


def shorten_slice() -> bool:
    """Requests a short time slice, which is scheduled sooner; returns whether the kernel accepts the request.

    The request holds for the calling thread and for threads that it starts later. It needs no permission, but systemd's
    filter of system calls may refuse it. Linux 6.12 and later use it: on a busy machine the process waits less. A
    scheduling policy other than the default is left as it is.
    """
    number = SCHED_SETATTR.get(platform.machine())
    if number is None or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return False
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = SCHED_ATTR.pack(SCHED_ATTR.size, os.SCHED_OTHER, 0, nice, 0, SLICE, 0, 0)
    return bool(ctypes.CDLL(None).syscall(number, 0, attributes, 0) == 0)
