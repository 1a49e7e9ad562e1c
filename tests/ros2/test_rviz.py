"""The configuration for RViz names topics that the bridge has, with their types and qualities of service."""

from pathlib import Path
from typing import Any, cast

import yaml

from hyperbit.controller.network.client import Client
from hyperbit.controller.ros2.arm_node import ArmNode, Settings
from hyperbit.controller.ros2.goal_book import GoalBook
from hyperbit.controller.ros2.wire.qos import Durability, Reliability
from hyperbit.controller.ros2.wire.session import Session
from hyperbit.controller.ros2.wire.tokens import Kind, Token
from tests.keys import DEPLOY
from tests.ros2.samples import told
from tests.ros2.wire.conftest import Router
from tests.waiting import PATIENCE, eventually

TYPES = {
    "rviz_default_plugins/MarkerArray": "visualization_msgs::msg::dds_::MarkerArray_",
    "rviz_default_plugins/Pose": "geometry_msgs::msg::dds_::PoseStamped_",
    "rviz_default_plugins/SetGoal": "geometry_msgs::msg::dds_::PoseStamped_",
}


def test_rviz_is_configured_for_topics_of_the_bridge(tmp_path: Path) -> None:
    manager: dict[str, Any] = yaml.safe_load((DEPLOY / "planar16.rviz").read_text())["Visualization Manager"]
    wanted = [it for it in (*manager["Displays"], *manager["Tools"]) if "Topic" in it]
    assert [it["Class"] for it in wanted] == list(TYPES)
    assert manager["Global Options"]["Fixed Frame"] == "world"
    router = Router()
    settings = Settings("", 0, "jazzy", "world", oriented=False)
    with Session(router.endpoint, PATIENCE) as session:
        node = ArmNode(session, cast("Client", None), told(), GoalBook(tmp_path / "goals"), settings)
        node.open()

        def shown() -> list[Token]:
            found = [it for it in session.tokens() if it.endpoint]
            names = {it.endpoint.name for it in found if it.endpoint}
            return found if {it["Topic"]["Value"] for it in wanted} <= names else []

        tokens = eventually(shown, PATIENCE)
        node.close()
    router.stop()
    offered = {(it.kind, it.endpoint.name): it.endpoint for it in tokens if it.endpoint}
    for one in wanted:
        topic, tool = one["Topic"], one["Class"].endswith("SetGoal")
        endpoint = offered[Kind.SUBSCRIBER if tool else Kind.PUBLISHER, topic["Value"]]
        assert endpoint.type == TYPES[one["Class"]]
        assert endpoint.qos.reliability is Reliability.RELIABLE
        assert topic["Reliability Policy"] == "Reliable"
        assert endpoint.qos.durability is Durability.VOLATILE
        assert topic["Durability Policy"] == "Volatile"
