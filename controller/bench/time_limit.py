"""A time limit for a block of Python code, in any thread."""

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class TooLongError(BaseException):
    """A method took too long for a goal. It is no Exception, so that a method does not catch it by accident."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raises TooLongError in the block after a time [s], at the next Python code of this thread.

    A call that waits, or computes outside Python, ends first. Nothing is raised after the end of the block.
    """
    thread = threading.get_ident()
    timer = threading.Timer(seconds, set_exception, (thread, TooLongError))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        set_exception(thread, None)  # the timer may have set one that is not raised yet


def set_exception(thread: int, kind: type[BaseException] | None) -> None:
    """Has a thread raise an exception at its next Python code; None: takes back one that it has not raised yet."""
    given = None if kind is None else ctypes.py_object(kind)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), given)
