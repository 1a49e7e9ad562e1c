"""The clock of the event loop: when the next tick is due, and how late the ticks of the last second were."""


class Timekeeper:
    """Ticks at a fixed phase; missed ticks are counted and left out.

    Args:
        period: between two ticks [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._next = self._last = 0.0
        self._late: list[float] = []
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
        """Notes begin and end of a tick, and sets the next."""
        self._late.append(began - self._next)
        self._periods.append(began - self._last)
        self._works.append(ended - began)
        self._last = began
        self._next += self._period
        if self._next < ended:
            missed = int((ended - self._next) / self._period) + 1
            self._overruns += missed
            self._next += missed * self._period

    def take(self) -> dict[str, float]:
        """Returns the figures since the last call [s], and starts anew: see `Diagnostics.loop`."""
        count = max(len(self._works), 1)
        late = sorted(self._late)
        status = {
            "ticks": len(self._works),
            "longest_period": max(self._periods, default=0.0),
            "mean_work": sum(self._works) / count,
            "longest_work": max(self._works, default=0.0),
            "overruns": self._overruns,
            "late_p50": late[len(late) // 2] if late else 0.0,
            "late_p99": late[len(late) * 99 // 100] if late else 0.0,
            "late_worst": late[-1] if late else 0.0,
        }
        for figures in (self._late, self._periods, self._works):
            figures.clear()
        self._overruns = 0
        return status
