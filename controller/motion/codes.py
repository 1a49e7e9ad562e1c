"""Result codes of control_msgs/FollowJointTrajectory."""

SUCCESSFUL = 0
INVALID_GOAL = -1
OLD_HEADER_TIMESTAMP = -3
PATH_TOLERANCE_VIOLATED = -4
GOAL_TOLERANCE_VIOLATED = -5


class Refusal(ValueError):
    """A request that is not accepted; the text says why.

    Attributes:
        code: one of the codes above.
        goal: id of the goal, if it is known.
    """

    def __init__(self, code: int, message: str, goal: str | None = None) -> None:
        """Stores code and id with the message."""
        super().__init__(message)
        self.code, self.goal = code, goal
