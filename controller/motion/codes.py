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
        goal: its id, where that is known.
    """

    def __init__(self, code: int, message: str, goal: str | None = None) -> None:
        """Keeps code and id beside the sentence."""
        super().__init__(message)
        self.code, self.goal = code, goal
