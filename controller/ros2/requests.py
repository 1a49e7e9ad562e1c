"""Services and goal topics: requests of ROS 2 to the daemon, in threads that may wait for its answer."""

import itertools
import json
import math
import threading
import uuid
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import msgspec
import zenoh

from controller.network.client import Client, Unanswered
from controller.ros2.answers import Answer, ArmAnswer, GoalResult, PlanAnswer, request
from controller.ros2.goals import Say
from controller.ros2.messages import INFO, WARN, header
from controller.ros2.poses import BadGoal, Fields, Place, check_stamp, pose, seconds, waypoint
from controller.ros2.wire.node import Node
from controller.ros2.wire.services import Request
from controller.ros2.wire.topics import Received

MOST_WAITING = 64  # requests that wait for the daemon
WORKERS = 4
LEAST_STEP = 0.1  # [s] between two poses of a path without times
MOST_POSES = 10_000
STOPPING = ("stop", "cancel")


class Requests:
    """The services `stop`, `cancel`, `reset` and `plan`, and the topics `goal_pose`, `goal_path` and `setpoint`.

    Args:
        node: the arm's node.
        client: of the daemon.
        place: where the arm stands.
        say: tells a sentence on /rosout.
        oriented: whether the orientation of goals counts.
    """

    def __init__(self, node: Node, client: Client, place: Place, say: Say, *, oriented: bool) -> None:
        self._client, self._place, self._say, self._oriented = client, place, say, oriented
        self._pool = ThreadPoolExecutor(WORKERS, "ros2")
        self._stops = ThreadPoolExecutor(1, "ros2-stop")  # a stop waits for no plan
        self._free = threading.BoundedSemaphore(MOST_WAITING)
        self._sent: dict[str, None] = {}  # ids of goals from topics, the oldest first
        self._lock = threading.Lock()
        for key in ("stop", "reset", "cancel"):
            node.service(key, "std_srvs/srv/Trigger", self._trigger(key))
        node.service("plan", "nav_msgs/srv/GetPlan", self._plan)
        node.subscriber("goal_pose", "geometry_msgs/msg/PoseStamped", self._later("goal_pose", self._pose_goal))
        node.subscriber("goal_path", "nav_msgs/msg/Path", self._later("goal_path", self._path_goal))
        node.subscriber("setpoint", "geometry_msgs/msg/PoseStamped", self._setpoint)

    def close(self) -> None:
        """Waits for the requests that are under way."""
        for pool in (self._stops, self._pool):
            pool.shutdown(cancel_futures=True)

    def submit(self, job: Callable[[], None], pool: ThreadPoolExecutor | None = None) -> bool:
        """Runs a job in a thread; returns False if too many wait."""
        if not self._free.acquire(blocking=False):
            return False

        def run() -> None:
            try:
                job()
            except Exception as error:  # one request harms no other
                self._say(WARN, f"a request failed: {error!r}")
            finally:
                self._free.release()

        try:
            (pool or self._pool).submit(run)
        except RuntimeError:  # the bridge ends
            self._free.release()
            return False
        return True

    def receive_result(self, result: GoalResult) -> None:
        """Tells how a goal of a topic ended."""
        if self._forget(result.id):
            level = INFO if result.status == "succeeded" else WARN
            self._say(level, f"goal {result.id} {result.status}: {result.message}")

    def _remember(self, identity: str) -> None:
        """Notes a goal of a topic; results may get lost, so that only the latest goals are kept."""
        with self._lock:
            self._sent[identity] = None
            while len(self._sent) > MOST_WAITING:
                del self._sent[next(iter(self._sent))]

    def _forget(self, identity: str) -> bool:
        """Returns whether a goal of a topic was noted, and forgets it."""
        with self._lock:
            return identity in self._sent and self._sent.pop(identity) is None

    def _answer(self, asked: Request, job: Callable[[], Fields], empty: Fields, pool: ThreadPoolExecutor) -> None:
        """Replies with what a job returns; with `empty` if too many requests wait, or if the job fails."""

        def run() -> None:
            fields = empty
            try:
                fields = job()
            finally:
                asked.reply(fields)

        if not self.submit(run, pool):
            self._say(WARN, f"a request is refused: {MOST_WAITING} wait already")
            asked.reply(empty)

    def _trigger(self, key: str) -> Callable[[Request], None]:
        """Returns the handler of a Trigger service."""
        pool = self._stops if key in STOPPING else self._pool

        def run() -> Fields:
            try:
                answer = request(self._client, Answer, key)
            except Unanswered as error:
                return {"success": False, "message": str(error)}
            return {"success": answer.accepted, "message": answer.text}

        failed: Fields = {"success": False, "message": "the request failed, or too many wait; /rosout says which"}
        return lambda asked: self._answer(asked, run, failed, pool)

    def _plan(self, asked: Request) -> None:
        """Answers GetPlan: the tip now, and at each point of the plan."""
        message, head = asked.message, header(0.0, self._place.world)

        def run() -> Fields:
            try:
                goal: Fields = {"waypoints": [waypoint(message.goal, self._place, "goal", oriented=self._oriented)]}
                if math.isfinite(message.tolerance) and message.tolerance > 0:
                    goal["tolerance"] = {"position": float(message.tolerance)}
                answer = request(self._client, PlanAnswer, "plan", goal)
            except (BadGoal, Unanswered) as error:
                answer = PlanAnswer(accepted=False, message=str(error))
            if not answer.accepted:
                self._say(WARN, f"no plan: {answer.text}")
                return {"plan": {"header": head}}
            poses = [{"header": head, "pose": pose(msgspec.structs.asdict(it))} for it in answer.waypoints]
            return {"plan": {"header": head, "poses": poses}}

        self._answer(asked, run, {"plan": {"header": head}}, self._pool)

    def _later(self, name: str, convert: Callable[[Any], Fields]) -> Callable[[Received], None]:
        """Returns the callback of a topic of goals."""

        def send(message: Any) -> None:
            identity = f"ros2-{name}-{uuid.uuid4().hex[:8]}"
            self._remember(identity)
            try:
                answer = request(self._client, Answer, "goal", {**convert(message), "id": identity})
            except (BadGoal, Unanswered) as error:
                answer = Answer(accepted=False, message=str(error))
            if not answer.accepted:
                self._forget(identity)
            verb, level = ("accepted", INFO) if answer.accepted else ("refused", WARN)
            self._say(level, f"goal {identity} is {verb}: {answer.text}")

        def receive(received: Received) -> None:
            if not self.submit(lambda: send(received.message)):
                self._say(WARN, f"a message on {name} is dropped: {MOST_WAITING} requests wait already")

        return receive

    def _pose_goal(self, message: Any) -> Fields:
        check_stamp(seconds(message.header.stamp), "goal_pose")
        return {"waypoints": [waypoint(message, self._place, "goal_pose", oriented=self._oriented)]}

    def _path_goal(self, message: Any) -> Fields:
        """Returns the goal of a path; without increasing stamps its poses follow each other in equal steps."""
        if not 1 <= len(message.poses) <= MOST_POSES:
            raise BadGoal(f"goal_path.poses: {len(message.poses)}, expected 1 to {MOST_POSES}")
        self._place.frame(message.header.frame_id, "goal_path")
        check_stamp(seconds(message.header.stamp), "goal_path")
        stamps = [seconds(it.header.stamp) for it in message.poses]
        check_stamp(stamps[0], "goal_path.poses[0]")
        timed = len(stamps) > 1 and all(a < b for a, b in itertools.pairwise(stamps))
        step = max(LEAST_STEP, 2 * request(self._client, ArmAnswer, "arm").travel_time)
        times = [it - stamps[0] for it in stamps] if timed else [k * step for k in range(len(stamps))]
        return {
            "waypoints": [
                {**waypoint(it, self._place, f"goal_path.poses[{k}]", oriented=self._oriented), "t": t}
                for k, (it, t) in enumerate(zip(message.poses, times, strict=True))
            ]
        }

    def _setpoint(self, received: Received) -> None:
        """Sends a set-point on; the daemon judges its stamp."""
        message = received.message
        try:
            point = waypoint(message, self._place, "setpoint", oriented=False)
        except BadGoal as error:
            self._say(WARN, f"a set-point is refused: {error}")
            return
        payload = {**point, "stamp": seconds(message.header.stamp)}
        try:
            self._client.put("setpoint", json.dumps(payload).encode())
        except zenoh.ZError as error:
            self._say(WARN, f"a set-point is not sent: {error}")
