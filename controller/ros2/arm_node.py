"""The arm as one ROS 2 node: its publishers, subscribers, services and two actions."""

import contextlib
import math
import re
from collections import Counter, deque
from collections.abc import Sequence
from operator import attrgetter
from typing import Any, NamedTuple

from hyperbit.controller.armfile.units import METRES_TAKEN, metres_of
from hyperbit.controller.manipulator.described import described, in_metres
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.goals import GoalEnd
from hyperbit.controller.messages.state import Diagnostics, SetpointStatus, State
from hyperbit.controller.network.client import Client
from hyperbit.controller.network.fault_changes import ActiveFaults
from hyperbit.controller.pictures.scene import FoxgloveScene, Shown, shown_of
from hyperbit.controller.ros2 import messages
from hyperbit.controller.ros2.goal_book import GoalBook
from hyperbit.controller.ros2.goals import ActionGoals, Kind
from hyperbit.controller.ros2.jobs import Jobs
from hyperbit.controller.ros2.messages import ERROR, INFO, WARN
from hyperbit.controller.ros2.poses import Fields, Place
from hyperbit.controller.ros2.requests import Requests
from hyperbit.controller.ros2.robot import urdf
from hyperbit.controller.ros2.trajectories import actuator_goal, tip_goal, tip_positions
from hyperbit.controller.ros2.wire import names, qos
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session

ROSOUT = qos.Qos(latched=True, depth=1000)
SAME = attrgetter("name", "unit", "frames", "base", "actuators", "dimension", "version")  # identify the node's arm
MOST_SAID = 20  # sentences on /rosout in a second
MOST_LETTERS = 1000  # of a sentence, which may quote a message from the network
ODD = re.compile(r"[^A-Za-z0-9_]")


class Settings(NamedTuple):
    """Settings of the node."""

    namespace: str  # absolute; "" is the arm's name
    domain: int  # ROS_DOMAIN_ID
    distro: str  # jazzy, kilted or lyrical
    world: str  # name of the world's frame
    oriented: bool  # whether `goal_pose` and `goal_path` set an orientation


class ArmNode:
    """The node of one arm. `arm` is the daemon's description, with its `drawing`.

    Raises LookupError, TypeError or ValueError if the description has another form, or a name is not allowed.
    """

    def __init__(self, session: Session, client: Client, arm: Description, book: GoalBook, settings: Settings) -> None:
        self._session, self._client, self._book, self._settings = session, client, book, settings
        self._arm, self._world = arm, settings.world
        self._manipulator = described(in_metres(arm))
        base, metres = self._manipulator.base, metres_of(arm.unit)
        self._place = Place(settings.world, arm.name, base, arm.dimension, metres)
        self._urdf = urdf(arm.name, settings.world, self._manipulator)
        self._node_name, self._namespace = node_name(arm.name, settings.namespace)
        names.check_node(self._node_name, self._namespace)
        self.name = f"{self._namespace.rstrip('/')}/{self._node_name}"
        self._state: State | None = None
        self._alive = True
        self._refused: int | None = None  # number of set-points that the daemon had refused at the last question
        self._faults = ActiveFaults()
        self._dropped: dict[str, Counter[str]] = {}
        self._said, self._unsaid = deque[float](maxlen=MOST_SAID), 0
        self._drawn: Shown | None = None
        self._scene = FoxgloveScene(arm)
        self._markers = messages.Markers(self._scene, arm.name, self._manipulator.length, self._world)

    def open(self) -> None:
        """Declares the node, publishes constant messages, accepts requests. A zenoh.ZError leaves nothing open."""
        settings = self._settings
        with contextlib.ExitStack() as undoing:
            self._node = Node(self._session, self._node_name, self._namespace, settings.domain, settings.distro)
            undoing.callback(self._node.close)
            self._declare_publishers()
            self._jobs = Jobs(self._session.computer, self.say)
            undoing.callback(self._jobs.close)
            kinds = {
                "tip": Kind(
                    "tip_controller/follow_joint_trajectory",
                    lambda goal: tip_goal(goal, self._place),
                    self._tip_feedback,
                ),
                "actuators": Kind(
                    "actuator_controller/follow_joint_trajectory", self._actuator_goal, self._actuator_feedback
                ),
            }
            self._goals = ActionGoals(self._node, kinds, self._book, self._client, self._jobs, self.say)
            self._requests = Requests(
                self._node, self._client, self._place, self._jobs, self._goals, self.say, oriented=settings.oriented
            )
            self._node.watch(lambda text: self.say(WARN, text))
            undoing.pop_all()
        self._robot.publish({"data": self._urdf})
        axes = ("tip_x", "tip_y", "tip_z")[: self._place.dimension]
        self.say(INFO, f"the arm {self._arm.name}: joints of the tip {', '.join(axes)}, tip_yaw")
        if self._arm.unit is None:
            self.say(WARN, METRES_TAKEN)

    def close(self) -> None:
        """Ends the node and aborts its goals, also a goal that is being accepted."""
        self._jobs.close()
        self._requests.close()
        self._goals.close()
        self._node.close()

    def describes(self, arm: Description) -> bool:
        return bool(SAME(arm) == SAME(self._arm))

    def receive_obstacles(self, arm: Description) -> None:
        self._scene, self._drawn = FoxgloveScene(arm), None
        self._markers.scene = self._scene

    def receive_alive(self, *, alive: bool) -> None:
        self._alive = alive
        self._goals.receive_alive(alive=alive)
        self.say(INFO if alive else ERROR, f"the daemon is {'there' if alive else 'gone'}")

    def receive_state(self, state: State) -> None:
        """Stores a state and logs new and past faults. Raises ValueError for a state of another arm."""
        count = len(self._manipulator.actuators)
        for name, states in (("measured", state.measured), ("commanded", state.commanded)):
            if states is not None and len(states) != count:
                raise ValueError(f"{name}: {len(states)} states of actuators, expected {count}")
        changes = self._faults.take(state)
        for (code, _), message in changes.came.items():
            self.say(ERROR if state.mode == "fault" else WARN, f"{code}: {message}")
        for code, source in changes.went:
            self.say(INFO, f"{code} at {source} is over")
        self._state = state

    def receive_result(self, result: GoalEnd) -> None:
        self._goals.receive_result(result)
        self._requests.receive_result(result)

    def publish_state(self, state: State) -> None:
        """Publishes joints, tip, frames and feedback of a state, and markers if they changed."""
        self._states.publish(messages.joint_state(state, self._manipulator.actuators))
        if (tip := messages.tip_pose(state, self._place)) is not None:
            self._tips.publish(tip)
        self._frames.publish({"transforms": messages.transforms(self._scene, state, self._world)[1:]})
        self._goals.publish_feedback(state)
        if (shown := shown_of(state)) != self._drawn:
            self._drawn = shown
            self._pictures.publish(self._markers.array(state))

    def publish_slowly(self, state: State, told: Diagnostics | None) -> None:
        """Publishes diagnostics, fixed frames and all markers; logs dropped messages."""
        self._drawn = None
        base = messages.transforms(self._scene, state, self._world)[0]
        last = f"{self._arm.name}/{len(self._manipulator.modules)}"
        tip = {
            "header": messages.header(state.stamp, last),
            "child_frame_id": f"{self._arm.name}/tip",
            "transform": {"translation": {}, "rotation": {"w": 1.0}},
        }
        self._fixed.publish({"transforms": [base, tip]})
        self.health.publish(messages.diagnostics(self._arm.name, state, told, alive=self._alive))
        self._tell_dropped()
        if told is not None and told.setpoint:
            self._tell_refused(told.setpoint)

    def _tell_dropped(self) -> None:
        dropped = self._node.dropped()
        for name, counts in dropped.items():
            for reason, count in (counts - self._dropped.get(name, Counter())).items():
                self.say(WARN, f"{count} messages on {name} were dropped: {reason}")
        self._dropped = dropped

    def _tell_refused(self, counts: SetpointStatus) -> None:
        """Logs how many set-points the daemon has refused. A set-point has no reply."""
        before, self._refused = self._refused, counts.refused
        if before is not None and counts.refused > before:
            last = f", the last because {counts.last_refusal}" if counts.last_refusal else ""
            self.say(WARN, f"{counts.refused - before} set-points are refused{last}")

    def poll(self, now: float) -> None:
        self._goals.poll(now)

    def say(self, level: int, text: str) -> None:
        """Logs a sentence on /rosout. Some sentences are left out in a flood of bad requests."""
        now = self._session.computer.monotonic()
        if len(self._said) == self._said.maxlen and now - self._said[0] < 1.0:
            self._unsaid += 1
            return
        self._said.append(now)
        text = text if len(text) <= MOST_LETTERS else f"{text[:MOST_LETTERS]}..."
        if self._unsaid:
            text, self._unsaid = f"{text} ({self._unsaid} sentences before were left out)", 0
        logger = self.name.strip("/").replace("/", ".")
        self._log.publish(messages.log(self._session.computer.time(), level, logger, text))

    def _declare_publishers(self) -> None:
        self._log = self._node.publisher("/rosout", "rcl_interfaces/msg/Log", ROSOUT)
        self._states = self._node.publisher("joint_states", "sensor_msgs/msg/JointState")
        self._tips = self._node.publisher("tip_pose", "geometry_msgs/msg/PoseStamped")
        self._frames = self._node.publisher("/tf", "tf2_msgs/msg/TFMessage", qos.TF)
        self._fixed = self._node.publisher("/tf_static", "tf2_msgs/msg/TFMessage", qos.TF_STATIC)
        self._pictures = self._node.publisher("visualization_marker_array", "visualization_msgs/msg/MarkerArray")
        self.health = self._node.publisher("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        self._robot = self._node.publisher("robot_description", "std_msgs/msg/String", qos.LATCHED)

    def _actuator_goal(self, goal: Any) -> Fields:
        measured = None if self._state is None else self._state.measured
        return actuator_goal(goal, self._manipulator, measured or [None] * len(self._manipulator.actuators))

    def _tip_feedback(self, state: State, joints: Sequence[str]) -> Fields:
        wanted, actual = (tip_positions(pose, joints, self._place) for pose in (state.target, state.tip))
        return feedback(state, joints, wanted, actual)

    def _actuator_feedback(self, state: State, joints: Sequence[str]) -> Fields:
        def of(states: Sequence[int | None] | None) -> list[float]:
            known = dict(zip(self._manipulator.actuators, states or (), strict=False))
            return [math.nan if known.get(name) is None else float(known[name]) for name in joints]  # type: ignore[arg-type]

        return feedback(state, joints, of(state.commanded), of(state.measured))


def node_name(arm: str, namespace: str) -> tuple[str, str]:
    """Returns the node's name and namespace. An underscore replaces each character that ROS 2 does not allow."""
    return "hyperbit", namespace or "/" + ODD.sub("_", arm)


def tell(session: Session, settings: Settings, node: str, text: str) -> None:
    """Logs an error on /rosout by a node that exists only for this message."""
    with Node(session, node, "/", settings.domain, settings.distro) as teller:
        publisher = teller.publisher("/rosout", "rcl_interfaces/msg/Log", ROSOUT)
        publisher.publish(messages.log(session.computer.time(), ERROR, node, text))


def feedback(state: State, joints: Sequence[str], wanted: list[float], actual: list[float]) -> Fields:
    """Returns a FollowJointTrajectory_Feedback: desired and actual positions, and their difference."""
    errors = [a - b for a, b in zip(wanted, actual, strict=True)]
    points = {"desired": wanted, "actual": actual, "error": errors}
    head = messages.header(state.stamp)
    return {"header": head, "joint_names": list(joints), **{name: {"positions": it} for name, it in points.items()}}
