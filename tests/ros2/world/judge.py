"""Statements about the bridge, from outside: what ROS clients and the daemon see of it.

They are written from the pages of bridge, wire and gateway, and do not decide again what the bridge decides.
"""

import json
import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any

from hyperbit.controller.ros2.poses import BadGoal
from hyperbit.controller.ros2.wire.actions import Status
from tests.ros2.world.account import (
    ACTIVE,
    BARRED,
    ENDS,
    Ask,
    Asks,
    Debts,
    Goal,
    Losses,
    Result,
    Told,
    Wrong,
    identity,
    points_of,
    status_of,
)
from tests.ros2.world.motion import Arm, motion_of, time_limit

CANCELED_WITHIN = 2.0  # [s] until a goal is canceled that exceeds its time
LONGEST_WORDS = 10_000  # letters of a sentence on /rosout
LOST, TOO_LATE = -4, -5  # codes of results that the bridge makes itself
MOTIONS = {"tip": "goal", "actuators": "goal", "goal_pose": "goal", "goal_path": "goal"}  # keys of the daemon, by kind
SEND, CANCEL, RESULT = "send_goal", "cancel_goal", "get_result"
ALL = bytes(16)


class Judge:
    """`kinds`: of messages, by name of topic or service. `clock` and `epoch` return the time, and the UNIX time [s]."""

    def __init__(
        self, arm: Arm, kinds: Mapping[str, str], clock: Callable[[], float], epoch: Callable[[], float]
    ) -> None:
        self._arm, self._kinds, self._clock, self._epoch = arm, kinds, clock, epoch
        self.goals: dict[tuple[str, bytes], Goal] = {}
        self.accepted = self.ended = 0
        self.debts = Debts(clock)
        self.asks = Asks(clock)
        self._limits: dict[bytes, tuple[float, float]] = {}  # stamp and time allowed after it, of goals by id [s]
        self._due: dict[str, float] = {}  # time before which the limit of a goal is not over [s]
        self._ends: defaultdict[str, list[Told]] = defaultdict(list)
        self._unexplained: list[Goal] = []
        self._losses = Losses(clock)
        self._orphans: dict[tuple[str, bytes], list[str]] = {}  # goals without an answer when the bridge was killed
        self._doubtful: set[bytes] = set()  # goals whose cancel had no answer when the bridge was killed
        self._opening = False  # whether a bridge restores its goals
        self._there = 0.0  # a node was not there until then [s]
        self._state: dict[str, Any] = {}
        self._fed = True

    # What ROS clients ask for, and what the bridge sends to the daemon for it.

    def receive(self, name: str, message: Any) -> Ask:
        """Accepts a message that arrives; None: it cannot be read."""
        kind, points, uuid = self._kinds[name], None, ALL
        key = MOTIONS.get(kind, kind)
        if message is not None and (key in BARRED):
            try:
                points = [] if key == "reset" else motion_of(kind, message, self._arm, self._epoch())
            except BadGoal:
                points = None
        if message is not None and "/" in name:
            uuid = bytes((message.goal_info if name.endswith(CANCEL) else message).goal_id.uuid)
        if name.endswith(SEND):
            for goal in self.goals.values():
                goal.later += 1
            if message is not None and (limit := time_limit(message.goal)):
                self._limits[uuid], self._due[identity(uuid)] = limit, self._limit(*limit)
        service = "/" in name or key in ("stop", "cancel", "reset", "plan")
        ask = Ask(self.asks.number + 1, name, key, message, points, uuid, service)
        self.asks.receive(ask)
        return ask

    def receive_drop(self, ask: Ask, reason: str) -> None:
        self.asks.forget(ask)
        if ask.message is not None and (reason != "open" or ask.key in ("stop", "cancel", CANCEL)):
            raise Wrong(f"{ask.message} on {ask.name} is dropped: {reason}")

    def receive_request(self, key: str, payload: Mapping[str, Any]) -> Ask | None:
        """Accepts a request of the bridge to the daemon; returns what it is sent for, if it asks for motion."""
        name = str(payload.get("id", ""))
        match key:
            case "goal":
                topic = name.removeprefix("ros2-").rpartition("-")[0]
                uuid = b"" if topic else bytes.fromhex(name.removeprefix("ros2-"))
                ask = self.asks.send(key, points_of(payload), topic, uuid)
                if name in self.debts:
                    raise Wrong(f"goal {name} is sent while a cancel of its id is owed")
                self._ends.pop(name, None)
                self._losses.begin(name)
                return ask
            case "plan" | "reset":
                return self.asks.send(key, points_of(payload))
            case "cancel" if name:
                if self._clock() >= self._due.get(name, math.inf):
                    self.debts.owe(name)
                self.debts.send(name)
            case "stop" | "cancel":
                self.asks.send_ending(key)
        return None

    def receive_setpoint(self, payload: Mapping[str, Any]) -> None:
        self.asks.send("setpoint", [payload["position"]])

    def receive_answer(self, key: str, payload: Mapping[str, Any], ask: Ask | None, answer: Any, *, sure: bool) -> None:
        """Accepts what the bridge gets for a request: an answer of the daemon, None, or, if not `sure`, junk."""
        name = str(payload.get("id", ""))
        accepted = answer.get("accepted") if isinstance(answer, dict) and sure else None
        if ask is not None:
            ask.answer = accepted
            if key == "goal":
                self._losses.since[name] = self._clock()
                if accepted is None:
                    self.debts.owe(name)
        elif key in self.asks.endings and not name:
            ending = self.asks.endings[key]
            ending.accepted = ending.sent if accepted else 0
        elif key == "result" and sure and answer is not None:
            if answer.get("result") is not None:
                self._receive_end(name, answer["result"], sure=True)
            elif answer.get("reason") == "unknown-goal" and self._losses.is_unknown(name):
                self.debts.pay(name)

    # What the daemon tells, and what the bridge tells ROS clients.

    def receive_told(self, key: str, data: bytes, *, sure: bool) -> None:
        """Accepts a message that the bridge hears; not `sure`: it may be anything."""
        if key == "gone":
            self._losses.gone = min(self._losses.gone, self._clock())
        elif key == "alive":
            self._losses.gone, self._there = math.inf, self._clock()
        elif key == "state":
            self._state, self._fed = json.loads(data) if sure else {}, not sure
        elif key == "result":
            try:
                result = json.loads(data)
            except ValueError:
                return
            if isinstance(result, dict):
                self._receive_end(str(result.get("id")), result, sure=sure)

    def receive_reply(self, ask: Ask, message: Any) -> None:
        self.asks.reply(ask)
        server, _, service = ask.name.rpartition("/")
        match service:
            case "send_goal" if message.accepted:
                self._accept(server, ask)
            case "cancel_goal":
                self._receive_cancel(server, ask, [bytes(it.goal_id.uuid) for it in message.goals_canceling])
            case "get_result":
                given = Result(message.status, message.result.error_code, message.result.error_string)
                self._receive_result(server, ask.uuid, given)
            case "stop" | "cancel" if message.success != (self.asks.endings[service].accepted >= ask.number):
                raise Wrong(f"{ask.key} is answered {message.success}, the daemon has not said so")
            case "reset" if message.success != bool(ask.sent and ask.answer):
                raise Wrong(f"reset is answered {message.success}, the daemon's answer is {ask.answer}")

    def _accept(self, server: str, ask: Ask) -> None:
        key = server, ask.uuid
        if not (ask.sent and ask.answer):
            raise Wrong(f"goal {ask.uuid.hex()} is accepted, the daemon's answer is {ask.answer}")
        if key in self.goals and self.goals[key].active:
            raise Wrong(f"goal {ask.uuid.hex()} is accepted twice")
        due = self._limit(*self._limits[ask.uuid]) if ask.uuid in self._limits else math.inf
        self.goals.pop(key, None)
        self.goals[key] = Goal(server, ask.uuid, list(ask.message.goal.trajectory.joint_names), due=due)
        self._limits.pop(ask.uuid, None)
        self._orphans.pop(key, None)
        self._doubtful.discard(ask.uuid)
        self.accepted += 1

    def receive_message(self, name: str, message: Any) -> None:
        server, _, topic = name.rpartition("/")
        match topic:
            case "status":
                states = {bytes(it.goal_info.goal_id.uuid): Status(it.status) for it in message.status_list}
                self._receive_status(server, states)
            case "feedback":
                self._receive_feedback(server, message)
            case "joint_states" if self._state.get("measured") is not None:
                measured = [math.nan if it is None else float(it) for it in self._state["measured"]]
                told = message.name, message.position.tolist()
                if repr(told) != repr((list(self._arm.manipulator.actuators), measured)):  # nan is not equal to itself
                    raise Wrong("joint_states are not what the daemon has measured")
            case "rosout" if len(message.msg) > LONGEST_WORDS or message.msg.startswith("a request failed"):
                raise Wrong(f"on /rosout: {message.msg[:500]}")

    def _receive_status(self, server: str, states: dict[bytes, Status]) -> None:
        """The status of a goal takes legal steps only, and each goal stays until its end."""
        for uuid, status in states.items():
            key = server, uuid
            if key in self._orphans and status in ACTIVE and not (key in self.goals and self.goals[key].active):
                self.goals.pop(key, None)
                self.goals[key] = Goal(server, uuid, self._orphans.pop(key), Status.EXECUTING)
                self.accepted += 1
            if key not in self.goals:
                raise Wrong(f"a status tells of goal {uuid.hex()}, which was not accepted")
            goal = self.goals[key]
            changed = goal.step(status)
            if status is Status.CANCELING and not goal.canceled:
                if uuid not in self._doubtful:
                    raise Wrong(f"goal {uuid.hex()} is canceling, and no cancel was accepted")
                goal.canceled = True
            if changed and not goal.active:
                self._check_end(goal)
        for goal in self._active():
            if goal.server == server and goal.uuid not in states and not self._opening:
                raise Wrong(f"goal {goal.uuid.hex()} has gone without a result")

    def _receive_cancel(self, server: str, ask: Ask, canceled: list[bytes]) -> None:
        """A cancel of an active goal, or of all, is accepted once, and nothing else is canceled."""
        able = {it.uuid for it in self._active() if it.server == server and not it.canceled}
        stamp = ask.message.goal_info.stamp
        timed = stamp.sec or stamp.nanosec
        wanted = able if ask.uuid == ALL else able & {ask.uuid}
        doubtful = ask.uuid in self._doubtful or (server, ask.uuid) in self._orphans
        if set(canceled) - able or (not timed and not doubtful and set(canceled) != wanted):
            raise Wrong(f"a cancel of {ask.uuid.hex()} cancels {canceled}, expected {wanted}")
        for uuid in canceled:
            goal = self.goals[server, uuid]
            goal.canceled = True
            if not any(it.sure for it in self._ends[goal.id]):
                self.debts.owe(goal.id)

    def _receive_result(self, server: str, uuid: bytes, result: Result) -> None:
        """Each accepted goal has one result, and it is what the daemon has told."""
        key = server, uuid
        goal = self.goals.get(key)
        if result.status == Status.UNKNOWN:
            if goal and key not in self._orphans and (goal.active or goal.is_kept(self._clock())):
                raise Wrong(f"{goal} is told to be unknown at {self._clock():.2f}")
            return
        if goal is None or goal.result not in (None, result):
            raise Wrong(f"goal {uuid.hex()} has the result {result}; it is {goal}")
        first, goal.result = goal.result is None, result
        if not first:
            return
        if result.status not in ENDS or goal.status not in (result.status, Status.EXECUTING, Status.CANCELING):
            raise Wrong(f"goal {uuid.hex()} has status {goal.status}, and {result}")
        told = [(it.code, it.text) for it in goal.told or self._ends[goal.id]]  # a later goal may have the id by now
        lost = result.text.startswith("lost: ") and (result.code, result.status) == (LOST, Status.ABORTED)
        late = "goal_time_tolerance" in result.text and (result.code, result.status) == (TOO_LATE, Status.ABORTED)
        if (result.code, result.text) not in told and not lost and not (late and self._is_late(goal)):
            raise Wrong(f"{goal.id} is told to be {result}, the daemon said {told}")
        if result.status != status_of(result.text.partition(":")[0], canceled=goal.canceled):
            raise Wrong(f"{goal.id} has the status of another result: {result}")

    def _receive_feedback(self, server: str, message: Any) -> None:
        goal = self.goals.get((server, bytes(message.goal_id.uuid)))
        if goal is None or not goal.active or goal.id != self._state.get("goal"):
            raise Wrong(f"there is feedback of {goal}, which does not run")
        if goal.joints not in ([], list(message.feedback.joint_names)):
            raise Wrong(f"the feedback of {goal.id} names {message.feedback.joint_names}")
        self._fed = True

    # What must be true between two turns of the bridge, at rest, and when it ends.

    def check_turn(self, *, there: bool) -> None:
        """`there`: there is a node."""
        now = self._clock()
        self._there = self._there if there else now
        self._opening &= not there
        self.asks.check_time()
        for goal in self._unexplained:
            raise Wrong(f"{goal.id} has ended with status {goal.status!r}, and the daemon has not said so")
        for goal in self._active() if there else ():
            if any(it.sure for it in self._ends[goal.id]):
                raise Wrong(f"the daemon told that {goal.id} has ended, its client was not told")
            if self._losses.gone == math.inf and goal.id not in self.debts and now > goal.due + CANCELED_WITHIN:
                raise Wrong(f"{goal.id} exceeds its time, and is not canceled")
            if not self._fed and goal.status in ACTIVE and goal.id == self._state["goal"]:
                raise Wrong(f"there is no feedback of {goal.id}")
        if self._losses.gone == math.inf:
            self.debts.check_time(self._there)

    def check_rest(self) -> None:
        """Checks what holds when nobody has asked for anything for a while, and the daemon has answered all."""
        self.check_turn(there=True)
        active = {(it.server, it.uuid) for it in self._active()}
        self.asks.open = [it for it in self.asks.open if it.service]
        for ask in self.asks.open:
            if not ask.name.endswith(RESULT) or (ask.name.rpartition("/")[0], ask.uuid) not in active:
                raise Wrong(f"a request on {ask.name} has no reply")
        if self.debts:
            raise Wrong(f"goals are not canceled, though that was accepted: {list(self.debts)}")

    def receive_close(self) -> None:
        """Accepts that the node has ended in order: each goal has ended, and each stop is sent."""
        if active := [it.id for it in self._active()]:
            raise Wrong(f"the node ends, and {active} have no result")
        if unsent := [key for key, it in self.asks.endings.items() if it.asked > it.sent]:
            raise Wrong(f"the node ends, and {unsent} are not sent")
        self._unexplained.clear()
        self.receive_kill()

    def receive_kill(self) -> None:
        """Accepts that the bridge is killed: what it has promised stays, and what nobody has heard of may be."""
        for ask in self.asks.open:
            server = ask.name.rpartition("/")[0]
            if ask.name.endswith(SEND):
                joints = ask.message.goal.trajectory.joint_names if ask.points is not None else []
                self._orphans[server, ask.uuid] = list(joints)
            elif ask.name.endswith(CANCEL):
                own = [it.uuid for it in self.goals.values() if it.server == server]
                self._doubtful |= {ask.uuid} if ask.uuid != ALL else set(own)
                self.debts.paid |= {identity(it) for it in self._doubtful}
        self.asks = Asks(self._clock)
        self._losses.gone, self._there = math.inf, self._clock()
        for name, ends in self._ends.items():
            self._ends[name] = [it._replace(sure=False) for it in ends]
        self._state, self._fed, self._opening = {}, True, True
        self._losses.since |= dict.fromkeys([*(it.id for it in self._active()), *self.debts], self._clock())

    def _active(self) -> list[Goal]:
        return [it for it in self.goals.values() if it.active]

    def _limit(self, stamp: float, allowed: float) -> float:
        return self._clock() + max(stamp - self._epoch(), 0.0) + allowed

    def _is_late(self, goal: Goal) -> bool:
        return self._clock() >= self._due.get(goal.id, math.inf)

    def _receive_end(self, name: str, result: dict[str, Any], *, sure: bool) -> None:
        status, code = result.get("status"), result.get("code")
        if isinstance(status, str):
            told = Told(status, LOST if code is None else code, f"{status}: {result.get('message', '')}", sure)
            self._ends[name].append(told)
            self.debts.pay(name)

    def _check_end(self, goal: Goal) -> None:
        """Only the daemon, or its absence, ends a goal."""
        goal.ended, goal.told = self._clock(), list(self._ends[goal.id])
        self.ended += 1
        allowed = {status_of(it.status, canceled=goal.canceled) for it in goal.told}
        if goal.status not in allowed and not (goal.status is Status.ABORTED and self._losses.may_be_lost(goal.id)):
            self._unexplained.append(goal)  # unless the node ends
