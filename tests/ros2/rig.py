"""The bridge with a played daemon, without a network: words for scenarios, with one goal of the tip."""

from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.ros2.wire.actions import Status
from hyperbit.controller.ros2.wire.cdr import message
from tests.ros2.world.inputs import ACTION, TIP, TYPES
from tests.ros2.world.network import Killed
from tests.ros2.world.world import World

UUID = bytes(range(16))
ID = f"ros2-{UUID.hex()}"
CANCEL = ("cancel", ID)


def pose_stamped(x: float, y: float, z: float = 0.0, **header: Any) -> Any:
    fields = {"header": header, "pose": {"position": {"x": x, "y": y, "z": z}}}
    return message(fields, "geometry_msgs/msg/PoseStamped", TYPES)


def trajectory_goal(joints: list[str], rows: list[list[float]], **fields: Any) -> Any:
    """A goal of FollowJointTrajectory, a point a second."""
    points = [{"positions": row, "time_from_start": {"sec": k}} for k, row in enumerate(rows)]
    given = {"joint_names": joints, "points": points, **fields.pop("trajectory", {})}
    return message({"trajectory": given, **fields}, f"{ACTION}_Goal", TYPES)


class Rig(World):
    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.turn()

    def send_goal(self, action: str = TIP, goal: Any = None, *, run: bool = True) -> bool:
        """Sends the goal; returns whether it was accepted."""
        given = goal or trajectory_goal(["tip_x", "tip_y"], [[0.4, 2.9]])
        replies = self.call(f"{action}/send_goal", run=run, goal_id={"uuid": UUID}, goal=given)
        return bool(replies and replies[0].accepted)

    def send_pose(self) -> None:
        self.call("goal_pose", header={"frame_id": "world"}, pose={"position": {"x": 0.4, "y": 2.9}}, run=False)

    def cancel(self, *, run: bool = False) -> bool:
        """Cancels the goal; returns whether its client was told so."""
        replies = self.call(f"{TIP}/cancel_goal", run=run, goal_info={"goal_id": {"uuid": UUID}})
        return bool(replies and replies[0].goals_canceling)

    def killed_in(self, act: Any) -> None:
        """Does something; the bridge is killed before it replies."""
        self.kill_at_reply = True
        with pytest.raises(Killed):
            act()
        self.kill_at_reply = False

    def get_result(self, action: str = TIP) -> list[Any]:
        """Asks for the result of the goal; returns the list that receives it."""
        return self.call(f"{action}/get_result", goal_id={"uuid": UUID})

    def result(self) -> tuple[Status, int, str]:
        """Returns status, code and sentence of the goal's result, which must be there."""
        (reply,) = self.get_result()
        return Status(reply.status), reply.result.error_code, reply.result.error_string

    def tell_end(self, status: str) -> None:
        """Ends the goal; the bridge hears of it."""
        self.hear("result", self.daemon.end(status))

    @property
    def status(self) -> Status:
        return self.judge.goals[TIP, UUID].status
