"""The exceptions of the library; all are subclasses of `Error`."""

from collections.abc import Sequence


class Error(Exception):
    """Base class of all exceptions that the library documents."""


class ArmError(Error):
    """An arm cannot be built from its file or from its modules.

    Attributes:
        faults: one sentence for each fault, with the path of the field.
    """

    def __init__(self, faults: Sequence[str], where: str = "") -> None:
        """Creates the exception; its message has one line for each fault."""
        self.faults = tuple(faults)
        super().__init__("\n".join(f"{where}: {fault}" if where else fault for fault in self.faults))


class ConfigurationError(Error):
    """An array or a text is no configuration of the arm, or a locked actuator is in another state."""


class LockError(Error):
    """An actuator is unknown, or cannot be locked in this state."""


class ObstacleError(Error):
    """An obstacle is invalid, or has another dimension than the arm."""


class GoalError(Error):
    """A goal is invalid, or has another dimension than the arm."""


class PathError(Error):
    """No path was found: a goal is out of reach, or an obstacle blocks it. The message has the goal's number."""


class CalibrationError(Error):
    """The arm cannot be fitted to the measurements."""
