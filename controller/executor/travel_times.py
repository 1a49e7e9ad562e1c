"""Travel times of actuators, from the SYNC that switched an actuator to the frame that reports its end-stop."""

from controller.executor.bits import indices
from controller.executor.kinds import Ends
from controller.program import Travel


class TravelTimes:
    """Measures the way of each actuator to an end that has an end-stop.

    Times are those of the frames on the bus, not of their reading: a loop that is late measures the same. A way is not
    measured if its SYNC is not echoed, if its end-stop is read by SDO, or if the end-stop reads 1 from the beginning.
    """

    def __init__(self) -> None:
        self._ways = [0, 0]  # masks of the actuators on their way to contracted, to extended
        self._begun: dict[int, float] = {}

    @property
    def under_way(self) -> bool:
        """Whether a way is being measured."""
        return bool(self._ways[0] | self._ways[1])

    def begin(self, mask: int, states: int, ends: Ends, at: float | None) -> None:
        """Notes that actuators were switched.

        Args:
            mask: of the actuators.
            states: of all actuators.
            ends: what the end-stops read before.
            at: when the SYNC was on the bus [s]; None: unknown.
        """
        self.forget(mask)
        if at is None:
            return
        for k in indices(mask):
            self._begun[k] = at
        self._ways[0] |= mask & ~states & ~ends.contracted
        self._ways[1] |= mask & states & ~ends.extended

    def forget(self, mask: int) -> None:
        """Measures no way of the actuators of a mask; -1 is all."""
        self._ways = [way & ~mask for way in self._ways]

    def arrived(self, ends: Ends, at: float | None) -> list[Travel]:
        """Returns the ways that have ended.

        Args:
            ends: what the end-stops read.
            at: when the frame that reported them was on the bus [s]; None: unknown.
        """
        arrived = self._ways[0] & ends.contracted | self._ways[1] & ends.extended
        if not arrived:
            return []
        extended = self._ways[1]
        self.forget(arrived)
        if at is None:
            return []
        return [Travel(k, extended >> k & 1, max(at - self._begun[k], 0.0)) for k in indices(arrived)]
