"""What stands in for the clock and the threads of the bridge."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from tests.ros2.fuzz.inputs import Input


class Clock:
    def __init__(self) -> None:
        self.now, self.epoch = 1_000.0, 1.7e9

    def monotonic(self) -> float:
        return self.now

    def time(self) -> float:
        return self.epoch + self.now

    def time_ns(self) -> int:
        return int(self.time() * 1e9)

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Killed(BaseException):
    """The bridge is killed in this moment."""


class Condition:
    """Stands in for threading.Condition in one thread: who waits lets other threads run.

    Args:
        let_run: runs the jobs of the threads that nothing holds up.
    """

    def __init__(self, let_run: Callable[[], None]) -> None:
        self._let_run = let_run

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    def notify_all(self) -> None:
        pass

    def wait_for(self, predicate: Callable[[], bool], timeout: float) -> bool:
        if timeout and not predicate():
            self._let_run()
        return predicate()


@dataclass(eq=False)
class Trial:
    """One message on a topic, and what followed: dropped, said, or the key of a request to the daemon."""

    input: Input
    outcomes: list[str] = field(default_factory=list)
    jobs: int = 0


class Pool:
    """Stands in for ThreadPoolExecutor: jobs run when the world says so."""

    def __init__(self, name: str, pools: "list[Pool]", present: Callable[[], Trial | None]) -> None:
        self.name, self._pools, self._present = name, pools, present
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
        while self.jobs and not cancel_futures:
            self.jobs.popleft()[0]()
        self.open = False
        self.jobs.clear()
        self._pools.remove(self)
