"""Clients of the daemon: they ask for motion, stop, change obstacles, stream, repeat, vanish and return."""

from __future__ import annotations

import json
from collections import deque
from random import Random
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperbit.controller.program import unpack
from tests.simulation.statements.asked import body_of, states_from
from tests.simulation.whole.wishes import STATES, Wishes
from tests.simulation.whole.zenoh_model import LATENCY, Sent

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon

ACTS = {
    **{"goal": 40, "jog": 15, "plan": 6, "cancel": 3, "cancel goal": 4, "stop": 0.5, "reset": 2, "degrade": 3},
    **{"obstacles": 6, "arm": 2, "stream": 6, "tip": 10, "garbage": 1, "repeat": 6, "many goals": 0.5, "wait": 10},
    **{"poses": 2.0, "again": 3.0, "flood": 0.08, "crowd": 0.4, "many arms": 0.03},
    **{"burst": 5, "result": 3, "vanish": 1, "same id": 1.5, "many plans": 0.3, "fault": 2.0},
}
ASIDE = {"arm": 4, "plan": 3, "poses": 2, "result": 2, "tip": 5, "garbage": 0.3}  # while the clients wait for a motion
BURSTS = (
    ("reset", "stop"),
    ("stop", "reset", "goal"),
    ("reset", "stop", "goal"),
    ("goal", "stop"),
    ("cancel goal", "same id"),
    ("goal", "cancel goal"),
    ("goal", "cancel goal", "same id"),
    ("goal", "cancel", "goal"),
    ("jog", "stop", "reset"),
    ("stop", "jog", "reset", "jog"),
    ("stop", "reset", "stop"),
    ("cancel", "reset", "cancel", "goal"),
    ("degrade", "goal"),
    ("plan", "cancel goal"),
    ("plan", "plan", "cancel goal"),
    ("obstacles", "goal", "obstacles"),
    ("obstacles", "plan", "stop"),
    ("obstacles", "stop", "plan"),
)
NAMES = {"stop": ("hyperbit/*/stop", "**/hyperbit/*/stop"), "cancel": ("hyperbit/*/cancel",)}
DESCRIPTIONS = (
    b'{"with": ["running"]}',
    b"",
    b'{"with": ["drawing"]}',
    b"\xff",
    b'{"with": "x"}',
)
CLIENTS = 4  # the last one attaches the same bytes to each of its requests
ATTENDED = 0.7  # share of the goals and jogs whose end the clients wait for
ATTENDED_FOR = 2.0  # [s], longest
AT_REST = {"stream": 8, "degrade": 6, "goal": 20, "any": 66}  # if the arm is ready
OUT_OF_CONFIGURATION = {"degrade": 1, "jog": 2, "any": 4}  # if it is in no configuration
HOMING = {"obstacles": 5, "goal": 5, "jog": 2, "any": 5}  # if the next goal homes an actuator
WITHOUT_EXECUTOR = {"stop": 2, "cancel": 2, "reset": 1, "degrade": 1}
RUSH = ("plan", "plan", "plan", "goal", "jog", "obstacles", "degrade", "reset", "arm")
PATIENT = 0.85  # share of what is asked for meanwhile, if the arm takes no goals
UNDISTURBED = 0.7  # share of the streams that nobody disturbs
STANDING = 0.3  # share of the streams whose target stands still
PAUSE = 0.4  # [s] after a stream that nobody disturbs
AWAY = 2.0  # [s], longest time for which a client is away
MOTION = 0.15  # [s], mean time between a motion and its obstacles


class Clients:
    """All clients.

    Attributes:
        calm: they only do what makes the arm ready.
    """

    def __init__(self, daemon: Daemon, random: Random) -> None:
        self.calm, self.wishes = False, Wishes(daemon, random)
        self._daemon, self._agenda, self._random = daemon, daemon.agenda, random
        self._labels = daemon.executed.actuators
        self._prefix = f"hyperbit/{daemon.arm.settings.name}"
        self._attached = 0
        self._client = 0  # that acts now
        self._sent: list[Sent] = []  # the last goals and other requests
        self._goals = deque[Sent](maxlen=40)
        self._streams_until = self._alone_until = 0.0
        self._attended: Sent | None = None  # goal or jog for whose end the clients wait
        self._rate = random.choice([10.0, 20.0, 40.0])
        self._crowd = random.choice([0.0, 0.4, 0.8])  # share of the motions to which obstacles come
        self._agenda.after(1.0, self._act)

    def ask(
        self, key: str, payload: dict[str, Any] | bytes = b"{}", *, query: bool = True, drawn: tuple[str, ...] = ()
    ) -> Sent:
        """Sends a request of the client that acts now; returns it, to which replies are added.

        `drawn`: its possible answers: "accepted", or the reasons of refusals; none: nobody can say.
        """
        data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        name = f"{self._prefix}/{key}"
        if not self.calm and key in NAMES and self._random.random() < 0.1:
            name = self._random.choice(NAMES[key])
        elif not self.calm and self._random.random() < 0.003:
            name = self._random.choice([f"hyperbit/*/{key}", f"hyperbit/*/{key}", "hyperbit/**"])
        sent = self._daemon.zenoh.send(self._client, name, data, self._attachment(key), query)
        sent.drawn = drawn
        self._sent = [*self._sent[-9:], sent]
        if key == "goal":
            self._goals.append(sent)
        return sent

    def _attachment(self, key: str) -> bytes:
        """Returns what the client attaches: clients 0 and 1 a new number, client 2 nothing, client 3 the same bytes."""
        self._attached += 1
        new = b"n%d-%d" % (self._client, self._attached)
        return (new, new, b"", b"c3")[self._client]

    def _repeat(self) -> None:
        """Sends a request again, as a client does that has no answer; perhaps another client, or another attachment."""
        if not self._sent:
            return
        sent = self._random.choice(self._sent)
        attachment = self._random.choice([sent.attachment, sent.attachment, b"", b"other" + sent.payload[-20:]])
        client = self._random.choice([sent.client, sent.client, 1])
        self._daemon.zenoh.send(client, sent.name, sent.payload, attachment, sent.query)

    def _send_again(self) -> None:
        """Sends a goal that has ended again, as a client does that has its goals in a file."""
        old = [sent for sent in self._goals if body_of(sent.payload).get("id") in self._daemon.results]
        if old:
            self.ask("goal", self._random.choice(old).payload)

    def _act(self) -> None:
        if self.calm:
            self._client = 0
            self._make_ready()
            self._agenda.after(0.2, self._act)
            return
        act = self._draw()
        self._client = self._random.randrange(CLIENTS)
        self._do(act)
        if act in ("goal", "jog") and self._random.random() < ATTENDED:
            self._attended = self._sent[-1]
        elif act == "stream" and self._random.random() < UNDISTURBED:
            self._alone_until = self._streams_until + PAUSE
        self._agenda.after(self._random.expovariate(self._rate), self._act)

    def _draw(self) -> str:
        random, state = self._random, self._daemon.state
        mode = "" if state is None else state["mode"]
        halted = mode in ("fault", "stopped")
        if not halted and self._wait():
            return self._one_of(ASIDE)
        codes = set() if state is None else {fault["code"] for fault in state["faults"]}
        if "executor-lost" in codes:
            return self._one_of(WITHOUT_EXECUTOR if random.random() < 0.1 else ASIDE)
        if halted and random.random() < 0.6:
            return "reset"
        if mode not in ("ready", "executing") and random.random() < PATIENT:
            return self._one_of(ASIDE)
        act = "any"
        if "in-obstacle" in codes and random.random() < 0.5:
            return "obstacles"
        if mode == "ready":
            homing = HOMING if "unknown-position" in codes else AT_REST
            act = self._one_of(OUT_OF_CONFIGURATION if "unknown-state" in codes else homing)
        return self._one_of(ACTS) if act == "any" else act

    def _one_of(self, acts: dict[str, float]) -> str:
        return self._random.choices(list(acts), list(acts.values()))[0]

    def rush(self) -> None:
        """Sends some requests in one instant: their answers are not known when the process ends."""
        for act in self._random.sample(RUSH, 5):
            self._client = self._random.randrange(CLIENTS)
            self._do(act)

    def move(self) -> None:
        """Sends a goal, or rarely a jog."""
        self._client = self._random.randrange(CLIENTS)
        self._do(self._random.choice(["goal", "goal", "goal", "jog"]))

    def hurry(self) -> float:
        """Sends a burst, perhaps; returns a time after which some of it has arrived [s]."""
        if self.calm or self._random.random() < 0.5:
            return 0.0
        self._client = self._random.randrange(CLIENTS)
        self._burst()
        return self._random.uniform(0.0, 2 * LATENCY)

    def _wait(self) -> bool:
        """Returns whether the clients wait for the end of a stream, or of a motion that was not refused."""
        if self._agenda.now < self._alone_until:
            return True
        sent = self._attended
        if sent is None or self._agenda.now > sent.at + ATTENDED_FOR:
            return False
        answer = json.loads(sent.replies[0]) if sent.replies else {"accepted": sent.query, "id": None}
        return bool(answer["accepted"]) and answer["id"] not in self._daemon.results

    def _burst(self) -> None:
        """Sends several requests in one instant, of one client or of two in turn."""
        clients = self._random.choice([(self._client,), (self._client, (self._client + 1) % CLIENTS)])
        for k, act in enumerate(self._random.choice(BURSTS)):
            self._client = clients[k % len(clients)]
            self._do(act)

    def _do(self, act: str) -> None:
        random = self._random
        match act:
            case "burst":
                self._burst()
            case "goal":
                self.ask("goal", self.wishes.goal(), query=random.random() < 0.9)
                self._crowd_in(1)
            case "same id":
                self.ask("goal", {**self.wishes.goal(), "id": f"g{self.wishes.numbers - 1}"})
            case "plan":
                self.ask("plan", self.wishes.goal())
            case "jog":
                wait = {"begin_within": random.choice([0.2, 3.0])} if random.random() < 0.2 else {}
                self.ask("jog", {"actuators": self.wishes.some_states(), **wait})
                self._crowd_in(1)
            case "cancel" | "stop" | "reset":
                self.ask(act, query=random.random() < 0.9)
            case "arm":
                self.ask("arm", random.choice(DESCRIPTIONS))
            case "poses":
                self.ask("poses", self.wishes.pose(), query=random.random() < 0.9)
            case "again":
                self._send_again()
            case "flood":
                key, data = random.choice([("goal", b"\xff"), ("goal", b"[1]"), ("obstacles", b"{}"), ("jog", b"")])
                query = random.random() < 0.5
                for _ in range(random.choice([30, 100])):
                    self.ask(key, data, query=query)
            case "crowd":
                for k in range(random.choice([5, 20])):
                    self._daemon.zenoh.send(
                        self._client, f"{self._prefix}/setpoint", self._setpoint(), b"crowd%d" % k, query=False
                    )
            case "many arms":
                for _ in range(130):
                    self.ask("arm", b"")
            case "result":
                ended = [name for name in self._daemon.results if name is not None][-5:]
                last = f"g{max(self.wishes.numbers - random.choice([0, 1, 2, 5]), 0)}"
                self.ask("result", {"id": random.choice(ended) if ended and random.random() < 0.8 else last})
            case "cancel goal":
                back = random.choice([0, 0, 0, 1, 2])
                self.ask("cancel", {"id": f"g{max(self.wishes.numbers - back, 0)}"})
            case "degrade":
                self.ask("degrade", self.wishes.lock())
            case "obstacles":
                self._change_obstacles()
            case "stream":
                self.stream(random.uniform(0.1, 3.0))
                self._crowd_in(3)
            case "tip":
                self._measure()
            case "garbage":
                key = random.choice(["goal", "jog", "plan", "cancel", "degrade", "obstacles", "stop"])
                self.ask(key, random.choice([b"", b"\xff", b"[1]", b'{"waypoints": []}', b'{"id": 5}']))
            case "fault":
                self.ask("fault", {"fault": "silence can0/5"})
            case "repeat":
                self._repeat()
            case "vanish":
                client = self._client
                self._daemon.zenoh.gone.add(client)
                self._agenda.after(random.uniform(0.0, AWAY), lambda: self._return(client))
            case "many goals" | "many plans":
                for _ in range({"many goals": 20, "many plans": 10}[act]):
                    self.ask(act[5:-1], self.wishes.goal())

    def _return(self, client: int) -> None:
        """Lets a client come back; it sends its last goal again if that has no answer, and asks how it ended."""
        self._daemon.zenoh.gone.discard(client)
        mine = [sent for sent in self._sent if sent.client == client and sent.name.endswith("/goal")]
        if self.calm or not mine:
            return
        if not mine[-1].replies:
            self._daemon.zenoh.send(client, mine[-1].name, mine[-1].payload, mine[-1].attachment)
        self._daemon.zenoh.send(client, f"{self._prefix}/result", b'{"id": "g%d"}' % self.wishes.numbers)

    def _crowd_in(self, times: int) -> None:
        """Sends obstacles soon, perhaps: they come while a motion is planned, offered, under way or replaced."""
        random = self._random
        for _ in range(times if random.random() < self._crowd else 0):
            self._agenda.after(random.expovariate(1 / MOTION), self._change_obstacles)

    def _change_obstacles(self) -> None:
        if not self.calm:
            self.ask("obstacles", {"regions": self.wishes.regions()})

    def stream(self, seconds: float) -> None:
        """Sends set-points along a line for a time [s], unless all becomes calm."""
        self._streams_until, calm = self._agenda.now + seconds, self.calm
        random, first, last = self._random, np.array(self.wishes.position()), np.array(self.wishes.position())
        period = random.choice([0.01, 0.03, 0.2])
        last = first if random.random() < STANDING else last
        began, duration, client = self._agenda.now, random.uniform(0.1, 2.0), self._client

        def step() -> None:
            if self._agenda.now > self._streams_until or self.calm > calm:
                return
            share = min((self._agenda.now - began) / duration, 1.0)
            stamp = self._daemon.wall() - random.choice([0.0, 0.0, 0.3]) if random.random() < 0.5 else 0.0
            tolerance = {"position": random.choice([0.01, 0.3])}
            payload = {"position": (first + share * (last - first)).tolist(), "stamp": stamp, "tolerance": tolerance}
            data = json.dumps(payload).encode() if random.random() > 0.01 else b"{}"
            self._daemon.zenoh.send(client, f"{self._prefix}/setpoint", data, b"c%d" % client, query=False)
            self._agenda.after(period, step)

        step()

    def _setpoint(self) -> bytes:
        return json.dumps({"position": self.wishes.position()}).encode()

    def _measure(self) -> None:
        code = -1 if self._daemon.snapshot is None else unpack(self._daemon.snapshot.measured)
        computed = self._daemon.space.tips[self._daemon.space.index.get(code, 0)]
        tip = [float(x) + b + self._random.gauss(0.0, 1e-5) for x, b in zip(computed, self._daemon.offset, strict=True)]
        stamp = self._daemon.wall() - self._random.choice([0.0, 0.001, 0.001, 2.0, -1.0])
        data = json.dumps({"position": tip, "stamp": stamp}).encode()
        self._daemon.zenoh.send(self._client, f"{self._prefix}/measured_tip", data, query=False)

    def _make_ready(self) -> None:
        """Asks for what is needed so that the arm takes a goal."""
        state, snapshot, daemon = self._daemon.state, self._daemon.snapshot, self._daemon
        waiting = daemon.exchange.unanswered
        if snapshot is None or state is None or daemon.process is None or waiting("reset", "degrade"):
            return
        free = unpack(snapshot.locked) & ~daemon.executed.locked
        told = {"in-obstacle", "degraded"} & {fault["code"] for fault in state["faults"]} or not daemon.wanted
        if daemon.exchange.confirmed and told and not waiting("obstacles"):
            self.ask("obstacles", {"regions": []})
        if state["mode"] in ("fault", "stopped"):
            self.ask("reset")
        elif state["mode"] == "executing" and not daemon.wanted:
            self.ask("cancel")
        elif state["mode"] == "ready" and free and told:
            self.ask("degrade", {"actuator": self._labels[(free & -free).bit_length() - 1], "state": None})
        elif (start := states_from(snapshot)) not in daemon.space.index and not waiting("jog"):
            locked = unpack(snapshot.locked)
            labels = [label for k, label in enumerate(self._labels) if not locked >> k & 1]
            code = daemon.space.nearest(start, locked)
            states = {label: STATES[code >> self._labels.index(label) & 1] for label in labels}
            self.ask("jog", {"actuators": states})
