"""ROS 2 itself, in a virtual environment of its own: reads messages, and runs the script with rclpy's action server.

python with_rclpy.py messages < [[type, hex], ...]     prints for each its hash, and the hex that rclpy writes
python with_rclpy.py robot < hex of std_msgs/String    prints name, root and joints that ROS 2's parser reads
python with_rclpy.py action                            prints what the script sees and expects
"""

import importlib
import json
import queue
import sys
import threading
from pathlib import Path

from script import ABORTED, CANCELED, REJECTED_ORDER, SUCCEEDED, UNCANCELABLE_ORDER, script

SHARE = Path(sys.prefix) / "share"
PATIENCE = 60.0


def hash_of(name):
    description = SHARE / f"{name}.json"
    if not description.exists():
        return None
    return {it["type_name"]: it["hash_string"] for it in json.loads(description.read_text())["type_hashes"]}[name]


def class_of(name):
    package, kind, last = name.split("/")
    module = importlib.import_module(f"{package}.{kind}")
    if kind == "msg":
        return getattr(module, last)
    service, _, part = last.rpartition("_")
    return getattr(getattr(module, service), part)


def messages():
    from rclpy.serialization import deserialize_message, serialize_message

    told = []
    for name, data in json.load(sys.stdin):
        message = deserialize_message(bytes.fromhex(data), class_of(name))
        told.append([hash_of(name), serialize_message(message).hex()])
    json.dump(told, sys.stdout)


def robot():
    from rclpy.serialization import deserialize_message
    from urdf_parser_py.urdf import URDF

    text = deserialize_message(bytes.fromhex(sys.stdin.read()), class_of("std_msgs/msg/String")).data
    read = URDF.from_xml_string(text.encode())
    joints = [[it.name, it.type, it.parent, it.child, it.origin.xyz, it.origin.rpy] for it in read.joints]
    json.dump([read.name, read.get_root(), joints], sys.stdout)


class Side:
    """The script's side of ROS 2: an action server, and a client of its three services and two topics."""

    def __init__(self):
        import rclpy
        from action_msgs.srv import CancelGoal
        from rclpy.action import ActionServer, CancelResponse, GoalResponse
        from rclpy.callback_groups import ReentrantCallbackGroup
        from rclpy.executors import MultiThreadedExecutor
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from test_msgs.action import Fibonacci

        rclpy.init()
        self.rclpy, self.type, self.cancel_type = rclpy, Fibonacci, CancelGoal
        self.ends, self.handles, self.heard, self.states = {}, {}, queue.Queue(), []
        self.changed = threading.Condition()
        node, group = rclpy.create_node("oracle"), ReentrantCallbackGroup()
        self.server = ActionServer(
            node,
            Fibonacci,
            "fibonacci",
            execute_callback=self.execute,
            goal_callback=lambda it: GoalResponse.REJECT if it.order == REJECTED_ORDER else GoalResponse.ACCEPT,
            cancel_callback=lambda it: (
                CancelResponse.REJECT if it.request.order == UNCANCELABLE_ORDER else CancelResponse.ACCEPT
            ),
            callback_group=group,
        )
        impl, base = Fibonacci.Impl, "/fibonacci/_action"
        self.clients = [
            node.create_client(service, f"{base}/{name}", callback_group=group)
            for service, name in (
                (impl.SendGoalService, "send_goal"),
                (impl.GetResultService, "get_result"),
                (impl.CancelGoalService, "cancel_goal"),
            )
        ]
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(impl.GoalStatusMessage, f"{base}/status", self.on_status, latched)
        node.create_subscription(impl.FeedbackMessage, f"{base}/feedback", self.heard.put, 10)
        executor = MultiThreadedExecutor(num_threads=8)
        executor.add_node(node)
        threading.Thread(target=executor.spin, daemon=True).start()
        for client in self.clients:
            assert client.wait_for_service(timeout_sec=PATIENCE)

    def execute(self, handle):
        number = int(handle.goal_id.uuid[0])
        self.handles[number] = handle
        how, sequence = self.ends.setdefault(number, queue.Queue()).get(timeout=PATIENCE)
        {SUCCEEDED: handle.succeed, CANCELED: handle.canceled, ABORTED: handle.abort}[how]()
        result = self.type.Result()
        result.sequence = sequence
        return result

    def on_status(self, message):
        with self.changed:
            self.states.append([[int(it.goal_info.goal_id.uuid[0]), it.status] for it in message.status_list])
            self.changed.notify_all()

    def ask(self, client, request):
        future = client.call_async(request)
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())

        def wait():
            assert done.wait(PATIENCE)
            return future.result()

        return wait

    def send_goal(self, uuid, order):
        request = self.type.Impl.SendGoalService.Request()
        request.goal_id.uuid, request.goal.order = uuid, order
        return self.ask(self.clients[0], request)().accepted

    def ask_result(self, uuid):
        request = self.type.Impl.GetResultService.Request()
        request.goal_id.uuid = uuid
        wait = self.ask(self.clients[1], request)

        def result():
            response = wait()
            return [response.status, list(response.result.sequence)]

        return result

    def cancel(self, uuid, sec):
        request = self.cancel_type.Request()
        request.goal_info.goal_id.uuid, request.goal_info.stamp.sec = uuid, sec
        response = self.ask(self.clients[2], request)()
        return [response.return_code, [int(it.goal_id.uuid[0]) for it in response.goals_canceling]]

    def end(self, uuid, how, sequence):
        self.ends.setdefault(uuid[0], queue.Queue()).put((how, sequence))

    def feedback(self, uuid, sequence):
        message = self.type.Feedback()
        message.sequence = sequence
        self.handles[uuid[0]].publish_feedback(message)
        heard = self.heard.get(timeout=PATIENCE)
        return [int(heard.goal_id.uuid[0]), list(heard.feedback.sequence)]

    def until(self, uuid, status):
        with self.changed:
            assert self.changed.wait_for(lambda: self.found(uuid, status), PATIENCE)
            return self.found(uuid, status)

    def found(self, uuid, status):
        return next((it for it in self.states if [uuid[0], status] in it), None)


def action():
    json.dump(script(Side()), sys.stdout)
    sys.stdout.flush()
    import os

    os._exit(0)  # threads of rclpy still spin


if __name__ == "__main__":
    {"messages": messages, "robot": robot, "action": action}[sys.argv[1]]()
