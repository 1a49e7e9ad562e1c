"""Files of arms."""

from pathlib import Path

from hyperbit.controller.arm import arm as config
from hyperbit.controller.arm.saving import CannotLock, fields_of, write_arm
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.library.errors import ArmError, LockError
from hyperbit.controller.manipulator.locked import LockedStates


def save_arm(arm: config.Arm, locked: LockedStates, path: Path) -> None:
    """Writes the file of an arm with locked states (A,).

    Raises:
        ArmError: the file cannot be written, or a table of the arm's file is gone.
        LockError: actuators are locked, and the arm maps none to boards.
    """
    try:
        write_arm(path, fields_of(arm, locked), f"{arm.settings.name}, written by hyperbit.")
    except CannotLock as error:
        raise LockError(str(error)) from None
    except InputFaults as error:
        raise ArmError(error.faults, str(path)) from None
    except OSError as error:
        raise ArmError([f"cannot be written: {error.strerror}"], str(path)) from None
