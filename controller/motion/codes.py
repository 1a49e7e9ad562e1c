"""Result codes of control_msgs/FollowJointTrajectory."""

SUCCESSFUL = 0
INVALID_GOAL = -1
OLD_HEADER_TIMESTAMP = -3
PATH_TOLERANCE_VIOLATED = -4
GOAL_TOLERANCE_VIOLATED = -5


class Refusal(ValueError):
    """A goal that is not accepted.

    Attributes:
        code: one of the codes above.
    """

    def __init__(self, code: int, message: str) -> None:
        """Keeps the code beside the sentence."""
        super().__init__(message)
        self.code = code
