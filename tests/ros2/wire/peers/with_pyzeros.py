"""A ROS 2 node by pyzeros: prints what it receives as lines of JSON, until its standard input ends.

python with_pyzeros.py PORT
"""

import asyncio
import contextlib
import json
import sys
from dataclasses import dataclass, field
from typing import Any

import pyzeros
import zenoh
from ros2_pyterfaces.cyclone.diagnostic_msgs.msg import DiagnosticArray
from ros2_pyterfaces.cyclone.geometry_msgs.msg import PoseStamped, TransformStamped
from ros2_pyterfaces.cyclone.idl import IdlStruct, types
from ros2_pyterfaces.cyclone.sensor_msgs.msg import JointState
from ros2_pyterfaces.cyclone.std_srvs.srv import Trigger


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs/msg/TFMessage"):
    transforms: types.sequence[TransformStamped] = field(default_factory=list)


def tell(name: str, *values: Any) -> None:
    print(json.dumps([name, *values]), flush=True)


async def listen(subscriber: Any, report: Any) -> None:
    async for message in subscriber.listen_reliable():
        report(message)


async def talk(node: Any) -> None:
    publisher = node.create_publisher(PoseStamped, "/goal_pose")
    while True:
        pose = PoseStamped()
        pose.header.frame_id, pose.pose.position.x = "pyzeros", 1.5
        publisher.publish(pose)
        await asyncio.sleep(0.1)


async def call(node: Any) -> None:
    client = node.create_client(Trigger, "/arm/trigger")
    await client.wait_for_service()
    response = await client.call_async(Trigger.Request())
    tell("trigger", response.success, response.message)


async def main(port: str) -> None:
    settings = {"mode": "client", "connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}
    session = zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
    with pyzeros.auto_context(node="peer", zenoh_session=session, namespace="/other", domain_id=0) as node:
        reports = (
            ("/joint_states", JointState, lambda it: (list(it.name), list(it.position))),
            ("/tf", TFMessage, lambda it: (it.transforms[0].child_frame_id, it.transforms[0].transform.rotation.w)),
            ("/diagnostics", DiagnosticArray, lambda it: (it.status[0].level, it.status[0].values[0].value)),
        )
        tasks = []
        for topic, message_type, values in reports:
            subscriber = node.create_subscriber(message_type, topic)
            report = lambda it, topic=topic, values=values: tell(topic, *values(it))  # noqa: E731
            tasks.append(asyncio.create_task(listen(subscriber, report)))
        tasks += [asyncio.create_task(talk(node)), asyncio.create_task(call(node))]
        await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
        for task in tasks:
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(*tasks)
    session.close()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
