"""The example of the room's page runs."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hyperbit.controller.ros2.wire import node
from hyperbit.controller.ros2.wire.actions import Status
from hyperbit.controller.ros2.wire.endpoints import Received
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from tests.ros2.client import Client, Result, trajectory
from tests.waiting import PATIENCE, eventually

PAGE = Path(node.__file__).with_name("README.md")


def test_the_example_publishes_serves_and_executes(router: Any, connect: Callable[[], Session], capsys: Any) -> None:
    example = re.search(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert example
    peer, got = Node(connect(), "peer"), []
    peer.subscriber("/arm/joint_states", "sensor_msgs/msg/JointState", got.append)
    poses = peer.publisher("/goal_pose", "geometry_msgs/msg/PoseStamped")
    variables: dict[str, Any] = {}
    exec(example[1].replace("tcp/localhost:7447", router.endpoint), variables)
    try:
        received: list[Received] = eventually(lambda: (variables["states"].publish({"position": [0.5]}), got)[1])
        assert list(received[0].message.position) == [0.5]
        assert peer.client("/arm/halt", "std_srvs/srv/Trigger").call({}, PATIENCE).message.success
        client = Client(peer, "/arm/follow")
        goal, response = client.send_goal(trajectory(["joint1"], [[0.5], [1.0]]))
        assert response.accepted
        assert client.result(goal) == Result(Status.SUCCEEDED, 0, "there")
        printed = eventually(lambda: (poses.publish({"pose": {"position": {"x": 2.5}}}), capsys.readouterr().out)[1])
        assert "x=2.5" in printed
    finally:
        variables["session"].close()
