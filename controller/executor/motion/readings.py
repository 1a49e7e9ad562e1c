"""Readings of end-stops and outputs: states of actuators and interlocks, and travel times."""

from hyperbit.controller.executor.arm.kinds import Ends, Kinds, indices, merged
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.motion.actuation import Actuation
from hyperbit.controller.program import Travel, pack
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.master import Master


class Readings:
    """The present knowledge of the A actuators of an arm; changes nothing."""

    def __init__(self, master: Master, kinds: Kinds, actuation: Actuation, locked: LockedActuators) -> None:
        self._master, self._inputs, self._kinds = master, master.inputs, kinds
        self._actuation, self._locked = actuation, locked
        self._actuators = len(kinds.travel)

    @property
    def ends(self) -> Ends:
        return self._kinds.ends(self._inputs.ends)

    @property
    def read(self) -> int:
        """States from the end-stops, otherwise the commanded ones; 0 where the board is not operational."""
        return self._kinds.measured(self.ends, self._actuation.states) & self._inputs.known

    @property
    def definite(self) -> int:
        return self._kinds.definite(self.ends) & self._inputs.known

    @property
    def measured(self) -> int:
        """As `read`, but the locked state for a locked actuator without an end-stop."""
        return merged(self._locked.mask & ~self._kinds.sensed, self._locked.states, self.read)

    @property
    def known(self) -> int:
        return self._inputs.known & ~self.homing

    @property
    def homing(self) -> int:
        """Mask of the actuators of unknown state, which the next program homes first."""
        return self._actuation.uncertain & ~self._locked.mask

    def packed(self) -> tuple[bytes, bytes]:
        known = self.known
        return pack(self.measured & known, self._actuators), pack(known, self._actuators)

    def interlock_faults(self) -> list[ArmFault]:
        opened = self._kinds.open(self._inputs.ends, self._inputs.up)
        faults = []
        for lock in opened:
            place, why = f"{lock.name} ({lock.place})", self._master.unanswered(lock)
            text = "is open: close it, then reset" if why is None else f"counts as open: {why}. Mend this, then reset"
            faults.append(ArmFault("interlock", place, f"interlock {place} {text}"))
        return faults


class TravelTimes:
    """Measures travel times from the SYNC that switched an actuator to the frame that reports its end-stop.

    Times are those of the frames on the bus, so that a late loop measures the same. A travel is not measured if its
    SYNC is not echoed, if its end-stop is read by SDO, or if the end-stop reads 1 from the beginning. `travelling` are
    the masks of the actuators with a measured travel to the contracted, and to the extended end.
    """

    def __init__(self) -> None:
        self.travelling = [0, 0]
        self._begun: dict[int, float] = {}

    def begin(self, mask: int, states: int, ends: Ends, at: float | None) -> None:
        """Records that actuators were switched to `states`, at a time on the bus [s]; None: unknown.

        `ends`: before the switch.
        """
        self.forget(mask)
        if at is None:
            return
        for k in indices(mask):
            self._begun[k] = at
        self.travelling[0] |= mask & ~states & ~ends.contracted
        self.travelling[1] |= mask & states & ~ends.extended

    def forget(self, mask: int) -> None:
        self.travelling = [going & ~mask for going in self.travelling]

    def drain_arrived(self, ends: Ends, at: float | None) -> list[Travel]:
        """Returns the travels ended since the last call, by a frame of the time `at` [s]; None: unknown."""
        arrived = self.travelling[0] & ends.contracted | self.travelling[1] & ends.extended
        if not arrived:
            return []
        extended = self.travelling[1]
        self.forget(arrived)
        if at is None:
            return []
        return [Travel(k, extended >> k & 1, max(at - self._begun[k], 0.0)) for k in indices(arrived)]
