"""The readings of an arm: what end-stops and outputs tell about its actuators and interlocks."""

from hyperbit.controller.executor.arm.bits import merged
from hyperbit.controller.executor.arm.kinds import Ends, Kinds
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.motion.actuation import Actuation
from hyperbit.controller.program import pack
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.master import Master


class Readings:
    """What is known of the A actuators of an arm now; reads only.

    Args:
        master: CANopen master of the boards.
        kinds: outputs and end-stops of the actuators.
        actuation: the commanded states.
        locked: the locked actuators.
        actuators: number, A.
    """

    def __init__(
        self, master: Master, kinds: Kinds, actuation: Actuation, locked: LockedActuators, actuators: int
    ) -> None:
        self._master, self._kinds, self._actuation = master, kinds, actuation
        self._locked, self._actuators = locked, actuators

    @property
    def ends(self) -> Ends:
        """What the end-stops read."""
        return self._kinds.ends(self._master.ends)

    @property
    def read(self) -> int:
        """States that the end-stops tell, else the commanded ones; 0 where the board is not operational."""
        return self._kinds.measured(self.ends, self._actuation.states) & self._master.known

    @property
    def definite(self) -> int:
        """Mask of the actuators whose end-stops tell their state now."""
        return self._kinds.definite(self.ends) & self._master.known

    @property
    def measured(self) -> int:
        """As `read`, but the locked state for a locked actuator without an end-stop."""
        return merged(self._locked.mask & ~self._kinds.sensed, self._locked.states, self.read)

    @property
    def known(self) -> int:
        """Mask of the actuators whose measured state is known."""
        return self._master.known & ~self.homing

    @property
    def homing(self) -> int:
        """Mask of the actuators of unknown state, which the next program homes first."""
        return self._actuation.uncertain & ~self._locked.mask

    def packed(self) -> tuple[bytes, bytes]:
        """Returns the measured states and the mask of the known ones, packed."""
        return pack(self.measured & self.known, self._actuators), pack(self.known, self._actuators)

    def interlock_faults(self) -> list[ArmFault]:
        """Returns a fault for each open interlock."""
        opened = self._kinds.open(self._master.ends, self._master.inputs_known)
        places = (f"{lock.name} ({lock.bus}/{lock.node} input {lock.input})" for lock in opened)
        return [ArmFault("interlock", place, f"interlock {place} is open: close it, then reset") for place in places]
