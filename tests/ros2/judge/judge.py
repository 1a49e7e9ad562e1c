"""A judge of the bridge, from outside: what ROS clients and the daemon see and say, byte for byte.

It is written from the pages of bridge, wire and gateway. It decides whether each thing that the bridge tells or does is
true, in time and in order.
"""

import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tests.ros2.client import ABORTED, CANCELED, SUCCEEDED, Reading
from tests.ros2.judge.actions import ACTIVE, Actions, Goal, Result, Wrong
from tests.ros2.judge.asks import Ask, Asks
from tests.ros2.judge.limits import Limits
from tests.ros2.judge.reader import Arm, Invalid, Reader, check_attachment, goal_of

REPEAT_WITHIN = 5.0  # [s] for each goal whose cancel was accepted, until its cancel is sent again
KNOWN_WITHIN = 15.0  # [s] after which a goal that the ledger does not have is lost
GONE_AFTER = 60.0  # [s] without a daemon, after which its goals are lost
LONGEST_WORDS = 10_000  # bytes of a sentence on /rosout
LOST = -4
MOST_PAID = 1_000
KEYS = {"tip": "goal", "actuators": "goal", "goal_pose": "goal", "goal_path": "goal"}  # of the daemon, by kind
SEND, CANCEL, RESULT = "send_goal", "cancel_goal", "get_result"


@dataclass
class Debt:
    """A cancel that the bridge owes to the daemon, from when it began [s], or was sent last."""

    began: float
    last: float


class Judge:
    """The account of all.

    Args:
        kinds: kind of a message by name of its topic or service.
        clock: returns the time [s]; any, but it never goes back.
        epoch: returns the UNIX time [s].
    """

    def __init__(
        self, arm: Arm, kinds: Mapping[str, str], clock: Callable[[], float], epoch: Callable[[], float]
    ) -> None:
        self._arm, self._kinds, self._clock, self._epoch = arm, kinds, clock, epoch
        self.asks = Asks(clock)
        servers = {name.rpartition("/")[0] for name in kinds if "/" in name}
        self.actions = {it: Actions(clock, self._receive_end, self._receive_debt) for it in servers}
        self.debts: dict[str, Debt] = {}
        self.limits = Limits(clock, epoch)
        self._paid = deque[str](maxlen=MOST_PAID)  # cancels that may be sent still
        self._ends: dict[
            str, list[tuple[str, int, str, bool]]
        ] = {}  # by id: what the daemon told, and if it surely did
        self._unknown: dict[str, float] = {}  # when the ledger did not have a goal [s]
        self._since: dict[str, float] = {}  # when a goal was sent, or restored [s]
        self._gone, self._there = math.inf, 0.0
        self._unexplained: list[Goal] = []
        self._state: dict[str, Any] = {}
        self._fed = True

    def receive(self, name: str, payload: bytes, attachment: bytes | None) -> Ask:
        kind = self._kinds[name]
        key, points = KEYS.get(kind, kind), None
        if key == "reset":
            points = []
        elif key in ("goal", "setpoint", "plan"):
            try:
                check_attachment(attachment)
                points = goal_of(kind, payload, self._arm, self._epoch())
            except Invalid:
                points = None
        if name.endswith(SEND):
            self.actions[name.rpartition("/")[0]].receive_request()
            self.limits.receive(payload)
        service = "/" in name or kind in ("stop", "reset", "cancel", "plan")
        return self.asks.receive(name, key, payload, points, service)

    def receive_drop(self, ask: Ask, attachment: bytes | None) -> None:
        """Accepts that the bridge has dropped a message; a request that ends motion may not be dropped."""
        self.asks.forget(ask)
        sizes = {"stop": 5, "cancel": 5, "cancel_goal": 28}
        if ask.key in sizes and len(ask.payload) == sizes[ask.key] and ask.payload[:4] == b"\0\1\0\0":
            try:
                check_attachment(attachment)
            except Invalid:
                return
            raise Wrong(f"a {ask.key} is dropped: {ask.payload.hex()}")

    def receive_request(self, key: str, payload: Mapping[str, Any]) -> Ask | None:
        now, name = self._clock(), str(payload.get("id", ""))
        if key in ("goal", "plan"):
            points = [it.get("position") for it in payload["waypoints"]]
            if key == "plan":
                return self.asks.receive_motion(key, points)
            topic = name.removeprefix("ros2-").rpartition("-")[0]
            uuid = b"" if topic else bytes.fromhex(name.removeprefix("ros2-"))
            ask = self.asks.receive_motion(key, points, topic, uuid)
            if name in self.debts:
                raise Wrong(f"goal {name} is sent while a cancel of its id is owed")
            self._ends.pop(name, None)
            self._unknown.pop(name, None)
            self._since[name] = now
            return ask
        if key == "reset":
            return self.asks.receive_motion(key, [])
        if key == "stop" or (key == "cancel" and not payload):
            self.asks.receive_ending(key)
        elif key == "cancel":
            if self.limits.allows(name):
                self._receive_owed(name)
            if name in self.debts:
                self.debts[name].last = now
            elif name not in self._paid:
                raise Wrong(f"goal {name} is canceled, and nobody asked for it")
        elif key not in ("arm", "result"):
            raise Wrong(f"{key} is asked for")
        return None

    def receive_setpoint(self, payload: Mapping[str, Any]) -> None:
        self.asks.receive_motion("setpoint", [payload["position"]])

    def receive_answer(self, key: str, payload: Mapping[str, Any], ask: Ask | None, answer: Any, *, sure: bool) -> None:
        """Accepts what the bridge gets for a request: an answer, perhaps not that of a daemon, or None."""
        name = str(payload.get("id", ""))
        accepted = accepts(answer)
        if ask is not None:
            ask.answer = accepted
            if key == "goal":
                self._since[name] = self._clock()
                if accepted is None:
                    self._receive_owed(name)
        elif key == "stop" or (key == "cancel" and not payload):
            self.asks.receive_ending_answer(key, accepted)
        elif key == "result" and isinstance(answer, dict):
            if answer.get("result") is not None:
                self._receive_told(name, answer["result"], sure=sure)
            elif answer.get("reason") == "unknown-goal":
                self._unknown[name] = self._clock()
                if self._clock() >= self._since.get(name, -math.inf) + KNOWN_WITHIN:
                    self._pay(name)

    def receive_reply(self, ask: Ask, data: bytes) -> None:
        server, _, service = ask.name.rpartition("/")
        self.asks.receive_reply(ask, success=len(data) > 4 and data[4] == 1)
        uuid = ask.payload[4:20]
        if service == SEND and data[4]:
            self.actions[server].receive_acceptance(uuid, joints_of(ask.payload))
            self.limits.receive_acceptance(uuid)
        elif service == CANCEL:
            self.actions[server].receive_cancel(ask.payload, data)
        elif service == RESULT and (found := self.actions[server].receive_result(uuid, data)):
            self._check_result(*found)

    def receive_message(self, name: str, data: bytes) -> None:
        server, _, topic = name.rpartition("/")
        if topic == "status":
            self.actions[server].receive_status(data)
        elif topic == "feedback":
            self._receive_feedback(self.actions[server], Reading(data))
        elif topic == "joint_states":
            self._receive_joints(Reading(data))
        elif topic == "rosout" and len(data) > LONGEST_WORDS:
            raise Wrong(f"a sentence of {len(data)} bytes on /rosout")

    def receive_told(self, key: str, data: bytes, *, sure: bool) -> None:
        """Accepts that the bridge hears a message of the daemon; `sure`: it is one, else it may be anything."""
        if key == "gone":
            self._gone = min(self._gone, self._clock())
        elif key == "alive":
            self._gone, self._there = math.inf, self._clock()
        elif key == "result":
            try:
                result = json.loads(data)
            except ValueError:
                return
            self._receive_told(str(result.get("id")) if isinstance(result, dict) else "", result, sure=sure)
        elif key == "state":
            self._state = json.loads(data) if sure else {}
            self._fed = not sure

    def end_turn(self, *, there: bool) -> None:
        """Checks what must be true between two turns of the bridge's loop; `there`: there is a node."""
        self.asks.check_time()
        now = self._clock()
        self._there = self._there if there else now
        for server in self.actions.values():
            server.opening &= not there
            for goal in server.goals.values():
                if there and goal.active and any(it[3] for it in self._ends.get(goal.id, ())):
                    raise Wrong(f"the daemon told that {goal.id} has ended, its client was not told")
                if there and goal.active and self._gone == math.inf and goal.id not in self.debts:
                    self.limits.check(goal)
        for goal in self._unexplained:
            raise Wrong(f"{goal.id} has ended with status {goal.status}, and the daemon has not said so")
        for name, debt in self.debts.items():
            if self._gone == math.inf and now > max(debt.last, debt.began, self._there) + REPEAT_WITHIN * len(
                self.debts
            ):
                raise Wrong(f"the accepted cancel of {name} is not repeated; the goal has not ended")
        if not self._fed and any(it.status in ACTIVE for it in self._named()):
            raise Wrong(f"there is no feedback of {self._state['goal']}")

    def check_rest(self) -> None:
        """Checks what must be true when nothing was asked for a while, and the daemon has answered all."""
        self.end_turn(there=True)
        for ask in self.asks.open:
            if ask.service and not ask.name.endswith(RESULT):
                raise Wrong(f"a request on {ask.name} has no reply")
            uuid, server = ask.payload[4:20], self.actions.get(ask.name.rpartition("/")[0])
            if server is not None and (uuid not in server.goals or not server.goals[uuid].active):
                raise Wrong(f"the result of {uuid.hex()} is not told")
        if self.debts:
            raise Wrong(f"goals are not canceled, though that was accepted: {list(self.debts)}")

    def receive_close(self) -> None:
        """Accepts that the node has ended in order: its goals have ended, and requests have no reply."""
        for server in self.actions.values():
            for goal in server.goals.values():
                if goal.active:
                    raise Wrong(f"the node ends, and {goal.id} has no result")
        for key, ending in self.asks.endings.items():
            if ending.asked > ending.sent:
                raise Wrong(f"the node ends, and a {key} is not sent")
        self._unexplained.clear()
        self.receive_kill()

    def receive_kill(self) -> None:
        """Accepts that the bridge is killed: what it has promised stays, what nobody has heard of may be."""
        for ask in self.asks.open:
            server = self.actions.get(ask.name.rpartition("/")[0])
            if server is not None and ask.name.endswith(SEND):
                server.orphans[ask.payload[4:20]] = joints_of(ask.payload) if ask.points is not None else []
            elif server is not None and ask.name.endswith(CANCEL):
                asked = [ask.payload[4:20]] if any(ask.payload[4:20]) else list(server.goals)
                server.doubtful.update(asked)
                self._paid.extend(f"ros2-{it.hex()}" for it in asked)
        self.asks = Asks(self._clock)
        self._gone, self._there = math.inf, self._clock()
        self._ends = {name: [(*end[:3], False) for end in ends] for name, ends in self._ends.items()}
        self._state, self._fed = {}, True
        for server in self.actions.values():
            server.opening = True
            self._since.update({goal.id: self._clock() for goal in server.goals.values() if goal.active})
        self._since.update({name: self._clock() for name in self.debts})

    def _named(self) -> list[Goal]:
        """Returns the goal that the last state names, if an action has it."""
        goals = [goal for server in self.actions.values() for goal in server.goals.values()]
        return [goal for goal in goals if goal.id == self._state.get("goal")]

    def _receive_feedback(self, server: Actions, reading: Reading) -> None:
        uuid = reading.raw(16)
        reading.get("i"), reading.get("I"), reading.text()
        joints = [reading.text() for _ in range(reading.get("I"))]
        goal = server.goals.get(uuid)
        if goal is None or not goal.active or goal not in self._named():
            raise Wrong(f"there is feedback of goal {uuid.hex()}, which does not run")
        if joints != goal.joints and goal.joints:
            raise Wrong(f"the feedback of goal {uuid.hex()} names {joints}")
        self._fed = True

    def _receive_joints(self, reading: Reading) -> None:
        reading.get("i"), reading.get("I"), reading.text()
        names = [reading.text() for _ in range(reading.get("I"))]
        positions = [reading.get("d") for _ in range(reading.get("I"))]
        measured = self._state.get("measured")
        if measured is None:
            return
        wanted = [math.nan if it is None else float(it) for it in measured]
        if names != list(self._arm.actuators) or repr(positions) != repr(wanted):
            raise Wrong("joint_states are not what the daemon has measured")

    def _receive_told(self, name: str, result: Any, *, sure: bool) -> None:
        if not isinstance(result, dict) or not isinstance(result.get("status"), str):
            return
        code = result.get("code")
        end = (result["status"], LOST if code is None else code, str(result.get("message", "")), sure)
        self._ends.setdefault(name, []).append(end)
        self._pay(name)

    def _receive_debt(self, goal: Goal) -> None:
        if any(it[3] for it in self._ends.get(goal.id, ())):
            return
        self._receive_owed(goal.id)

    def _receive_owed(self, name: str) -> None:
        self.debts.setdefault(name, Debt(self._clock(), -math.inf))

    def _pay(self, name: str) -> None:
        if self.debts.pop(name, None) is not None:
            self._paid.append(name)

    def _receive_end(self, goal: Goal) -> None:
        """Accepts a goal's last status; only the daemon, or its absence, can end a goal."""
        goal.told = self._told(goal)
        allowed = {
            SUCCEEDED if status == "succeeded" else CANCELED if status == "canceled" and goal.canceled else ABORTED
            for status, *_ in self._ends.get(goal.id, ())
        }
        if goal.status not in allowed and not (goal.status == ABORTED and self._may_be_lost(goal)):
            self._unexplained.append(goal)

    def _told(self, goal: Goal) -> tuple[tuple[int, str], ...]:
        return tuple((code, f"{status}: {message}") for status, code, message, _ in self._ends.get(goal.id, ()))

    def _may_be_lost(self, goal: Goal) -> bool:
        since = self._since.get(goal.id, -math.inf)
        unknown = self._unknown.get(goal.id, -math.inf) > since + KNOWN_WITHIN
        return unknown or self._clock() > max(self._gone, since) + GONE_AFTER

    def _check_result(self, goal: Goal, result: Result) -> None:
        """Checks that a result is what the daemon has told."""
        told = goal.told or self._told(goal)  # a later goal may have the id by now
        lost = result.code == LOST and result.text.startswith("lost: ") and result.status == ABORTED
        if (result.code, result.text) not in told and not lost and not self.limits.explains(goal, result):
            raise Wrong(f"{goal.id} is told to be {result}, the daemon said {told}")
        succeeded, canceled = result.text.startswith("succeeded: "), result.text.startswith("canceled: ")
        if (result.status == SUCCEEDED) != succeeded or (result.status == CANCELED) != (canceled and goal.canceled):
            raise Wrong(f"{goal.id} has the status of another result: {result}")


def accepts(answer: Any) -> bool | None:
    """Returns what an answer of the daemon says; None if it has another form."""
    if not isinstance(answer, dict) or not isinstance(answer.get("accepted"), bool):
        return None
    code, message, reason = answer.get("code", 0), answer.get("message", ""), answer.get("reason")
    if type(code) is not int or not -(2**31) <= code < 2**31 or not isinstance(message, str):
        return None
    return bool(answer["accepted"]) if reason is None or isinstance(reason, str) else None


def joints_of(message: bytes) -> list[str]:
    reader = Reader(message)
    reader.get("B", 16)
    reader.header()
    return [reader.text() for _ in range(reader.count())]
