"""The wire against other implementations of rmw_zenoh: pyzeros and zenoh-ros2-sdk, each in a process of its own."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.endpoints import Received
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from hyperbit.controller.ros2.wire.tokens import Kind
from tests.waiting import PATIENCE, eventually

PEERS = Path(__file__).with_name("peers")
JOINTS, TF, DIAGNOSTICS = "sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage", "diagnostic_msgs/msg/DiagnosticArray"
PACKAGES = ("pyzeros", "zenoh_ros2_sdk")
TOPICS = ("/joint_states", "/tf", "/diagnostics")


class Peer:
    """A process that tells what it receives in lines of JSON; its other lines are errors."""

    def __init__(self, package: str, endpoint: str) -> None:
        self.package, self.lines, self.errors = package, list[list[Any]](), list[str]()
        self.process = subprocess.Popen(
            [sys.executable, str(PEERS / f"with_{package}.py"), endpoint.rpartition(":")[2]],
            env={**os.environ, "CFLAGS": "-O0"},  # pyzeros compiles at its first use: 11 s instead of 27 s
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.thread = threading.Thread(target=self.read)
        self.thread.start()

    def read(self) -> None:
        assert self.process.stdout
        for line in self.process.stdout:
            if line.startswith('["'):
                self.lines.append(json.loads(line))
            else:
                self.errors.append(line)

    def said(self, name: str) -> list[list[Any]]:
        if self.process.poll() is not None:
            raise AssertionError(f"the peer has ended: {''.join(self.errors)}")
        return [line[1:] for line in self.lines if line[0] == name]

    def close(self) -> None:
        assert self.process.stdin
        self.process.stdin.close()
        try:
            self.process.wait(PATIENCE)
        finally:
            self.process.kill()
            self.thread.join()


def lacking(package: str) -> str | None:
    if importlib.util.find_spec(package) is None:
        return f"{package} is not installed: pip install -e '.[ros2-test]'"
    if package == "zenoh_ros2_sdk":
        return None if shutil.which("git") else f"{package} needs git when it is imported"
    headers = Path(sysconfig.get_path("include"), "Python.h")
    return (
        None if shutil.which("gcc") and headers.exists() else f"{package} needs gcc and {headers} at its first import"
    )


@pytest.fixture(params=PACKAGES)
def peer(request: pytest.FixtureRequest, router: Any) -> Iterator[Peer]:
    package = request.param
    if reason := lacking(package):
        pytest.skip(reason)
    peer = Peer(package, router.endpoint)
    yield peer
    peer.close()


def test_a_peer_receives_sends_and_calls(peer: Peer, router: Any) -> None:
    patience = 5 * PATIENCE  # pyzeros compiles at its first import
    with Session(router.endpoint, timeout=PATIENCE) as session:
        node = Node(session, "bridge", "/arm")
        publishers = [
            (node.publisher("/joint_states", JOINTS), {"name": ["j1", "j2"], "position": [0.5, -1.0]}),
            (node.publisher("/tf", TF, qos.TF), {"transforms": [{"child_frame_id": "tool"}]}),
            (
                node.publisher("/diagnostics", DIAGNOSTICS),
                {"status": [{"level": 2, "name": "arm", "values": [{"key": "mode", "value": "fault"}]}]},
            ),
        ]
        poses: list[Received] = []
        node.subscriber("/goal_pose", "geometry_msgs/msg/PoseStamped", poses.append)
        node.service("trigger", "std_srvs/srv/Trigger", lambda it: it.reply({"success": True, "message": "halted"}))

        def received_all() -> bool:
            for publisher, fields in publishers:
                publisher.publish(fields)
            return all(peer.said(topic) for topic in TOPICS)

        eventually(received_all, patience, lambda: f"{peer.lines[-3:]} {''.join(peer.errors)[-2000:]}", every=0.1)
        assert peer.said("/joint_states")[0] == [["j1", "j2"], [0.5, -1.0]]
        assert peer.said("/tf")[0] == ["tool", 1.0]
        assert peer.said("/diagnostics")[0] == [2, "fault"]
        eventually(lambda: poses, patience)
        assert poses[0].message.pose.position.x == 1.5
        assert len(poses[0].gid) == 16
        eventually(lambda: peer.said("trigger"), patience)
        assert peer.said("trigger") == [[True, "halted"]]

        if peer.package == "zenoh_ros2_sdk":  # pyzeros lists none
            eventually(lambda: peer.said("services"), patience)
            assert peer.said("topics")[0][0]["/joint_states"] == [JOINTS]
            assert peer.said("services")[0][0]["/arm/trigger"] == ["std_srvs/srv/Trigger"]

        theirs = [token for token in session.tokens() if token.node == "peer" and token.zid != session.zid]
        assert {token.namespace for token in theirs} == {"/other"}
        found = {(it.kind, *(it.endpoint[:3] if it.endpoint else ())) for it in theirs}
        assert (Kind.NODE,) in found
        for topic, name in zip(TOPICS, (JOINTS, TF, DIAGNOSTICS), strict=True):
            dds = name.replace("/msg/", "::msg::dds_::") + "_"
            assert (Kind.SUBSCRIBER, topic, dds, node.types.hash(name)) in found
        assert (Kind.PUBLISHER, "/goal_pose") in {it[:2] for it in found}
