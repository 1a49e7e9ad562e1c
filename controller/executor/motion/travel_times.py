"""Travel times of actuators, from the SYNC that switched an actuator to the frame that reports its end-stop."""

from hyperbit.controller.executor.arm.bits import indices
from hyperbit.controller.executor.arm.kinds import Ends
from hyperbit.controller.program import Travel


class TravelTimes:
    """Measures the travel time of each actuator to an end with an end-stop.

    Times are those of the frames on the bus, so that a late loop measures the same. A travel is not measured if its
    SYNC is not echoed, if its end-stop is read by SDO, or if the end-stop reads 1 from the beginning.
    """

    def __init__(self) -> None:
        self._travelling = [0, 0]  # masks of the actuators that travel to contracted, to extended
        self._begun: dict[int, float] = {}

    @property
    def measuring(self) -> bool:
        """Whether a travel is being measured."""
        return bool(self._travelling[0] | self._travelling[1])

    def begin(self, mask: int, states: int, ends: Ends, at: float | None) -> None:
        """Records that actuators were switched.

        Args:
            mask: of the actuators.
            states: of all actuators.
            ends: end-stops before the switch.
            at: time of the SYNC on the bus [s]; None: unknown.
        """
        self.forget(mask)
        if at is None:
            return
        for k in indices(mask):
            self._begun[k] = at
        self._travelling[0] |= mask & ~states & ~ends.contracted
        self._travelling[1] |= mask & states & ~ends.extended

    def forget(self, mask: int) -> None:
        """Stops to measure the travels of the actuators of a mask; -1 is all."""
        self._travelling = [going & ~mask for going in self._travelling]

    def drain_arrived(self, ends: Ends, at: float | None) -> list[Travel]:
        """Returns the travels that have ended since the last call.

        Args:
            ends: the end-stops now.
            at: time on the bus of the frame that reported them [s]; None: unknown.
        """
        arrived = self._travelling[0] & ends.contracted | self._travelling[1] & ends.extended
        if not arrived:
            return []
        extended = self._travelling[1]
        self.forget(arrived)
        if at is None:
            return []
        return [Travel(k, extended >> k & 1, max(at - self._begun[k], 0.0)) for k in indices(arrived)]
