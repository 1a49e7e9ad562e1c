"""The errors of the library: all are `Error`."""

from collections.abc import Sequence


class Error(Exception):
    """Base of every error that the library raises on purpose."""


class ArmError(Error):
    """An arm cannot be built from its file, or from the modules given.

    Attributes:
        faults: one sentence for each fault, with the path of the field.
    """

    def __init__(self, faults: Sequence[str], where: str = "") -> None:
        """Keeps the faults; the message is one line for each."""
        self.faults = tuple(faults)
        super().__init__("\n".join(f"{where}: {fault}" if where else fault for fault in self.faults))


class ConfigurationError(Error):
    """An array or a text is no configuration of the arm, or contradicts its locked actuators."""


class LockError(Error):
    """An actuator is unknown, or cannot be locked in the state given."""


class ObstacleError(Error):
    """An obstacle is not valid, or does not suit the dimension of the arm."""


class GoalError(Error):
    """A goal is not valid, or does not suit the dimension of the arm."""


class PathError(Error):
    """No path was found: a goal is out of reach, or something is in the way. The message has the goal's number."""


class CalibrationError(Error):
    """The arm cannot be fitted to the measurements."""
