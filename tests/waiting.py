"""How tests wait: for a condition, with a time-out."""

import os
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

# How many times slower than usual this machine is. In an emulated one, all times of tests and boards are scaled by it.
SLOWNESS = float(os.environ.get("HYPERBIT_SLOWNESS", "1"))
PATIENCE = 60.0 * SLOWNESS  # [s]; a busy machine is slow


def eventually(
    what: Callable[[], T], patience: float = PATIENCE, told: Callable[[], str] = lambda: "", every: float = 0.005
) -> T:
    """Returns the first true value of `what`, called again and again; fails if none comes in time.

    Args:
        patience: time until it fails [s].
        every: pause between two calls [s], on a machine that is not slow.
    """
    until = time.monotonic() + patience
    while not (value := what()):
        assert time.monotonic() < until, f"the awaited condition did not come {told()}"
        time.sleep(every * SLOWNESS)
    return value
