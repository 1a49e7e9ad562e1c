"""A ROS 2 node by zenoh-ros2-sdk: prints what it receives as lines of JSON, until its standard input ends.

    python with_zenoh_ros2_sdk.py PORT

The SDK clones definitions from the network unless it is given them, so they are taken from rosbags. It computes hashes
of messages itself. That of the service is given, because it refuses to compute it for an empty request.
"""

import json
import os
import sys
import threading
from typing import Any

os.environ["ZENOH_CONFIG_OVERRIDE"] = 'mode="client"'

from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2Subscriber
from zenoh_ros2_sdk.discovery import get_service_names_and_types, get_topic_names_and_types
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.utils import get_type_hash

SPEAKING = threading.Lock()
STORE = get_typestore(Stores.ROS2_JAZZY)
TRIGGER = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"


def tell(name: str, *values: Any) -> None:
    with SPEAKING:  # callbacks come in several threads
        print(json.dumps([name, *values]), flush=True)


def known(port: int, name: str) -> dict[str, str]:
    """Registers a type with all that it refers to; returns its definition and its hash as the SDK's arguments."""
    nested: dict[str, tuple[str, str]] = {}
    text, _ = STORE.gendefhash(name, nested, 2)
    session = ZenohSession.get_instance("127.0.0.1", port)
    texts = {it: found for it, (found, _) in nested.items()}
    for it, found in texts.items():
        session.register_message_type(found, it)
    return {"msg_type": name, "msg_definition": text, "type_hash": get_type_hash(name, text, texts)}


def call(port: int) -> None:
    client = ROS2ServiceClient(
        service_name="/arm/trigger",
        srv_type="std_srvs/srv/Trigger",
        request_definition="uint8 structure_needs_at_least_one_member\n",
        response_definition="bool success\nstring message\n",
        type_hash=TRIGGER,
        node_name="peer",
        namespace="/other",
        router_port=port,
    )
    response: Any = client.call(structure_needs_at_least_one_member=0)
    tell("trigger", response.success, response.message)


def main(port: int) -> None:
    common: dict[str, Any] = {"router_port": port, "node_name": "peer", "namespace": "/other"}
    reports = (
        ("/joint_states", "sensor_msgs/msg/JointState", lambda it: (list(it.name), it.position.tolist())),
        (
            "/tf",
            "tf2_msgs/msg/TFMessage",
            lambda it: (it.transforms[0].child_frame_id, it.transforms[0].transform.rotation.w),
        ),
        (
            "/diagnostics",
            "diagnostic_msgs/msg/DiagnosticArray",
            lambda it: (it.status[0].level, it.status[0].values[0].value),
        ),
    )
    for topic, name, values in reports:
        report = lambda it, topic=topic, values=values: tell(topic, *values(it))  # noqa: E731
        ROS2Subscriber(topic=topic, callback=report, **known(port, name), **common)
    arguments = known(port, "geometry_msgs/msg/PoseStamped")
    publisher = ROS2Publisher(topic="/goal_pose", **arguments, **common)
    types = publisher.session_mgr.store.types
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    pose, point = types["geometry_msgs/msg/Pose"], types["geometry_msgs/msg/Point"]
    position = pose(position=point(x=1.5, y=0.0, z=0.0), orientation=types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1))
    ended = threading.Event()

    def talk() -> None:
        while not ended.wait(0.1):
            publisher.publish(header=header(stamp=time(sec=0, nanosec=0), frame_id="zenoh-ros2-sdk"), pose=position)

    talking = threading.Thread(target=talk)
    talking.start()
    call(port)
    tell("topics", dict(get_topic_names_and_types(0, router_port=port, timeout=5.0)))
    tell("services", dict(get_service_names_and_types(0, router_port=port, timeout=5.0)))
    sys.stdin.read()
    ended.set()
    talking.join()
    publisher.session_mgr.session.close()


if __name__ == "__main__":
    main(int(sys.argv[1]))
