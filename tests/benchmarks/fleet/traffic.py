"""Clients that send goals to many arms, and follow each goal to its end."""

import threading
import time
import uuid
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import zenoh

from hyperbit.controller.decoding.decoding import decode
from hyperbit.controller.network.client import Client, Unanswered
from tests.benchmarks.fleet.plant import PATIENCE, Plant

EVERY = 1.0  # [s] between the goals of an arm
NOT_RECEIVED = "not received"  # the daemon has not answered, and does not know the goal
ASK = 5.0  # [s] without a result, after which a client asks for it
Place = list[float]


class Sent(NamedTuple):
    arm: str
    id: str
    answered: float
    ended: float
    status: str


class Traffic:
    """Goals for each arm from several clients, at a steady rate as long as the arm keeps up.

    Attributes:
        sent: goals whose end is known, or that were refused.
        results: how often a result of each goal was published, without repetitions after a kill.

    Args:
        places: that the arms go to in turn, shape (n, 2).
        clients: sessions; an arm's goals all come from one.
    """

    def __init__(self, plant: Plant, places: Sequence[Place], clients: int = 5) -> None:
        self._places, self.sent, self.unknown = places, list[Sent](), list[str]()
        self._sessions = [plant.session() for _ in range(clients)]
        self._results: dict[str, tuple[float, dict[str, Any]]] = {}
        self.results: Counter[str] = Counter()
        self._changed, self._ended = threading.Condition(), threading.Event()
        self._hearing = self._sessions[0].declare_subscriber("hyperbit/*/result", self._hear)
        self._threads: list[threading.Thread] = []

    def run(self, arms: Sequence[str], seconds: float) -> list[Sent]:
        since = len(self.sent)
        self.begin(arms)
        time.sleep(seconds)
        self.end()
        return self.sent[since:]

    def begin(self, arms: Sequence[str]) -> None:
        self._ended.clear()
        self._threads = [threading.Thread(target=self._drive, args=(k, arm)) for k, arm in enumerate(arms)]
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()

    def close(self) -> None:
        self._hearing.undeclare()  # type: ignore[no-untyped-call]
        for one in self._sessions:
            one.close()  # type: ignore[no-untyped-call]

    def _hear(self, sample: zenoh.Sample) -> None:
        message, now = decode(sample.payload.to_bytes()), time.monotonic()
        with self._changed:
            if not message.get("repeated"):
                self.results[message["id"]] += 1
            self._results.setdefault(message["id"], (now, message))
            self._changed.notify_all()

    def _drive(self, number: int, arm: str) -> None:
        """Sends goals to one arm; a goal waits for the end of the one before."""
        client = Client(self._sessions[number % len(self._sessions)], arm)
        due, turn = time.monotonic() + EVERY * number / len(self._threads), number
        while not self._ended.wait(max(due - time.monotonic(), 0.0)):
            due, turn = max(due + EVERY, time.monotonic()), turn + 1
            self._goal(client, arm, self._places[turn % len(self._places)])

    def _goal(self, client: Client, arm: str, place: Place) -> None:
        goal, began = uuid.uuid4().hex[:12], time.monotonic()
        try:
            answer = client.request("goal", {"id": goal, "waypoints": [{"position": place}]})
        except Unanswered:
            answer = {"accepted": None}
        answered = time.monotonic() - began
        if answer["accepted"] is False:
            self.sent.append(Sent(arm, goal, answered, answered, f"refused: {answer['message']}"))
            return
        if (end := self._end_of(client, goal, known=answer["accepted"] is True)) is None:
            self.unknown.append(f"{arm} {goal}")
        else:
            self.sent.append(Sent(arm, goal, answered, end[0] - began, end[1]))

    def _end_of(self, client: Client, goal: str, *, known: bool) -> tuple[float, str] | None:
        """Returns when and how a goal ended, or NOT_RECEIVED; None if that cannot be learned."""
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            with self._changed:
                if self._changed.wait_for(lambda: goal in self._results, ASK):
                    at, message = self._results[goal]
                    return at, message["status"]
            try:
                answer = client.request("result", {"id": goal})
            except Unanswered:
                continue  # the daemon or the network is gone
            if answer.get("result"):
                return time.monotonic(), answer["result"]["status"]
            if not known and not answer["accepted"]:
                return time.monotonic(), NOT_RECEIVED
        return None


def ends(goals: Sequence[Sent]) -> dict[str, int]:
    return dict(Counter(it.status for it in goals).most_common())
