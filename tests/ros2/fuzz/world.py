"""The bridge in one thread with a clock of its own, its daemon and its network; each input is judged."""

import contextlib
import json
import logging
import math
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, cast
from unittest import mock

import zenoh
import zenoh.ext

from controller.network.client import Client, Unanswered
from controller.network.listener import Listener, ReceivedMessage
from controller.ros2 import arm_node, bridge, goal_book, goals, poses, requests
from controller.ros2.arm_node import ArmNode, Settings
from controller.ros2.bridge import Bridge
from controller.ros2.goal_book import GoalBook
from controller.ros2.wire import action_server, services, topics
from controller.ros2.wire.session import Session
from tests.ros2.fuzz import judge
from tests.ros2.fuzz.inputs import KINDS, Input, Inputs, payloads
from tests.ros2.fuzz.network import TOKENS, Network, Query, Sample, TokenSample, Wrong, strict_json
from tests.ros2.fuzz.stand_ins import Clock, Pool, Trial
from tests.ros2.samples import chain

TIMED = (arm_node, bridge, goals, goal_book, poses, action_server, services, topics)
BATCH = 40  # messages of ROS 2 between two turns of the bridge's loop
STEP = 0.01  # [s] between two messages, on average
ZERO_ID = b"ros2-" + b"00" * 16
KEPT_RESULTS = 100
TOKENS_SEEN = 0.3  # share of the turns in which a stranger's token comes or goes
LOOKS = 0.03  # share of the turns after which the bridge's tables are counted


class World:
    """Runs the bridge's own loop; is its listener, which delivers the inputs, and its client of the daemon.

    Attributes:
        counts: of inputs by what followed first, and of sentences and nodes.
        largest: greatest number of entries in all tables of the bridge.

    Args:
        inputs: makes the inputs.
        folder: of the file of goals.
    """

    def __init__(self, inputs: Inputs, folder: Path) -> None:
        self.inputs, self.chance, self.clock, self.network = inputs, inputs.chance, Clock(), Network()
        self.pools: list[Pool] = []
        self.trial: Trial | None = None
        self.counts: Counter[str] = Counter()
        self.largest = 0
        self._waiting = deque[tuple[str, bytes]]()
        self._goal: str | None = None
        self._results: dict[str, dict[str, Any]] = {}
        self._left = 0
        self._heard: list[tuple[str, bytes]] = []
        self._arm = judge.Arm(
            ("world", "planar16/0"), ("tip_x", "tip_y"), tuple(chain().actuators), bool(self.chance.random() < 0.5)
        )
        settings = Settings("", 0, "jazzy", "world", self._arm.oriented)
        session, client, listener = cast("Session", self.network), cast("Client", self), cast("Listener", self)
        self.bridge = Bridge(listener, client, session, GoalBook(folder / "goals.json"), settings)

    def run(self, messages: int) -> None:
        """Feeds the bridge this many messages of ROS 2, and others of the daemon; raises Wrong."""
        with self.in_place():
            self._left = messages
            self.bridge.run(lambda: self._left <= 0, lambda: None)
            self.run_jobs()
            self.bridge.close()
        record = self.network.goals
        if record.open or record.accepted != record.ended:
            raise Wrong(f"{record.accepted} goals are accepted, {record.ended} ended")
        if self.network.tokens:
            raise Wrong(f"tokens of an ended bridge are there: {self.network.tokens}")

    def reopen(self) -> None:
        """Lets the bridge show the arm again."""
        with self.in_place():
            self.ask()
            self.hear(*self._waiting.popleft())

    def hear(self, key: str, data: bytes) -> None:
        """Hands the bridge a message of the daemon, and lets it publish."""
        self._heard.append((key, data))
        self.bridge.run(lambda: not self._heard, lambda: None)

    def entries(self) -> int:
        """Returns the number of entries in all tables of the bridge."""
        return entries(self.bridge)

    def ask(self) -> None:
        """Lets the daemon describe the arm."""
        self._waiting.append(("arm", json.dumps(payloads()["arm"]).encode()))

    def receive_messages(self, timeout: float) -> list[ReceivedMessage]:
        """Delivers messages of ROS 2; returns those of the daemon."""
        if self._heard:
            return [ReceivedMessage(0, *self._heard.pop())]
        for _ in range(BATCH if self.network.handlers else 0):
            self.clock.sleep(self.chance.random() * 2 * STEP)
            self.deliver(self.inputs.message(self.clock.time()))
            while any(pool.jobs for pool in self.pools) and self.chance.random() < 0.7:
                self._run_job()
        if self.network.handlers and self.chance.random() < TOKENS_SEEN:
            token = self.inputs.token(sorted(self.network.tokens))
            kind = self.chance.choice((zenoh.SampleKind.PUT, zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE))
            self.network.handlers[TOKENS](cast("Any", TokenSample(token, kind)))
            self.counts["tokens"] += 1
        for _ in range(int(self.chance.random() * 4)):
            key, data = self.inputs.daemon_message()
            if key == "arm" and self.chance.random() < 0.9:
                continue
            self._waiting.append((key, data.replace(ZERO_ID, (self._goal or "").encode())))
            if key == "arm":
                self.ask()
        taken = [ReceivedMessage(0, key, data) for key, data in self._waiting]
        self._waiting.clear()
        self.counts["daemon's"] += len(taken)
        if self.chance.random() < LOOKS:
            self.largest = max(self.largest, self.entries())
        return taken

    def request(self, key: str, payload: Mapping[str, Any] | None = None, timeout: float | None = None) -> Any:
        """Answers a request to the daemon, which must be one that the present input may cause."""
        self._note(key)
        strict_json(payload)
        if key in ("goal", "plan"):
            assert payload is not None
            self._check(payload["waypoints"])
        answer = self._answer(key, payload or {})
        kind = self.chance.random()
        if kind < 0.03:
            raise self.chance.choice(
                (Unanswered("no daemon"), zenoh.ZError("closed"), json.JSONDecodeError("bad", "x", 0))
            )
        return self.inputs.spoiled(json.loads(json.dumps(answer))) if kind < 0.1 else answer

    def put(self, key: str, payload: bytes) -> None:
        """Accepts a set-point."""
        self._note(key)
        self._check([json.loads(payload, parse_constant=lambda text: math.nan)])

    def _check(self, waypoints: list[dict[str, Any]]) -> None:
        """Checks that the present input is a goal, by an independent reader, and that these are its waypoints."""
        assert self.trial
        name, payload, attachment = self.trial.input
        try:
            judge.check_attachment(attachment)
            wanted = judge.goal_of(KINDS[name][0], payload, self._arm, self.clock.time())
        except judge.Invalid as error:
            raise Wrong(f"a message on {name} is a goal, though invalid ({error}): {payload.hex()[:2000]}") from None
        if len(wanted) != len(waypoints):
            raise Wrong(f"{name}: {len(waypoints)} waypoints of {len(wanted)}")
        for point, waypoint in zip(wanted, waypoints, strict=True):
            if "position" in waypoint and not all(map(math.isclose, point, waypoint["position"])):
                raise Wrong(f"{name}: {waypoint['position']} of {point}")

    def _answer(self, key: str, payload: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the answer of a daemon."""
        if key == "arm":
            return payloads()["arm"]
        if key == "result":
            found = self._results.get(payload["id"])
            return {"accepted": True, "result": found} if found else {"accepted": False, "reason": "unknown-goal"}
        if self.chance.random() < 0.1:
            return {"accepted": False, "code": -5, "message": "out of reach", "reason": "out-of-reach"}
        if key == "plan":
            return {
                "accepted": True,
                "code": 0,
                "message": "",
                "waypoints": [{"position": [0.1, 0.2], "orientation": 0.1}],
            }
        if key in ("goal", "stop", "cancel") and self._goal:
            self._end(self._goal, {"goal": "replaced", "cancel": "canceled"}.get(key, "stopped"))
        if key == "goal":
            self._goal = payload["id"]
            if self.chance.random() < 0.3:
                self._end(payload["id"], "succeeded")
        return {"accepted": True, "code": 0, "message": "yes"}

    def _end(self, name: str, status: str) -> None:
        """Ends a goal; some results get lost."""
        result = {"id": name, "status": status, "code": 0 if status == "succeeded" else -1, "message": "so it is"}
        self._goal, self._results[name] = None, result
        if len(self._results) > KEPT_RESULTS:
            del self._results[next(iter(self._results))]
        if self.chance.random() < 0.8:
            self._waiting.append(("result", json.dumps(result).encode()))

    def deliver(self, given: Input) -> None:
        """Delivers a message of ROS 2; raises Wrong if it is lost without a word."""
        handler = self.network.handlers.get(given.name)
        if handler is None:
            raise Wrong(f"nobody listens on {given.name}")
        self._left -= 1
        trial = self.trial = Trial(given)
        counts: Counter[str] = handler.__self__.dropped  # type: ignore[attr-defined]
        before = counts.total()
        if "/" in given.name or KINDS[given.name][0] in ("stop", "reset", "cancel", "plan"):
            query = Query(given.payload, given.attachment, lambda data: self._on_reply(trial, data))
            handler(query)
            if given.name.endswith("get_result") and counts.total() == before and not query.replied:
                trial.outcomes.append("waits")
        else:
            attachment = None if given.attachment is None else zenoh.ZBytes(given.attachment)
            handler(Sample(zenoh.ZBytes(given.payload), attachment))
        if counts.total() > before:
            trial.outcomes.append("dropped")
        if counts["callback"]:
            raise Wrong(f"the callback of {given.name} failed")
        self.trial = None
        self._judge(trial)

    def _on_reply(self, trial: Trial, data: bytes) -> None:
        trial.outcomes.append("replied")
        server, _, service = trial.input.name.rpartition("/")
        uuid = trial.input.payload[4:20]
        if service == "send_goal" and data[4]:
            self.network.goals.receive_acceptance(f"{server}/", uuid)
        elif service == "get_result":
            self.network.goals.receive_result(f"{server}/", uuid, data)

    def run_jobs(self) -> None:
        """Runs the jobs that wait."""
        while any(pool.jobs for pool in self.pools):
            self._run_job()

    def _run_job(self) -> None:
        pool = self.chance.choice([pool for pool in self.pools if pool.jobs])
        job, trial = pool.jobs.popleft()
        self.trial = trial
        job()
        self.trial = None
        if trial:
            trial.jobs -= 1
            self._judge(trial)

    def _judge(self, trial: Trial) -> None:
        """Checks that an input that has no effect is counted or told."""
        if trial.jobs:
            return
        if not trial.outcomes:
            raise Wrong(f"nothing followed from {trial.input}")
        self.counts[trial.outcomes[0]] += 1

    def _note(self, outcome: str) -> None:
        if self.trial:
            self.trial.outcomes.append(outcome)

    @contextlib.contextmanager
    def in_place(self) -> Iterator[None]:
        """Puts clock, pools and network in the place of the true ones; logged exceptions are failures."""
        say = ArmNode.say

        def noted(node: ArmNode, level: int, text: str) -> None:
            if text.startswith("a request failed"):
                raise Wrong(text)
            self._note("said")
            say(node, level, text)

        def pool(*_: object) -> Pool:
            return Pool(self.pools, lambda: self.trial)

        def publisher(session: Network, key: str, **options: Any) -> Any:
            return session.declare_publisher(key, **options)

        def subscriber(session: Network, key: str, handler: Callable[[Any], None], **_: Any) -> Any:
            return session.declare_subscriber(key, handler)

        with contextlib.ExitStack() as closing:
            for module in TIMED:
                closing.enter_context(mock.patch.object(module, "time", self.clock))
            closing.enter_context(mock.patch.object(requests, "ThreadPoolExecutor", pool))
            closing.enter_context(mock.patch.object(ArmNode, "say", noted))
            closing.enter_context(mock.patch.object(zenoh.ext, "declare_advanced_publisher", publisher))
            closing.enter_context(mock.patch.object(zenoh.ext, "declare_advanced_subscriber", subscriber))
            closing.enter_context(logged_exceptions())
            yield


@contextlib.contextmanager
def logged_exceptions() -> Iterator[None]:
    """Raises Wrong at the end if the bridge has logged an exception; other lines of its log are not printed."""
    found: list[str] = []

    class Handler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.exc_info and len(found) < 3:
                found.append(logging.Formatter().format(record))

    logger, handler = logging.getLogger("controller.ros2"), Handler()
    propagate, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        yield
    except Wrong as error:
        raise Wrong("\n".join((str(error), *found))) from None
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate
    if found:
        raise Wrong("\n".join(found))


def entries(whole: object) -> int:
    """Returns the number of entries in all tables that are reached from an object of the bridge."""
    seen: set[int] = set()
    waiting, total = [whole], 0
    while waiting:
        it = waiting.pop()
        if id(it) in seen:
            continue
        seen.add(id(it))
        if isinstance(it, dict | list | set | deque | tuple):
            total += len(it)
            waiting.extend(it.values() if isinstance(it, dict) else it)
        elif type(it).__module__.startswith("controller.ros2") and type(it).__name__ != "Types":
            waiting.extend(vars(it).values() if hasattr(it, "__dict__") else ())
    return total
