"""The bridge in one thread with a clock of its own, its daemon and its network; a judge sees everything."""

import contextlib
import json
import logging
import math
import random
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import zenoh

from hyperbit.controller.network.client import Client, Unanswered
from hyperbit.controller.network.listener import Listener, ReceivedMessage
from hyperbit.controller.ros2.answers import Sending
from hyperbit.controller.ros2.arm_node import Settings
from hyperbit.controller.ros2.bridge import Bridge
from hyperbit.controller.ros2.goal_book import GoalBook
from hyperbit.controller.ros2.poses import Place
from hyperbit.controller.ros2.wire import attachments
from hyperbit.controller.ros2.wire.attachments import BadAttachment
from hyperbit.controller.ros2.wire.cdr import BadMessage, deserialize, serialize
from hyperbit.controller.ros2.wire.session import Session
from tests import told
from tests.fuzz.mutations import VALUES
from tests.ros2.world.account import Ask, Wrong
from tests.ros2.world.daemon import Daemon
from tests.ros2.world.inputs import ENDINGS, KINDS, NO_GOAL, TYPES, Input, Inputs
from tests.ros2.world.judge import Judge
from tests.ros2.world.motion import Arm
from tests.ros2.world.network import MOTION, TOKENS, Clock, Killed, Network, Query, Sample, Threads, TokenSample

BATCH = 40  # messages of ROS 2 between two turns of the bridge's loop
STEP = 0.01  # [s] between two messages, on average
TURN = 0.5  # [s] between two turns in a scenario, and at rest
TOKENS_SEEN = 0.3  # share of the turns in which a stranger's token comes or goes
LOOKS = 0.03  # share of the turns after which the bridge's tables are counted
KILLS = 0.0005  # share of the requests and replies at which the bridge is killed
RESTS, REST = 0.01, 40.0  # share of the turns after which nobody asks for anything, and the daemon answers all, for [s]
CROWDED, CROWD = 0.02, 6.0  # share of the turns after which the threads for motion hang, for [s]
LOG = logging.getLogger("hyperbit.controller.ros2")


class World(logging.Handler):
    """The bridge's listener, and its client of the daemon.

    Attributes:
        counts: of inputs, replies and kills.
        measured: tips that the bridge has forwarded.
        largest: greatest number of entries in all tables of the bridge.

    Args:
        seed: of a random world; None: a scenario says what happens.
    """

    def __init__(self, folder: Path, seed: int | None = None) -> None:
        super().__init__(logging.WARNING)
        self.chance, self.clock = random.Random(seed or 0), Clock()
        oriented = seed is not None and self.chance.random() < 0.5
        self.inputs = None if seed is None else Inputs(self.chance)
        arm = Arm(Place("world", "planar16", np.eye(4), 2), told.arm().manipulator, oriented)
        self.judge = Judge(arm, {name: kind for name, (kind, _) in KINDS.items()}, self.clock, self.clock.time)
        self.threads = Threads(self.chance, self.clock)
        self.network = Network(self.judge, self.threads.computer)
        self._told = deque[tuple[str, bytes, bool]]()
        chance = None if seed is None else self.chance
        self.daemon = Daemon(chance, self.clock, lambda key, data: self._told.append((key, data, True)))
        self.counts: Counter[str] = Counter()
        self.measured = list[dict[str, Any]]()
        self.largest, self.faulty, self.kill_at_reply = 0, False, False
        self._crowded_until, self._failure = -math.inf, ""
        self._book, self._settings = folder / "goals.json", Settings("", 0, "jazzy", "world", oriented)
        self._kept: bytes | None = None
        self.book_kind = GoalBook
        self.begin()

    def begin(self) -> None:
        """Starts the bridge. It shows the arm once it hears of it."""
        if self._kept is not None:
            self._book.write_bytes(self._kept)  # what a killed bridge writes after its death is not there
        self._kept = None
        book = self.book_kind(self._book, self.clock)
        session, client, listener = cast("Session", self.network), cast("Client", self), cast("Listener", self)
        self.bridge = Bridge(listener, client, session, book, self._settings)
        self._told.clear()
        self.ask()

    # The bridge's listener and client.

    def ask(self) -> None:
        self._told.append(("arm", json.dumps(told.described()).encode(), True))

    def receive_messages(self, timeout: float) -> list[ReceivedMessage]:
        heard = list(self._told)
        self._told.clear()
        for key, data, sure in heard:
            self.judge.receive_told(key, data, sure=sure)
        return [ReceivedMessage(0, key, data) for key, data, _ in heard]

    def request(self, key: str, payload: Mapping[str, Any] | None, timeout: float, sending: Sending) -> Any:
        payload, chance = payload or {}, self.chance
        strict_json(payload)
        self._interrupt()
        with sending():
            ask = self.judge.receive_request(key, payload)
        answer, sure, fate = None, key not in self.daemon.junk, chance.random() if self.faulty else 1.0
        if fate > 0.02:
            try:
                answer = json.loads(json.dumps(self.daemon.request(key, payload)))
            except Unanswered:
                fate = 0.0
        elif key == "goal" and chance.random() < 0.7:
            self.daemon.receive_late(payload)
        if 0.04 < fate < 0.08 and isinstance(answer, dict):  # no answer of the daemon's form
            spoiled = {name: chance.choice(VALUES[5:20]) for name in (*answer, "accepted", "result", "travel_time")}
            answer, sure = chance.choice((spoiled, [])), False
        self._interrupt()
        if fate < 0.04:
            self.clock.sleep(0.2)
            answer = None
        self.judge.receive_answer(key, payload, ask, answer, sure=sure)
        if fate < 0.04:
            raise chance.choice((Unanswered("no daemon"), zenoh.ZError("closed")))
        return answer

    def put(self, key: str, payload: bytes) -> None:
        value = json.loads(payload, parse_constant=lambda text: math.nan)
        if key == "measured_tip":  # moves nothing
            self.measured.append(value)
        else:
            self.judge.receive_setpoint(value)

    # The words of scenarios.

    def turn(self) -> None:
        """Lets the bridge's loop run once; it hears what the daemon has told."""
        self.judge.check_turn(there=bool(self.network.handlers))
        ending = iter((False, True))
        with self._logged():
            self.bridge.run(lambda: next(ending), lambda: None)

    def hear(self, key: str, data: Any, *, sure: bool = True) -> None:
        """Lets the bridge hear a message of the daemon; `data` is JSON, or bytes."""
        self._told.append((key, data if isinstance(data, bytes) else json.dumps(data).encode(), sure))
        self.turn()

    def turns(self, seconds: float, but: str = "") -> None:
        """Lets the bridge run; the threads of one pool may hang."""
        for _ in range(round(seconds / TURN)):
            self.clock.sleep(TURN)
            self.turn()
            self.threads.run(but)

    def call(self, name: str, *, run: bool = True, **fields: Any) -> list[Any]:
        """Delivers a message with these fields; returns the list that receives the reply."""
        replies = self.deliver(Input(name, serialize(fields, KINDS[name][1], TYPES)))
        if run:
            self.threads.run()
        return replies

    def kill(self) -> None:
        self.counts["kills"] += 1
        self._kept = self._book.read_bytes() if self._book.exists() else b"[]"
        self.network.kill()
        self.threads.pools.clear()
        self.judge.receive_kill()

    def restart(self) -> None:
        """Starts a bridge after a kill, or after an end in order, and lets it show the arm."""
        if self._kept is None:
            self.bridge.close()
        self.begin()
        self.turn()

    def deliver(self, given: Input) -> list[Any]:
        """Delivers a message of ROS 2; returns the list that receives the reply. Raises Wrong if it is lost."""
        handler = self.network.handlers.get(given.name)
        if handler is None:
            raise Wrong(f"nobody listens on {given.name}")
        form, dropped = KINDS[given.name][1], cast("Any", handler).__self__.dropped
        before, replies = Counter(dropped), list[Any]()
        try:
            attachments.parse(given.attachment)
            message = deserialize(given.payload, form, TYPES)
        except (BadAttachment, BadMessage):
            message = None
        ask = self.judge.receive(given.name, message)
        life, delivering = self.network.life, True

        def reply(data: bytes) -> None:
            answer = deserialize(data, form.replace("_Request", "_Response"), TYPES)
            if delivering and dropped != before:  # a dropped request is declined
                replies.append(answer)
            else:
                self._reply(life, ask, replies, answer)

        with self._logged():
            if ask.service:
                handler(Query(given.payload, given.attachment, reply))
            else:
                attachment = None if given.attachment is None else zenoh.ZBytes(given.attachment)
                handler(Sample(zenoh.ZBytes(given.payload), attachment))
        delivering = False
        for reason in dropped - before:
            self.judge.receive_drop(ask, reason)
            self.counts["dropped"] += 1
        if message is None and dropped == before:
            raise Wrong(f"what cannot be read on {given.name} is not dropped")
        return replies

    def _reply(self, life: int, ask: Ask, replies: list[Any], answer: Any) -> None:
        if life != self.network.life:
            return
        kill = 0.0 if self.kill_at_reply else self.chance.random() if self.faulty else 1.0
        if kill > KILLS:
            self.counts["replied"] += 1
            replies.append(answer)
            self.judge.receive_reply(ask, answer)
        if kill < 2 * KILLS:
            self.kill()
            raise Killed

    # A random life.

    def run(self, messages: int) -> None:
        """Lets a random world deliver this many messages, then come to rest and end."""
        assert self.inputs
        last = self.counts["messages"] + messages
        while self.counts["messages"] < last:
            try:
                self.faulty = True
                self._pass_turn(self.inputs)
                if self.chance.random() < RESTS:
                    self._rest()
            except Killed:
                self.begin()
        self._rest()
        self.bridge.close()
        if self.judge.accepted != self.judge.ended:
            raise Wrong("not each accepted goal has ended")
        if self.network.tokens:
            raise Wrong(f"tokens of an ended bridge are there: {self.network.tokens}")

    def _rest(self) -> None:
        """Nobody asks for anything for a while, and the daemon answers all."""
        self.faulty = False
        self._told.append(("alive", b"", True))
        self.ask()
        until = self.clock.now + REST
        while self.clock.now < until:
            self.clock.sleep(TURN)
            self.threads.run()
            self.daemon.pass_time()
            self.turn()
        self.judge.check_rest()

    def _pass_turn(self, inputs: Inputs) -> None:
        chance, there = self.chance, bool(self.network.handlers)
        for _ in range(BATCH if there else 0):
            self.clock.sleep(chance.random() * 2 * STEP)
            self.counts["messages"] += 1
            self.deliver(inputs.message(self.clock.time()))
            self.threads.run(MOTION if self.clock.now < self._crowded_until else "", share=0.7)
        self.threads.run(but=MOTION)
        if there and chance.random() < TOKENS_SEEN:
            kind = chance.choice((zenoh.SampleKind.PUT, zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE))
            self.network.handlers[TOKENS](TokenSample(inputs.token(sorted(self.network.tokens)), kind))
        for _ in range(chance.randrange(3)):
            key, data, sure = inputs.daemon_message()
            if key == "arm" and chance.random() < 0.9:
                continue
            self._told.append((key, data.replace(NO_GOAL.encode(), (self.daemon.goal or "").encode()), sure))
            if key == "arm":
                self.ask()
        if chance.random() < CROWDED:
            self._crowded_until = self.clock.now + CROWD
        self.daemon.pass_time()
        self.turn()
        if chance.random() < LOOKS:
            self.largest = max(self.largest, entries(self.bridge))

    def _interrupt(self) -> None:
        """Kills the bridge, or delivers a request that ends motion, while another request is under way."""
        if self.faulty and self.chance.random() < KILLS:
            self.kill()
            raise Killed
        if self.faulty and self.inputs and self.network.handlers and self.chance.random() < 0.05:
            given = self.inputs.message(self.clock.time())
            if given.name in ENDINGS:
                self.deliver(given)

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info and not self._failure:
            self._failure = logging.Formatter().format(record)

    @contextlib.contextmanager
    def _logged(self) -> Iterator[None]:
        """Raises Wrong if the bridge logs an exception; other lines of its log are not printed."""
        LOG.addHandler(self)
        propagate, LOG.propagate = LOG.propagate, False
        try:
            yield
        finally:
            LOG.removeHandler(self)
            LOG.propagate = propagate
        if self._failure:
            raise Wrong(self._failure)


def strict_json(payload: object) -> None:
    """Raises Wrong if a number is none in JSON."""
    try:
        json.dumps(payload, allow_nan=False)
    except (ValueError, TypeError) as error:
        raise Wrong(f"the daemon would be sent {error}: {str(payload)[:300]}") from None


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
        elif type(it).__module__.startswith("hyperbit.controller.ros2") and type(it).__name__ != "Types":
            waiting.extend(vars(it).values() if hasattr(it, "__dict__") else ())
    return total
