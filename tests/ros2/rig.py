"""A router, an executor with simulated boards, a planner, and a bridge, each of which can be killed."""

import os
import re
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from tests.ros2.client import Client, Result, trajectory
from tests.ros2.wire.conftest import Router
from tests.system.stack import arms
from tests.waiting import eventually

ACTION = "control_msgs/action/FollowJointTrajectory"
ROSOUT = qos.Qos(durability=qos.Durability.TRANSIENT_LOCAL, depth=1000)
TIP = "flat/tip_controller/follow_joint_trajectory"
OF_TOPIC = re.compile(r"goal (ros2-goal_p\S+) (is accepted|is refused|\w+)")
PATIENCE = 300.0  # [s]; a busy machine starts a daemon slowly


class Rig:
    """The arm `flat` in a ROS 2 system.

    Attributes:
        router: in place of ROS 2's router; the daemon joins it as well.

    Args:
        travel_time: of the arm's actuators [s].
    """

    def __init__(self, folder: Path, closing: ExitStack, travel_time: float = 0.05) -> None:
        self.router, self._folder, self._closing = Router(), folder, closing
        closing.callback(lambda: self.router.stop())
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        closing.callback(self._end)
        fields = {"travel_time": travel_time, "inrush": 4}
        self._arm = arms.write(folder, "planar", "flat", {"channel": "can0"}, fields)
        self.session = Session(self.router.endpoint, PATIENCE)
        closing.callback(self.session.close)
        self.node = Node(self.session, "peer")
        self.said: list[str] = []
        self.node.subscriber("/rosout", "rcl_interfaces/msg/Log", lambda it: self.said.append(it.message.msg), ROSOUT)
        for name in ("executor", "planner", "bridge"):
            self.start(name)

    def start(self, name: str) -> None:
        boards = [str(self._arm), "--simulate", "--socket", str(self._folder / "executor.sock")]
        words = {
            "executor": ["execute", *boards],
            "planner": ["run", *boards, "--connect", self.router.endpoint],
            "bridge": ["ros2", "flat", "--connect", self.router.endpoint, "--ros", self.router.endpoint],
        }[name]
        environment = {**os.environ, "RUNTIME_DIRECTORY": str(self._folder), "STATE_DIRECTORY": str(self._folder)}
        with (self._folder / f"{name}.log").open("ab") as log:
            self._processes[name] = subprocess.Popen(
                [sys.executable, "-m", "hyperbit", *words],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=environment,
            )

    def kill(self, name: str) -> None:
        self._processes[name].kill()
        self._processes[name].wait()

    def log(self, name: str) -> str:
        return (self._folder / f"{name}.log").read_text()

    def hear(self, topic: str, type_name: str, quality: qos.Qos = qos.DEFAULT) -> list[Any]:
        heard: list[Any] = []
        self.node.subscriber(topic, type_name, lambda it: heard.append(it.message), quality)
        return heard

    def await_words(self, *words: str, since: int = 0) -> str:
        """Waits for a sentence on /rosout, from number `since`, that has these words."""

        def found() -> str:
            return next((it for it in self.said[since:] if all(word in it for word in words)), "")

        return eventually(found, PATIENCE, lambda: f"{words}: {self.said[-5:]}, {self.log('bridge')[-500:]}")

    def await_ready(self) -> None:
        states: list[Any] = []
        name = "diagnostic_msgs/msg/DiagnosticArray"
        subscriber = self.node.subscriber("/diagnostics", name, lambda it: states.append(it.message))
        eventually(
            lambda: states and states[-1].status[0].message.startswith("ready"),
            PATIENCE,
            lambda: f"{self.said}, {self.log('bridge')}, {self.log('planner')}",
        )
        subscriber.close()

    def await_end(self) -> None:
        """Waits until no goal of a topic runs; only the bridge's sentences tell these goals' ids."""

        def ended() -> bool:
            last = {match[1]: match[2] for it in self.said if (match := OF_TOPIC.match(it))}
            return "is accepted" not in last.values()

        eventually(ended, PATIENCE, lambda: str(self.said[-10:]))

    def client(self, action: str = TIP) -> Client:
        return Client(self.session.zenoh, action)

    def _end(self) -> None:
        for process in reversed(self._processes.values()):
            process.terminate()
        for process in self._processes.values():
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def begin(client: Client, goal: bytes, x: float, y: float) -> bool:
    """Sends a goal of the tip until a server answers; returns whether it was accepted."""
    fields = trajectory(["tip_x", "tip_y"], [[x, y]], 0.0)
    answer = eventually(lambda: client.send(goal, fields), PATIENCE, every=0.1)
    return answer[0]


def result_of(client: Client, goal: bytes) -> Result:
    """Asks for a result until one comes: a client whose server died asks again."""

    def asked() -> Result | None:
        found = client.get_result(goal)
        return found if found is not None and found.status != 0 else None

    return eventually(asked, PATIENCE, every=0.1)
