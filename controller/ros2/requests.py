"""Services and goal topics: requests of ROS 2 to the daemon, in threads that may wait for its answer."""

import itertools
import json
import math
import threading
from collections.abc import Callable
from typing import Any

import zenoh

from hyperbit.controller.messages.goals import Answer, GoalEnd, Plan
from hyperbit.controller.messages.parts import Pose
from hyperbit.controller.network.client import Client, Unanswered
from hyperbit.controller.ros2.answers import described, request, sentence
from hyperbit.controller.ros2.goal_book import BookedGoal
from hyperbit.controller.ros2.goals import ActionGoals
from hyperbit.controller.ros2.jobs import CANCEL, MOST_WAITING, STOP, Jobs, Order, Passage, Say, Task, Withdrawn
from hyperbit.controller.ros2.messages import INFO, WARN, header
from hyperbit.controller.ros2.poses import BadGoal, Fields, Place, check_stamp, seconds, waypoint
from hyperbit.controller.ros2.wire.endpoints import Received, Request
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Computer

LEAST_STEP = 0.1  # [s] between two poses of a path without times
MOST_POSES = 10_000
MOST_ENDINGS = 24  # stops, or cancels, that wait for an answer; the services let 64 requests be open
FAILED: Fields = {"success": False, "message": "the request failed, or too many wait; /rosout says which"}


class Ending:
    """The service `stop` or `cancel`. A request to the daemon follows each call; waiting calls share one."""

    def __init__(self, computer: Computer, key: str, order: Order, client: Client, say: Say) -> None:
        self._key, self._order, self._client = key, order, client
        self._task = Task(computer, key, self._run, say)
        self._lock, self._waiting, self._number = threading.Lock(), list[Request](), 0
        self.close = self._task.close

    def receive(self, asked: Request) -> None:
        with self._lock:
            self._number = self._order.arrive(self._key)
            waits = len(self._waiting) < MOST_ENDINGS
            if waits:
                self._waiting.append(asked)
        asks = self._task.ask()
        if not (waits and asks):
            why = f"a {self._key} is sent, but too many wait for its answer" if asks else "the bridge to ROS 2 ends"
            asked.reply({"success": False, "message": why})

    def _run(self) -> None:
        with self._lock:
            waiting, self._waiting, number = self._waiting, [], self._number
        fields = FAILED
        try:
            with self._order.sending(self._key, number):  # also without a request
                answer = request(self._client, self._key, sending=lambda: self._order.sending(self._key, number))
            fields = {"success": answer.accepted, "message": sentence(answer)}
        except Unanswered as error:
            fields = {"success": False, "message": str(error)}
        finally:
            for asked in waiting:
                asked.reply(fields)


class Requests:
    """The services `stop`, `cancel`, `reset` and `plan`, and the topics that the node hears.

    `goals` cancel goals of topics that the daemon may run. `oriented`: whether the orientation of goals counts.
    """

    def __init__(
        self, node: Node, client: Client, place: Place, jobs: Jobs, goals: ActionGoals, say: Say, *, oriented: bool
    ) -> None:
        self._client, self._place, self._jobs, self._goals, self._say = client, place, jobs, goals, say
        self._oriented, self._order, self._computer = oriented, jobs.order, node.session.computer
        self._sent: dict[str, None] = {}  # ids of goals from topics, the oldest first
        self._lock = threading.Lock()
        self._endings = [Ending(self._computer, key, self._order, client, say) for key in (STOP, CANCEL)]
        for key, ending in zip((STOP, CANCEL), self._endings, strict=True):
            node.service(key, "std_srvs/srv/Trigger", ending.receive)
        node.service("reset", "std_srvs/srv/Trigger", self._reset)
        node.service("plan", "nav_msgs/srv/GetPlan", self._plan)
        node.subscriber("goal_pose", "geometry_msgs/msg/PoseStamped", self._later("goal_pose", self._pose_goal))
        node.subscriber("goal_path", "nav_msgs/msg/Path", self._later("goal_path", self._path_goal))
        node.subscriber("setpoint", "geometry_msgs/msg/PoseStamped", self._setpoint)
        node.subscriber("measured_tip", "geometry_msgs/msg/PoseStamped", self._measured_tip)

    def close(self) -> None:
        """Sends waiting stops and cancels, and waits for their answers."""
        for ending in self._endings:
            ending.close()

    def receive_result(self, result: GoalEnd) -> None:
        if self._forget(result.id or ""):
            level = INFO if result.status == "succeeded" else WARN
            self._say(level, f"goal {result.id} {result.status}: {result.message}")

    def _remember(self, identity: str) -> None:
        """Notes a goal of a topic. Keeps only the latest, because results may get lost."""
        with self._lock:
            self._sent[identity] = None
            while len(self._sent) > MOST_WAITING:
                del self._sent[next(iter(self._sent))]

    def _forget(self, identity: str) -> bool:
        """Forgets a goal of a topic; returns whether it was noted."""
        with self._lock:
            return identity in self._sent and self._sent.pop(identity) is None

    def _answer(self, asked: Request, job: Callable[[], Fields], empty: Fields) -> None:
        """Replies with the job's result, or with `empty` if too many requests wait or the job fails."""

        def run() -> None:
            fields = empty
            try:
                fields = job()
            finally:
                asked.reply(fields)

        if not self._jobs.submit(run):
            self._say(WARN, f"a request is refused: {MOST_WAITING} wait already")
            asked.reply(empty)

    def _reset(self, asked: Request) -> None:
        passage = Passage(self._order, (STOP,))

        def run() -> Fields:
            try:
                answer = request(self._client, "reset", sending=passage)
            except (Unanswered, Withdrawn) as error:
                answer = Answer(accepted=False, message=str(error))
            return {"success": answer.accepted, "message": sentence(answer)}

        self._answer(asked, run, FAILED)

    def _plan(self, asked: Request) -> None:
        """Answers GetPlan: the tip now, and at each point of the plan."""
        message, head = asked.message, header(0.0, self._place.world)

        def run() -> Fields:
            try:
                goal: Fields = {"waypoints": [waypoint(message.goal, self._place, "goal", oriented=self._oriented)]}
                if math.isfinite(message.tolerance) and message.tolerance > 0:
                    goal["tolerance"] = {"position": float(message.tolerance) / self._place.metres}
                answer = request(self._client, "plan", goal)
            except (BadGoal, Unanswered) as error:
                answer = Answer(accepted=False, message=str(error))
            if not isinstance(answer, Plan):
                self._say(WARN, f"no plan: {sentence(answer)}")
                return {"plan": {"header": head}}
            poses = [
                {"header": head, "pose": self._place.pose(Pose(it.position, it.orientation))}
                for it in answer.waypoints
                if it.position
            ]
            return {"plan": {"header": head, "poses": poses}}

        self._answer(asked, run, {"plan": {"header": head}})

    def _later(self, name: str, convert: Callable[[Any], Fields]) -> Callable[[Received], None]:
        def send(message: Any, passage: Passage) -> None:
            booked = BookedGoal(self._computer.uuid().hex, name, (), self._computer.stamp(), client=False)
            self._remember(booked.id)
            try:
                self._goals.check_room()
                answer = request(self._client, "goal", {**convert(message), "id": booked.id}, passage)
            except (BadGoal, Unanswered, Withdrawn) as error:
                answer = Answer(accepted=False, message=str(error))
                if passage.sent:  # it may have arrived
                    self._goals.owe_cancel(booked)
            if not answer.accepted:
                self._forget(booked.id)
            verb, level = ("accepted", INFO) if answer.accepted else ("refused", WARN)
            self._say(level, f"goal {booked.id} is {verb}: {sentence(answer)}")

        def receive(received: Received) -> None:
            passage = Passage(self._order)
            if not self._jobs.submit(lambda: send(received.message, passage)):
                self._say(WARN, f"a message on {name} is dropped: {MOST_WAITING} requests wait already")

        return receive

    def _check_stamp(self, stamp: Any, where: str) -> None:
        check_stamp(seconds(stamp), where, self._computer.time())

    def _pose_goal(self, message: Any) -> Fields:
        self._check_stamp(message.header.stamp, "goal_pose")
        return {"waypoints": [waypoint(message, self._place, "goal_pose", oriented=self._oriented)]}

    def _path_goal(self, message: Any) -> Fields:
        """Returns the goal of a path. Without increasing stamps its poses get equal time steps."""
        if not 1 <= len(message.poses) <= MOST_POSES:
            raise BadGoal(f"goal_path.poses: {len(message.poses)}, expected 1 to {MOST_POSES}")
        self._place.frame(message.header.frame_id, "goal_path")
        self._check_stamp(message.header.stamp, "goal_path")
        stamps = [seconds(it.header.stamp) for it in message.poses]
        self._check_stamp(message.poses[0].header.stamp, "goal_path.poses[0]")
        timed = len(stamps) > 1 and all(a < b for a, b in itertools.pairwise(stamps))
        step = max(LEAST_STEP, 2 * described(self._client).travel_time)
        times = [it - stamps[0] for it in stamps] if timed else [k * step for k in range(len(stamps))]
        return {
            "waypoints": [
                {**waypoint(it, self._place, f"goal_path.poses[{k}]", oriented=self._oriented), "t": t}
                for k, (it, t) in enumerate(zip(message.poses, times, strict=True))
            ]
        }

    def _setpoint(self, received: Received) -> None:
        """Forwards a set-point; the daemon checks its stamp."""
        message = received.message
        try:
            point = waypoint(message, self._place, "setpoint", oriented=False)
        except BadGoal as error:
            self._say(WARN, f"a set-point is refused: {error}")
            return
        payload = {**point, "stamp": seconds(message.header.stamp)}
        try:
            with Passage(self._order, wait=0.0)():
                self._client.put("setpoint", json.dumps(payload).encode())
        except (zenoh.ZError, Withdrawn) as error:
            self._say(WARN, f"a set-point is not sent: {error}")

    def _measured_tip(self, received: Received) -> None:
        """Forwards the position of a measured tip, which moves nothing; a stamp of 0 counts as now."""
        message = received.message
        try:
            point = waypoint(message, self._place, "measured_tip", oriented=False)
            stamp = seconds(message.header.stamp) or self._computer.time()
            self._client.put("measured_tip", json.dumps({**point, "stamp": stamp}).encode())
        except (BadGoal, zenoh.ZError) as error:
            self._say(WARN, f"a measured tip is not sent: {error}")
