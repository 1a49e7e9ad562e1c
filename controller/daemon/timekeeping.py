"""The control loop's clock: when the next tick is due, and how well the last second's were kept."""

from controller.daemon.state import LoopStatus


class Timekeeper:
    """Ticks of one period; ticks that were missed are counted and left out, not made up."""

    def __init__(self, period: float) -> None:
        """Takes the period [s]."""
        self._period = period
        self._next = self._last = 0.0
        self._periods: list[float] = []
        self._works: list[float] = []
        self._overruns = 0

    def start(self, now: float) -> None:
        """Makes the first tick due now."""
        self._next = self._last = now

    def left(self, now: float) -> float:
        """Returns the time until the next tick [s], 0 if it is due."""
        return max(self._next - now, 0.0)

    def ticked(self, began: float, ended: float) -> None:
        """Notes a tick's begin and end, and sets the next."""
        self._periods.append(began - self._last)
        self._works.append(ended - began)
        self._last = began
        self._next += self._period
        if self._next < ended:
            missed = int((ended - self._next) / self._period) + 1
            self._overruns += missed
            self._next += missed * self._period

    def take(self) -> LoopStatus:
        """Returns the figures since the last call, and starts anew."""
        count = max(len(self._works), 1)
        status = LoopStatus(
            ticks=len(self._works),
            longest_period=max(self._periods, default=0.0),
            mean_work=sum(self._works) / count,
            longest_work=max(self._works, default=0.0),
            overruns=self._overruns,
        )
        self._periods.clear()
        self._works.clear()
        self._overruns = 0
        return status
