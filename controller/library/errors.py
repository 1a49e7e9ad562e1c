"""The exceptions of the library; all are subclasses of `Error`."""

from collections.abc import Sequence
from typing import Any

from hyperbit.controller.armfile.strict import fault_list


class Error(ValueError):
    """Base class of all exceptions that the library documents; each is a `ValueError`, too."""


class ArmError(Error):
    """An arm cannot be built from its file or from its modules.

    Attributes:
        faults: one sentence for each fault, with the path of the field.
        lines: line of the arm's file for each fault, None where unknown; empty if the arm was not read from a file.
    """

    def __init__(self, faults: Sequence[str], where: str = "", lines: Sequence[int | None] = ()) -> None:
        """Creates the exception; its message has one line for each fault. A text is one fault."""
        faults = [faults] if isinstance(faults, str) else faults
        self.faults, self.lines, self._where = tuple(faults), tuple(lines), where
        super().__init__(fault_list(where, self.faults, self.lines) if where else "\n".join(self.faults))

    def __reduce__(self) -> tuple[Any, ...]:
        """Returns how pickle builds the exception again, in another process."""
        return ArmError, (self.faults, self._where, self.lines)


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


class StudyError(Error):
    """A study of designs is wrong, or work cannot be shared with processes or a cluster. The message says why."""


class PictureError(Error):
    """A picture cannot be drawn: matplotlib is not installed, or the axes or the file do not suit."""


class ThreadError(Error):
    """A solver is used by two threads at the same time. Use one solver for each thread."""


class CalibrationError(Error):
    """The arm cannot be fitted to the measurements."""
