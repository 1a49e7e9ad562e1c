"""What stands in for the clock and the threads of the bridge."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from tests.ros2.fuzz.inputs import Input


class Clock:
    """Stands in for the module `time`."""

    def __init__(self) -> None:
        self.now = time.monotonic()
        self._epoch = time.time() - self.now

    def monotonic(self) -> float:
        return self.now

    def time(self) -> float:
        return self._epoch + self.now

    def time_ns(self) -> int:
        return int(self.time() * 1e9)

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@dataclass(eq=False)
class Trial:
    """One input, and what followed: dropped, said, replied, or the key of a request to the daemon."""

    input: Input
    outcomes: list[str] = field(default_factory=list)
    jobs: int = 0


class Pool:
    """Stands in for ThreadPoolExecutor: jobs run when the world says so.

    Args:
        pools: all that are open.
        present: returns the input that is being delivered.
    """

    def __init__(self, pools: "list[Pool]", present: Callable[[], Trial | None]) -> None:
        self._pools, self._present = pools, present
        self.jobs = deque[tuple[Callable[[], None], Trial | None]]()
        self.open = True
        pools.append(self)

    def submit(self, job: Callable[[], None]) -> None:
        if not self.open:
            raise RuntimeError("closed")
        trial = self._present()
        if trial:
            trial.jobs += 1
        self.jobs.append((job, trial))

    def shutdown(self, cancel_futures: bool = False) -> None:
        self.open = False
        self.jobs.clear()
        self._pools.remove(self)
