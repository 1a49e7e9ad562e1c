"""Parts that several messages have. Bounds hold for what is read: any Zenoh client may publish on a daemon's keys."""

from typing import Annotated, Any

from msgspec import Meta, Struct

Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
Count = Annotated[int, Meta(ge=-(2**53), le=2**53)]
Code = Annotated[int, Meta(ge=-(2**31), lt=2**31)]  # of FollowJointTrajectory
Stamp = Annotated[float, Meta(ge=0, lt=1e11)]  # [UNIX s]
Position = Annotated[list[Number], Meta(min_length=2, max_length=3)]
Orientation = Number | Annotated[list[Number], Meta(min_length=4, max_length=4)]  # [rad], or a quaternion x, y, z, w
Region = dict[str, Any]  # an obstacle, as in the arm's file


class Pose(Struct, frozen=True):
    """A pose of the tip; any orientation serves a target without one."""

    position: Position
    orientation: Orientation | None = None
