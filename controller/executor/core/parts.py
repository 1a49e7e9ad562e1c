"""The parts of the executor that requests and the end of the executor work with."""

from collections.abc import Callable
from typing import NamedTuple

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.core.events import Action
from hyperbit.controller.executor.core.modes import Modes
from hyperbit.controller.executor.motion.motion import ArmMotion


class ExecutorParts(NamedTuple):
    """Parts of the executor.

    Attributes:
        arm: the arm.
        motion: switches and supervises the actuators.
        locked: the locked actuators.
        modes: of the executor.
        act: takes actions.
    """

    arm: ExecutedArm
    motion: ArmMotion
    locked: LockedActuators
    modes: Modes
    act: Callable[[Action], None]
