"""A whole daemon under load: goals at 50 Hz and setpoints at 200 Hz through Zenoh, to simulated boards and back.

Daemon, boards, client and a listener that counts switches share one process. In every ten seconds goals come for seven;
the last is left to be reached, then what the setpoints say is followed. Within the seven, the stream pauses now and
then, so that a new one begins, and takes the arm from the goals until the next of them, 20 ms later.
"""

import json
import socket
import sqlite3
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
import zenoh
from numpy.typing import NDArray

from controller.config import Arm
from controller.daemon import session
from controller.daemon.client import Client, decoded
from controller.daemon.service import Daemon, embedded, running, simulated, timing_of, wiring_of
from controller.workspace.densities import Densities
from tests.daemon.waiting import eventually
from tests.soak.counting import SwitchCounter
from tests.soak.measuring import Memory, Periods

GOAL_EVERY, SETPOINT_EVERY = 1 / 50, 1 / 200  # [s]
CYCLE, GOALS_FOR = 10.0, 7.0  # [s]
STREAM_EVERY, STREAM_FOR = 1.2, 0.9  # [s] while goals come
REST_FROM, REST_TO = 6.7, 8.0  # [s] of a cycle, in which no setpoints come, so that the last goal is reached
POSITIONS = 500


class Answers:
    """What the daemon said of each goal, counted where it does not grow."""

    def __init__(self, most: int) -> None:
        self.put, self.asked = np.zeros(most, dtype=bool), np.zeros(most, dtype=bool)
        self.replies, self.accepted, self.results = (np.zeros(most, dtype=np.int32) for _ in range(3))
        self.nameless = self.switches = 0
        self.statuses: Counter[str] = Counter()
        self.most_waiting: Counter[str] = Counter()
        self.aborted: list[str] = []
        self.mode = ""
        self.followed = False  # whether setpoints have switched actuators
        self.diagnostics: dict[str, Any] = {}
        self.told = 0

    def reply(self, goal: int) -> Callable[[zenoh.Reply], None]:
        def take(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                self.accepted[goal] += decoded(reply.ok)["accepted"]
                self.replies[goal] += 1

        return take

    def result(self, message: dict[str, Any]) -> None:
        self.statuses[message["status"]] += 1
        if message["status"] == "aborted" and len(self.aborted) < 10:
            self.aborted.append(message["message"])
        if message["id"] is None:
            self.nameless += 1
        else:
            self.results[int(message["id"])] += 1
            self.switches += message.get("switches", 0)

    def diagnose(self, message: dict[str, Any]) -> None:
        self.diagnostics, self.told = message, self.told + 1
        self.followed |= self.open == 0 and message["switches"] > self.switches
        for queue, waiting in message["queues"].items():
            self.most_waiting[queue] = max(self.most_waiting[queue], waiting)

    def state(self, message: dict[str, Any]) -> None:
        self.mode = message["mode"]

    @property
    def complete(self) -> bool:
        """Whether goals have succeeded and been refused, and setpoints were followed."""
        return self.followed and self.statuses["succeeded"] > 0 and self.statuses["refused"] > 0

    @property
    def open(self) -> int:
        """Goals that still lack an answer or a result."""
        unanswered = np.sum(self.asked & (self.replies == 0)) + np.sum(self.put & (self.results == 0)) - self.nameless
        return int(unanswered + np.sum(self.accepted > self.results))


class Load:
    """Sends goals and setpoints as time goes by."""

    def __init__(self, opened: zenoh.Session, arm: Arm, answers: Answers) -> None:
        self._prefix, self._answers = f"hyperbit/{arm.settings.name}", answers
        self._session, self._tolerance = opened, arm.tolerance
        states = np.random.default_rng(50).integers(0, arm.manipulator.states, (POSITIONS, len(arm.manipulator.states)))
        self._tips = arm.manipulator.tips(states)[:, :2, 3].tolist()
        self._setpoints = opened.declare_publisher(f"{self._prefix}/setpoint")
        self.goals = self.setpoints = 0

    def goal(self, k: int, last: bool) -> None:
        """Sends goal k: single poses, lines of waypoints, a few that are to be refused; every fourth as a put."""
        count = 4 if last or k % 10 == 9 else 1
        near = self._tips[k % POSITIONS] if not last else self._tips[0]
        points = [{"t": 0.12 * n, "position": near if n % 2 == 0 else self._tips[1]} for n in range(count)]
        if k % 97 == 3:
            points[0]["position"] = [50.0, 50.0]  # out of reach
        if k % 101 == 7:
            points = []  # malformed
        payload = json.dumps({"id": str(k), "waypoints": points}).encode()
        if k % 4 == 3:
            self._answers.put[k] = True
            block = zenoh.CongestionControl.BLOCK
            self._session.put(f"{self._prefix}/goal", payload, congestion_control=block)
        else:
            self._answers.asked[k] = True
            self._session.get(f"{self._prefix}/goal", self._answers.reply(k), payload=payload, timeout=60)

    def send_goals(self, going: Callable[[float], bool]) -> None:
        """Sends goals as long as `going` returns true."""
        for t in paced(GOAL_EVERY, going):
            if t % CYCLE < GOALS_FOR:
                self.goal(self.goals, last=t % CYCLE >= GOALS_FOR - GOAL_EVERY)
                self.goals += 1

    def send_setpoints(self, going: Callable[[float], bool]) -> None:
        """Sends setpoints as long as `going` returns true."""
        for t in paced(SETPOINT_EVERY, going):
            within = t % CYCLE
            if not REST_FROM <= within < REST_TO and (within > GOALS_FOR or within % STREAM_EVERY < STREAM_FOR):
                position = [0.5 + 0.2 * np.sin(t), 2.8 - 0.1 * (1 - np.cos(t))]
                self._setpoints.put(json.dumps({"position": position, "stamp": time.time()}))
                self.setpoints += 1


def paced(every: float, going: Callable[[float], bool]) -> Iterator[float]:
    """Gives the time since the begin at even intervals, as long as `going` of it is true; late ones are dropped."""
    began = time.monotonic()
    while going(t := time.monotonic() - began):
        yield t
        time.sleep(max(every - (time.monotonic() - began) % every, 0.0))


@contextmanager
def listening(bus: can.BusABC, counter: SwitchCounter) -> Iterator[None]:
    """Has the counter take every frame on the bus while the context lasts, and all that wait at its end."""
    over = threading.Event()

    def listen() -> None:
        while (message := bus.recv(0.05)) is not None or not over.is_set():
            if message is not None:
                counter.take(message.arbitration_id, bytes(message.data))

    thread = threading.Thread(target=listen, name="listener")
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def soaked(arm: Arm, densities: Densities, seconds: float, longest: float = 0.0) -> dict[str, Any]:
    """Runs a daemon under load; returns the figures.

    Args:
        arm: to be driven.
        densities: of the arm.
        seconds: shortest duration of the load [s].
        longest: duration [s] after which the load ends although answers are not yet complete.

    Raises:
        AssertionError: something was lost, doubled or miscounted.
    """
    # Boards that share processor and interpreter with all else here are not to be given up, however late they are.
    timing = replace(timing_of(arm), heartbeat_timeout=20.0, settle_margin=10.0)
    wiring = embedded(wiring_of(arm))
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    answers = Answers(int(max(seconds, longest) / GOAL_EVERY) + 100)
    counter = SwitchCounter([(entry.node, entry.output) for entry in arm.wiring])
    with tempfile.TemporaryDirectory() as folder:
        ledger = Path(folder) / "ledger.sqlite"
        with ExitStack() as stack:
            bus = stack.enter_context(can.Bus(interface="virtual", channel=wiring.buses[0].channel))
            stack.enter_context(listening(bus, counter))
            boards = stack.enter_context(simulated(wiring, timing))
            config = session.configuration("peer", listen=endpoint)
            stack.enter_context(running(Daemon(arm, densities, wiring, config, ledger, timing)))
            opened = stack.enter_context(zenoh.open(session.configuration("client", connect=endpoint)))
            load, figures = loaded(opened, arm, answers, seconds, longest)
        return {**figures, **checked(arm, answers, load, counter, boards.switches(), ledger)}


def loaded(
    opened: zenoh.Session, arm: Arm, answers: Answers, seconds: float, longest: float
) -> tuple[Load, dict[str, Any]]:
    """Loads a daemon, and waits until it has answered everything and is ready; see `soaked`."""
    client, load = Client(opened, arm.settings.name), Load(opened, arm, answers)
    takers = {"result": answers.result, "diagnostics": answers.diagnose, "state": answers.state}
    subscribers = [client.subscribe(key, take) for key, take in takers.items()]
    eventually(lambda: answers.mode == "ready", 60)
    longest = max(seconds, longest)
    memory = Memory(int(longest) + 60)

    def going(t: float) -> bool:
        return t < seconds or (t < longest and not answers.complete)

    with Periods(int(110 * longest) + 1000) as periods:
        senders = [threading.Thread(target=send, args=(going,)) for send in (load.send_goals, load.send_setpoints)]
        for sender in senders:
            sender.start()
        while any(sender.is_alive() for sender in senders):
            memory.sample()
            time.sleep(1.0)
        figures = {"seconds": seconds, "period": periods.figures(), "memory": memory.end()}
    eventually(lambda: answers.open == 0 and answers.mode == "ready", 60)
    told = answers.told
    eventually(lambda: answers.told > told + 1)
    for subscriber in subscribers:
        subscriber.undeclare()
    return load, figures


def checked(
    arm: Arm, answers: Answers, load: Load, counter: SwitchCounter, driven: NDArray[np.int64], ledger: Path
) -> dict[str, Any]:
    """Compares what the daemon said, what its ledger holds, what was on the bus and what the boards did."""
    assert np.all(answers.replies[answers.asked] == 1), "each goal that was asked is answered once"
    assert np.all(answers.results[answers.asked] == answers.accepted[answers.asked]), (
        "each accepted goal has one result"
    )
    assert np.sum(answers.results[answers.put] == 0) == answers.nameless, "each goal that was put is told of once"
    assert answers.results.max() <= 1, "no goal has two results"
    assert answers.open == 0
    with closing(sqlite3.connect(ledger)) as book:
        counts = dict(book.execute("SELECT actuator, count FROM switches").fetchall())
        rows = Counter(dict(book.execute("SELECT status, count(*) FROM goals GROUP BY status").fetchall()))
    ended = answers.statuses - Counter({"refused": answers.statuses["refused"]})
    assert rows == ended, f"the ledger has {rows}, the results told are {ended}"
    written = np.array([counts.get(label, 0) for label in arm.manipulator.actuators])
    assert np.array_equal(written, counter.counts), "the ledger holds the switches that were on the bus"
    assert np.array_equal(driven, counter.counts), "the boards switched what was on the bus"
    assert answers.diagnostics["switches"] == written.sum()
    for queue, bound in {"inbox": 300, "outbox": 1000, "planning": 16}.items():
        assert answers.most_waiting[queue] <= bound, f"{answers.most_waiting[queue]} waited in {queue}"
    return {
        "goals": load.goals,
        "setpoints": load.setpoints,
        "setpoints_received": answers.diagnostics["setpoint"]["received"],
        "accepted": int(sum(ended.values())),
        "results": dict(answers.statuses),
        "aborted": answers.aborted,
        "switches": int(written.sum()),
        "switches_following": int(written.sum()) - answers.switches,
        "syncs": counter.syncs,
        "most_waiting": dict(answers.most_waiting),
    }
