"""A router, an executor with simulated boards, a planner, and a bridge, each of which can be killed."""

import tempfile
import time
import uuid
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.actions import CancelCode
from hyperbit.controller.ros2.wire.endpoints import NoReply
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from tests.network.played import Router
from tests.ros2.client import Client, Result
from tests.system.stack import arms
from tests.system.stack.processes import Process, commands
from tests.waiting import eventually

ROSOUT = qos.Qos(latched=True, depth=1000)
TIP, ACTUATORS = (f"/flat/{kind}_controller/follow_joint_trajectory" for kind in ("tip", "actuator"))
VICTIMS = {"bridge": ["bridge"], "planner": ["planner"], "executor": ["executor"], "daemon": ["executor", "planner"]}
PATIENCE = 300.0  # [s]; a busy machine starts a daemon slowly


class System:
    """The arm `flat` in a ROS 2 system. `router` is in place of ROS 2's; the daemon joins it as well.

    Attributes:
        said: sentences on /rosout.
    """

    def __init__(self, closing: ExitStack) -> None:
        self.router = Router(closing)
        self._folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="hb")))
        self._processes: dict[str, Process] = {}
        closing.callback(self._end)
        self._arm = arms.write(self._folder, "planar", "flat", {"channel": "can0"}, {"inrush": 4})
        self.session = Session(self.router.endpoint, PATIENCE)
        closing.callback(self.session.close)
        self.node = Node(self.session, "peer")
        self.said: list[str] = []
        self.node.subscriber("/rosout", "rcl_interfaces/msg/Log", lambda it: self.said.append(it.message.msg), ROSOUT)
        self.tip, self.actuators = Client(self.node, TIP), Client(self.node, ACTUATORS)
        for name in ("executor", "planner", "bridge"):
            self.start(name)

    def start(self, name: str) -> None:
        boards = [str(self._arm), "--simulate", "--socket", str(self._folder / "executor.sock")]
        words = {
            "executor": ["execute", *boards],
            "planner": ["run", *boards, "--connect", self.router.endpoint],
            "bridge": ["ros2", "flat", "--connect", self.router.endpoint, "--ros", self.router.endpoint],
        }[name]
        folders = {"RUNTIME_DIRECTORY": str(self._folder), "STATE_DIRECTORY": str(self._folder)}
        self._processes[name] = commands().start(words, self._folder / f"{name}.log", folders | {"NOTIFY_SOCKET": ""})

    def kill(self, victim: str) -> None:
        """Kills a process, or both of the daemon, or the router, and starts it again."""
        if victim == "router":
            self.router.end()
            time.sleep(0.3)
            self.router.start()
            return
        for name in VICTIMS[victim]:
            self._processes[name].kill()
        for name in VICTIMS[victim]:
            self.start(name)

    def log(self, name: str) -> str:
        return (self._folder / f"{name}.log").read_text()[-2000:]

    def hear(self, topic: str, type_name: str, quality: qos.Qos = qos.DEFAULT) -> list[Any]:
        heard: list[Any] = []
        self.node.subscriber(topic, type_name, lambda it: heard.append(it.message), quality)
        return heard

    def await_words(self, *words: str, since: int = 0) -> str:
        """Waits for a sentence on /rosout, from number `since`, that has these words."""

        def found() -> str:
            return next((it for it in self.said[since:] if all(word in it for word in words)), "")

        return eventually(found, PATIENCE, lambda: f"{words}: {self.said[-5:]}, {self.log('bridge')}")

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

    def begin(self, client: Client, goal: dict[str, Any]) -> tuple[bytes, bool]:
        """Sends a goal until a server answers; returns its id, and whether it was accepted."""
        identity = uuid.uuid4().bytes

        def sent() -> Any:
            try:
                return client.send_goal(goal, identity)
            except NoReply:
                return None

        return identity, bool(eventually(sent, PATIENCE)[1].accepted)

    def canceled(self, client: Client, goal: bytes) -> bool:
        """Asks for a cancel; returns whether it is accepted, now or before."""
        try:
            return client.cancel(goal)[0] in (CancelCode.NONE, CancelCode.TERMINATED)
        except NoReply:
            return False

    def result(self, client: Client, goal: bytes) -> Result:
        """Asks for a result until one comes: a client whose server died asks again."""
        found: Result = eventually(lambda: client.result(goal), PATIENCE, lambda: str(self.said[-5:]), every=0.1)  # type: ignore[assignment]
        return found

    def _end(self) -> None:
        for process in reversed(self._processes.values()):
            process.end()
