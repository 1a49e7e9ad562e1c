"""A session of the wire without a network: what the bridge declares is called directly, and what it sends is judged."""

import itertools
import random
import threading
import uuid
from collections import Counter, deque
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import zenoh

from hyperbit.controller.ros2.wire.cdr import deserialize
from hyperbit.controller.ros2.wire.session import Computer
from tests.ros2.world.account import Wrong
from tests.ros2.world.inputs import ACTION, TYPES
from tests.ros2.world.judge import Judge

TOKENS = "tokens"  # in place of a name: what hears of all nodes and endpoints
JUDGED = {  # types of the messages that the judge reads, by last part of the topic
    "status": "action_msgs/msg/GoalStatusArray",
    "feedback": f"{ACTION}_FeedbackMessage",
    "joint_states": "sensor_msgs/msg/JointState",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "rosout": "rcl_interfaces/msg/Log",
}


class Killed(BaseException):
    """The bridge is killed in this moment."""


class Clock:
    def __init__(self) -> None:
        self.now, self.epoch = 1_000.0, 1.7e9

    def __call__(self) -> float:
        return self.now

    def time(self) -> float:
        return self.epoch + self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Threads:
    """Stand in for all threads: a job runs when the world says so. Who waits lets other threads run."""

    def __init__(self, chance: random.Random, clock: Clock) -> None:
        self._chance, self.pools = chance, list[Pool]()
        self.computer = Computer(
            monotonic=clock,
            time_ns=lambda: int(clock.time() * 1e9),
            sleep=clock.sleep,
            uuid=lambda: uuid.UUID(bytes=chance.randbytes(16)),
            pool=lambda _, name: cast("Any", Pool(name, self.pools)),
            condition=lambda: cast("threading.Condition", Condition(self.run)),
        )

    def take(self) -> None:
        """Lets the threads begin all jobs, so that the end of a pool waits for these."""
        for pool in self.pools:
            pool.begun = len(pool.jobs)

    def run(self, but: str = "", share: float = 1.0) -> None:
        """Runs jobs of all pools but one in any order; stops before each with probability 1 - `share`."""
        while (able := [it for it in self.pools if it.jobs and it.name != but]) and self._chance.random() <= share:
            self._chance.choice(able).jobs.popleft()()


class Condition:
    def __init__(self, let_run: Callable[[str], None]) -> None:
        self._let_run = let_run

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    def notify_all(self) -> None:
        pass

    def wait_for(self, predicate: Callable[[], bool], timeout: float) -> bool:
        if timeout and not predicate():
            self._let_run(MOTION)
        return predicate()


class Pool:
    def __init__(self, name: str, pools: "list[Pool]") -> None:
        self.name, self._pools, self._open, self.begun = name, pools, True, 0
        self.jobs = deque[Callable[[], None]]()
        pools.append(self)

    def submit(self, job: Callable[[], None]) -> None:
        if not self._open:
            raise RuntimeError("closed")
        self.jobs.append(job)

    def shutdown(self, cancel_futures: bool = False) -> None:
        while self.jobs and (self.begun > 0 or not cancel_futures):
            self.begun -= 1
            self.jobs.popleft()()
        self._open = False
        self.jobs.clear()
        self._pools.remove(self)


MOTION = "ros2"  # name of the pool for motion and plans


class Sample(NamedTuple):
    """A sample, as far as the bridge reads it."""

    payload: zenoh.ZBytes
    attachment: zenoh.ZBytes | None


class TokenSample(NamedTuple):
    key_expr: str
    kind: zenoh.SampleKind


class Query:
    """A query, as far as the bridge uses it; it is replied to at most once."""

    def __init__(self, payload: bytes, attachment: bytes | None, on_reply: Callable[[bytes], None]) -> None:
        self.payload, self._on_reply, self._replied = zenoh.ZBytes(payload), on_reply, False
        self.attachment = None if attachment is None else zenoh.ZBytes(attachment)

    def __enter__(self) -> "Query":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def reply(self, key: str, data: bytes, attachment: bytes) -> None:
        if self._replied or len(attachment) != 33:
            raise Wrong(f"a second reply, or one without attachment, on {key}")
        self._replied = True
        self._on_reply(data)


class Declared:
    def __init__(self, undo: Callable[[], object], put: Callable[[bytes], None] = lambda data: None) -> None:
        self.undeclare, self._put = undo, put

    def put(self, data: bytes, attachment: bytes) -> None:
        if len(attachment) != 33:
            raise Wrong("a message without attachment")
        self._put(data)


class Network:
    """The session of the wire and that of Zenoh in one.

    Attributes:
        handlers: of topics and services, by name below the namespace.
        life: number of kills; what is left of a killed bridge does nothing.
        said: the latest sentences on /rosout.
        published: number of messages by name of the topic.
        latest: message of each topic that the judge reads.
    """

    zid = "f00d"

    def __init__(self, judge: Judge, computer: Computer) -> None:
        self._judge, self.computer = judge, computer
        self.zenoh = self
        self.handlers: dict[str, Callable[[Any], None]] = {}
        self.tokens: set[str] = set()
        self.life, self._numbers = 0, itertools.count()
        self.said, self.latest = deque[str](maxlen=100), dict[str, Any]()
        self.published: Counter[str] = Counter()

    def liveliness(self) -> "Network":
        return self

    def next_number(self) -> str:
        return str(next(self._numbers))

    def kill(self) -> None:
        self.life += 1
        self.handlers.clear()
        self.tokens.clear()

    def declare_token(self, text: str) -> Declared:
        life = self.life
        self.tokens.add(text)

        def undo() -> None:
            self.tokens.discard(text)
            if "/NN/" in text and life == self.life:
                self._judge.receive_close()

        return Declared(undo)

    def declare_queryable(self, key: str, handler: Callable[[Any], None], complete: bool) -> Declared:
        return self.declare_subscriber(key, handler)

    def declare_subscriber(self, key: str, handler: Callable[[Any], None], **options: Any) -> Declared:
        of_tokens = options.get("history") is True
        if "*" in key and not of_tokens:
            raise Wrong(f"messages of a wrong type or hash would be accepted on {key}")
        name = TOKENS if of_tokens else below(key)
        self.handlers[name] = handler
        return Declared(lambda: self.handlers.pop(name) if self.handlers.get(name) == handler else None)

    def declare_publisher(self, key: str, **_: Any) -> Declared:
        name, life = below(key), self.life

        def put(data: bytes) -> None:
            if life != self.life:
                return
            self.published[name] += 1
            if form := JUDGED.get(name.rpartition("/")[2]):
                message = self.latest[name] = deserialize(data, form, TYPES)
                self._judge.receive_message(name, message)
                if name == "rosout":
                    self.said.append(message.msg)

        return Declared(lambda: None, put)


def below(key: str) -> str:
    return "/".join(key.split("/")[2:-2]) or key.split("/")[1]
