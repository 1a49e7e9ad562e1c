"""Services and goal topics: requests of ROS 2 to the daemon, in threads that may wait for its answer."""

import itertools
import json
import threading
import uuid
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from controller.network.client import Client, Unanswered
from controller.ros2.goals import TIMEOUT, Say, told
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
        self._sent: set[str] = set()  # ids of goals from topics
        for key in ("stop", "reset", "cancel"):
            node.service(key, "std_srvs/srv/Trigger", self._trigger(key))
        node.service("plan", "nav_msgs/srv/GetPlan", lambda request: self._queue(lambda: self._plan(request), "plan"))
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

    def receive_result(self, message: Mapping[str, Any]) -> None:
        """Tells how a goal of a topic ended."""
        if (name := message.get("id")) in self._sent:
            self._sent.discard(str(name))
            level = INFO if message.get("status") == "succeeded" else WARN
            self._say(level, f"goal {name} {message.get('status')}: {message.get('message')}")

    def _queue(self, job: Callable[[], None], name: str) -> None:
        if not self.submit(job):
            self._say(WARN, f"a request on {name} is dropped: {MOST_WAITING} wait already")

    def _trigger(self, key: str) -> Callable[[Request], None]:
        """Returns the handler of a Trigger service."""

        def run(request: Request) -> None:
            try:
                answer = self._client.request(key, timeout=TIMEOUT)
            except Unanswered as error:
                answer = {"accepted": False, "message": str(error)}
            request.reply({"success": answer["accepted"], "message": told(answer)})

        def handle(request: Request) -> None:
            if not self.submit(lambda: run(request), self._stops if key in STOPPING else None):
                request.reply({"success": False, "message": f"{MOST_WAITING} requests wait already"})

        return handle

    def _plan(self, request: Request) -> None:
        """Answers GetPlan: the tip now, and at each point of the plan."""
        empty: Fields = {"plan": {"header": header(0.0, self._place.world)}}
        message = request.message
        try:
            goal: Fields = {"waypoints": [waypoint(message.goal, self._place, "goal", oriented=self._oriented)]}
            if message.tolerance > 0:
                goal["tolerance"] = {"position": float(message.tolerance)}
            answer = self._client.request("plan", goal, TIMEOUT)
        except (BadGoal, Unanswered) as error:
            answer = {"accepted": False, "message": str(error)}
        if not answer["accepted"]:
            self._say(WARN, f"no plan: {told(answer)}")
            request.reply(empty)
            return
        head = header(0.0, self._place.world)
        poses = [{"header": head, "pose": pose(it)} for it in answer["waypoints"]]
        request.reply({"plan": {"header": head, "poses": poses}})

    def _later(self, name: str, convert: Callable[[Any], Fields]) -> Callable[[Received], None]:
        """Returns the callback of a topic of goals."""

        def send(message: Any) -> None:
            identity = f"ros2-{name}-{uuid.uuid4().hex[:8]}"
            self._sent.add(identity)
            try:
                answer = self._client.request("goal", {**convert(message), "id": identity}, TIMEOUT)
            except (BadGoal, Unanswered) as error:
                answer = {"accepted": False, "message": str(error)}
            if not answer["accepted"]:
                self._sent.discard(identity)
            verb, level = ("accepted", INFO) if answer["accepted"] else ("refused", WARN)
            self._say(level, f"goal {identity} is {verb}: {told(answer)}")

        return lambda received: self._queue(lambda: send(received.message), name)

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
        timed = len(stamps) > 1 and all(a < b for a, b in itertools.pairwise(stamps))
        step = max(LEAST_STEP, 2 * float(self._client.request("arm", timeout=TIMEOUT)["travel_time"]))
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
        self._client.put("setpoint", json.dumps(payload).encode())
