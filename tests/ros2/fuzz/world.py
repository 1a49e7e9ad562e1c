"""The bridge in one thread with a clock of its own, its daemon and its network; a judge sees everything."""

import json
import math
from collections import Counter, deque
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, cast

import zenoh

from hyperbit.controller.network.client import Client, Unanswered
from hyperbit.controller.network.listener import Listener, ReceivedMessage
from hyperbit.controller.ros2.answers import Sending
from hyperbit.controller.ros2.arm_node import Settings
from hyperbit.controller.ros2.bridge import Bridge
from hyperbit.controller.ros2.goal_book import GoalBook
from hyperbit.controller.ros2.wire.session import Session
from tests.ros2.fuzz import places
from tests.ros2.fuzz.daemon import Daemon
from tests.ros2.fuzz.inputs import ENDINGS, KINDS, Input, Inputs, payloads
from tests.ros2.fuzz.network import TOKENS, Network, Query, Sample, TokenSample, strict_json
from tests.ros2.fuzz.stand_ins import Clock, Killed, Pool, Trial
from tests.ros2.judge.actions import Wrong
from tests.ros2.judge.asks import Ask
from tests.ros2.judge.judge import Judge
from tests.ros2.judge.reader import Arm
from tests.ros2.samples import chain

BATCH = 40  # messages of ROS 2 between two turns of the bridge's loop
STEP = 0.01  # [s] between two messages, on average
ZERO_ID = b"ros2-" + b"00" * 16
TOKENS_SEEN = 0.3  # share of the turns in which a stranger's token comes or goes
LOOKS = 0.03  # share of the turns after which the bridge's tables are counted
KILLS = 0.0005  # share of the requests and replies at which the bridge is killed
RESTS = 0.01  # share of the turns after which nobody asks for anything, and the daemon answers all, for REST [s]
REST = 40.0
CROWDED = 0.02  # share of the turns after which the threads for motion hang, for CROWD [s]
CROWD = 6.0
MOTION = "ros2"  # name of the threads for motion


class World:
    """Runs the bridge's own loop; is its listener, which delivers the inputs, and its client of the daemon.

    Attributes:
        counts: of inputs by what followed first, and of sentences and nodes.
        largest: greatest number of entries in all tables of the bridge.
    """

    def __init__(self, inputs: Inputs, folder: Path) -> None:
        self.inputs, self.chance, self.clock = inputs, inputs.chance, Clock()
        oriented = bool(self.chance.random() < 0.5)
        arm = Arm(("world", "planar16/0"), ("tip_x", "tip_y"), tuple(chain().actuators), oriented)
        kinds = {name: kind for name, (kind, _) in KINDS.items()}
        self.judge = Judge(arm, kinds, self.clock.monotonic, self.clock.time)
        self.network = Network(self.judge)
        self.waiting = deque[tuple[str, bytes, bool]]()
        self.daemon = Daemon(self.chance, self.clock, lambda key, data: self.waiting.append((key, data, True)))
        self.pools: list[Pool] = []
        self.trial: Trial | None = None
        self.counts: Counter[str] = Counter()
        self.largest, self.kills = 0, 0
        self._left, self._rests_until, self._crowded_until = 0, -math.inf, -math.inf
        self._at_rest = self.faulty = False
        self._heard: list[tuple[str, bytes]] = []
        self._folder, self._settings = folder, Settings("", 0, "jazzy", "world", oriented)
        self._begin()

    def _begin(self) -> None:
        session, client, listener = cast("Session", self.network), cast("Client", self), cast("Listener", self)
        self.book = GoalBook(self._folder / "goals.json")
        self.bridge = Bridge(listener, client, session, self.book, self._settings)

    def run(self, messages: int) -> None:
        with self.in_place():
            self._left, self.faulty = messages, True
            while self._left > 0:
                try:
                    self.bridge.run(lambda: self._left <= 0, lambda: None)
                except Killed:
                    self.restart()
            self.rest()
            self.bridge.close()
        if any(it.accepted != it.ended for it in self.judge.actions.values()):
            raise Wrong("not each accepted goal has ended")
        if self.network.tokens:
            raise Wrong(f"tokens of an ended bridge are there: {self.network.tokens}")

    def rest(self) -> None:
        self.faulty = False
        self._rests_until = self.clock.now + REST
        self.hear("alive", b"")
        self.bridge.run(lambda: self.clock.now > self._rests_until, lambda: None)
        self.judge.check_rest()

    def in_place(self) -> AbstractContextManager[None]:
        pool = lambda _, name: Pool(name, self.pools, lambda: self.trial)  # noqa: E731
        run_others = lambda: self.run_jobs(but=MOTION)  # noqa: E731
        return places.in_place(self.chance, self.clock, pool, run_others, lambda _: self._note("said"))

    def kill(self) -> None:
        self.kills += 1
        self.book._path = self._folder / "dead.json"
        self.network.kill()
        self.pools.clear()
        self.judge.receive_kill()

    def restart(self) -> None:
        self.trial = None
        self._begin()
        self.waiting.clear()
        self.ask()

    def reopen(self) -> None:
        """Lets the bridge show the arm again."""
        with self.in_place():
            self.ask()
            self.hear(*self.waiting.popleft()[:2])

    def hear(self, key: str, data: bytes) -> None:
        self._heard.append((key, data))
        self.bridge.run(lambda: not self._heard, lambda: None)

    def ask(self) -> None:
        self.waiting.append(("arm", json.dumps(payloads()["arm"]).encode(), True))

    def receive_messages(self, timeout: float) -> list[ReceivedMessage]:
        if self._heard:
            key, data = self._heard.pop()
            self.judge.receive_told(key, data, sure=False)
            return [ReceivedMessage(0, key, data)]
        self.judge.end_turn(there=bool(self.network.handlers))
        if self.clock.now < self._rests_until:
            self.clock.sleep(0.2)
            self.run_jobs()
        else:
            self._pass_turn()
        self.daemon.pass_time()
        taken = list(self.waiting)
        self.waiting.clear()
        for key, data, sure in taken:
            self.judge.receive_told(key, data, sure=sure)
        self.counts["daemon's"] += len(taken)
        if self.chance.random() < LOOKS:
            self.largest = max(self.largest, places.entries(self.bridge))
        return [ReceivedMessage(0, key, data) for key, data, _ in taken]

    def _pass_turn(self) -> None:
        if self._at_rest:
            self.judge.check_rest()
            self._at_rest, self.faulty = False, True
        for _ in range(BATCH if self.network.handlers else 0):
            self.clock.sleep(self.chance.random() * 2 * STEP)
            self.deliver(self.inputs.message(self.clock.time()))
            but = MOTION if self.clock.now < self._crowded_until else ""
            while any(pool.jobs for pool in self.pools if pool.name != but) and self.chance.random() < 0.7:
                self._run_job(but)
        self.run_jobs(but=MOTION)
        if self.network.handlers and self.chance.random() < TOKENS_SEEN:
            token = self.inputs.token(sorted(self.network.tokens))
            kind = self.chance.choice((zenoh.SampleKind.PUT, zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE))
            self.network.handlers[TOKENS](cast("Any", TokenSample(token, kind)))
            self.counts["tokens"] += 1
        for _ in range(int(self.chance.random() * 3)):
            key, data, sure = self.inputs.daemon_message()
            if key == "arm" and self.chance.random() < 0.9:
                continue
            self.waiting.append((key, data.replace(ZERO_ID, (self.daemon.goal or "").encode()), sure))
            if key == "arm":
                self.ask()
        if self.chance.random() < CROWDED:
            self._crowded_until = self.clock.now + CROWD
        if self.chance.random() < RESTS:
            self._rests_until, self._at_rest, self.faulty = self.clock.now + REST, True, False
            self.waiting.append(("alive", b"", True))
            self.ask()

    def request(self, key: str, payload: Mapping[str, Any] | None, timeout: float, sending: Sending) -> Any:
        payload, chance = payload or {}, self.chance
        strict_json(payload)
        self._interrupt()
        with sending():
            ask = self.judge.receive_request(key, payload)
            self._note(key)
        answer, sure, fate = None, True, chance.random() if self.faulty else 1.0
        if fate > 0.02:
            try:
                answer = json.loads(json.dumps(self.daemon.request(key, payload)))
            except Unanswered:
                fate = 0.0
        elif key == "goal" and chance.random() < 0.7:
            self.daemon.receive_late(payload)
        if 0.04 < fate < 0.08:
            answer, sure = self.inputs.spoiled(answer), False
        self._interrupt()
        if fate < 0.04:
            self.clock.sleep(0.2)
            answer = None
        self.judge.receive_answer(key, payload, ask, answer, sure=sure)
        if fate < 0.04:
            raise chance.choice((Unanswered("no daemon"), zenoh.ZError("closed")))
        return answer

    def put(self, key: str, payload: bytes) -> None:
        self._note(key)
        self.judge.receive_setpoint(json.loads(payload, parse_constant=lambda text: math.nan))

    def _interrupt(self) -> None:
        """Kills the bridge, or delivers a request that ends motion, while another request is under way."""
        if self.faulty and self.chance.random() < KILLS:
            self.kill()
            raise Killed
        if self.faulty and self.network.handlers and self.chance.random() < 0.05:
            trial, given = self.trial, self.inputs.message(self.clock.time())
            if given.name in ENDINGS:
                self.deliver(given)
            self.trial = trial

    def deliver(self, given: Input) -> list[bytes]:
        """Delivers a message of ROS 2; returns the list that receives the reply. Raises Wrong if it is lost."""
        handler = self.network.handlers.get(given.name)
        if handler is None:
            raise Wrong(f"nobody listens on {given.name}")
        self._left -= 1
        counts: Counter[str] = handler.__self__.dropped  # type: ignore[attr-defined]
        before, replies = counts.total(), list[bytes]()
        ask = self.judge.receive(given.name, given.payload, given.attachment)
        if ask.service:
            life, delivering = self.network.life, True

            def reply(data: bytes) -> None:
                if delivering and counts.total() > before:  # a dropped request is declined
                    replies.append(data)
                else:
                    self.on_reply(life, ask, replies, data)

            handler(Query(given.payload, given.attachment, reply))
            trial, delivering = None, False
        else:
            trial = self.trial = Trial(given)
            attachment = None if given.attachment is None else zenoh.ZBytes(given.attachment)
            handler(Sample(zenoh.ZBytes(given.payload), attachment))
        self.trial = None
        if counts.total() > before:
            self.judge.receive_drop(ask, given.attachment)
            self.counts["dropped"] += 1
        elif trial:
            self._judge(trial)
        if counts["callback"]:
            raise Wrong(f"the callback of {given.name} failed")
        return replies

    def on_reply(self, life: int, ask: Ask, replies: list[bytes], data: bytes) -> None:
        if life != self.network.life:
            return
        kill = self.chance.random() if self.faulty else 1.0
        if kill > KILLS:
            self.counts["replied"] += 1
            replies.append(data)
            self.judge.receive_reply(ask, data)
        if kill < 2 * KILLS:
            self.kill()
            raise Killed

    def run_jobs(self, but: str = "") -> None:
        while any(pool.jobs for pool in self.pools if pool.name != but):
            self._run_job(but)

    def _run_job(self, but: str = "") -> None:
        pool = self.chance.choice([pool for pool in self.pools if pool.jobs and pool.name != but])
        job, trial = pool.jobs.popleft()
        before, self.trial = self.trial, trial
        job()
        self.trial = before
        if trial:
            trial.jobs -= 1
            self._judge(trial)

    def _judge(self, trial: Trial) -> None:
        if trial.jobs:
            return
        if not trial.outcomes:
            raise Wrong(f"nothing followed from {trial.input}")
        self.counts[trial.outcomes[0]] += 1

    def _note(self, outcome: str) -> None:
        if self.trial:
            self.trial.outcomes.append(outcome)
