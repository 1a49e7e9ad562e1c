"""A client that remembers all messages it receives, and waits for further ones."""

import time
from typing import Any

from hyperbit.controller.network.client import Client, Message
from tests.waiting import PATIENCE, SLOWNESS, eventually

KEYS = ("feedback", "result", "diagnostics", "state")  # state last: when it arrives, the others are subscribed


class Observer:
    """Receives everything that an arm's daemon publishes.

    Attributes:
        heard: messages of each key, oldest first.
        times: of their arrival [UNIX s].
        sent: when each goal was sent, by id [UNIX s].
        streams: spans in which set-points were followed [UNIX s].
    """

    def __init__(self, client: Client) -> None:
        self.client = client
        self.heard: dict[str, list[Message]] = {key: [] for key in KEYS}
        self.times: dict[str, list[float]] = {key: [] for key in KEYS}
        self.accepted: list[str] = []
        self.sent: dict[str, float] = {}
        self.streams: list[tuple[float, float]] = []
        self._subscribers = [client.subscribe(key, self._remember(key)) for key in KEYS]

    def _remember(self, key: str) -> Any:
        def remember(message: Message) -> None:
            self.times[key].append(time.time())
            self.heard[key].append(message)

        return remember

    def ask(self, key: str, **payload: Any) -> Message:
        return self.client.request(key, payload, timeout=PATIENCE)

    def goal(self, *positions: tuple[float, ...], times: list[float] | None = None, **fields: Any) -> Message:
        """Sends a goal; by default one waypoint now, or one every 0.2 s; slower on a slow machine."""
        times = times or [0.2 * k for k in range(len(positions))]
        points = [{"t": t * SLOWNESS, "position": list(position)} for t, position in zip(times, positions, strict=True)]
        return self.send("goal", **{"waypoints": points, "begin_within": PATIENCE, **fields})

    def send(self, key: str, **payload: Any) -> Message:
        sent = time.time()
        answer = self.ask(key, **payload)
        if answer["accepted"]:
            self.sent[answer["id"]] = sent
            self.accepted.append(answer["id"])
        return answer

    def move(self, *positions: tuple[float, ...], goal: str = "move", times: list[float] | None = None) -> Message:
        """Sends a goal that must succeed; returns its result."""
        answer = self.goal(*positions, times=times, id=goal)
        assert answer["accepted"], answer
        result = self.result(goal)
        assert result["status"] == "succeeded", result
        return result

    def reset(self) -> None:
        assert self.ask("reset")["accepted"]
        self.wait_now("ready")

    @property
    def state(self) -> Message:
        return self.heard["state"][-1]

    @staticmethod
    def faults(state: Message) -> list[Message]:
        """Returns the faults of a state but the warning of boards on SocketCAN, which count as real."""
        return [fault for fault in state["faults"] if fault["code"] != "not-commissioned"]

    @property
    def codes(self) -> list[str]:
        return [fault["code"] for fault in self.state["faults"]]

    def wait_for(self, mode: str, reason: str = "", after: int = 0) -> Message:
        """Waits for a state of a mode from index `after` on; returns it."""

        def found() -> Message | None:
            states = self.heard["state"][after:]
            return next((s for s in states if s["mode"] == mode and reason in s["reason"]), None)

        return eventually(found, told=lambda: f"among {len(self.heard['state'])} states: {self.heard['state'][-1:]}")

    def wait_now(self, mode: str, reason: str = "") -> Message:
        """Waits for a new state of a mode."""
        return self.wait_for(mode, reason, after=len(self.heard["state"]))

    def next_state(self) -> Message:
        before = len(self.heard["state"])
        return eventually(lambda: self.heard["state"][before:])[0]

    def wait_fault(self, code: str, since: float) -> Message:
        """Waits for a state of `since` [UNIX s] or later with a fault."""

        def found() -> Message | None:
            states = [s for s in self.heard["state"] if s["stamp"] >= since]
            return next((s for s in states if code in [fault["code"] for fault in s["faults"]]), None)

        return eventually(found, told=lambda: f"(a fault {code}): {self.heard['state'][-1:]}")

    def result(self, goal: str) -> Message:
        """Waits for the result of a goal; it must be the only one so far."""
        eventually(lambda: self.results(goal), told=lambda: f"(result of {goal}): {self.heard['state'][-1:]}")
        (result,) = self.results(goal)
        return result

    def results(self, goal: str | None) -> list[Message]:
        """Returns the results of a goal; one that is marked as repeated counts only if it is the first."""
        heard = [result for result in self.heard["result"] if names(result, goal)]
        return heard[:1] + [result for result in heard[1:] if not result.get("repeated")]

    def first_results(self) -> list[Message]:
        return [result for result in self.heard["result"] if not result.get("repeated")]

    def repeats(self, goal: str) -> bool:
        return len(self.results(goal)) < sum(names(result, goal) for result in self.heard["result"])

    def span(self, goal: str) -> tuple[float, float]:
        """The span from sending a goal to its result, in which alone it may move the arm [UNIX s]."""
        heard = [time for time, it in zip(self.times["result"], self.heard["result"], strict=True) if names(it, goal)]
        return self.sent[goal], heard[-1]

    def feedback(self, goal: str) -> list[Message]:
        return [feedback for feedback in self.heard["feedback"] if names(feedback, goal)]

    def last_feedback(self, goal: str, waypoint: int) -> list[Message]:
        """Returns the feedback of a goal when that of its last waypoint has come, perhaps after the result."""
        eventually(lambda: [one for one in self.feedback(goal) if one["waypoint"] == waypoint])
        return self.feedback(goal)

    def diagnosed(self) -> Message:
        before = len(self.heard["diagnostics"])
        return eventually(lambda: self.heard["diagnostics"][before:])[0]


def names(message: Message, goal: str | None) -> bool:
    """Whether a message is on a goal; a stranger's message on the daemon's key may have no id."""
    return "id" in message and bool(message["id"] == goal)
