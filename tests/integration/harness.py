"""A client that remembers all it was told, and waits for what is to come."""

import time
from typing import Any

from controller.config import Arm
from controller.daemon.client import Client, Message
from controller.settings import ActuatorSettings
from tests.daemon.waiting import PATIENCE, SLOWNESS, eventually

KEYS = ("feedback", "result", "diagnostics", "state")  # state last: who hears that hears all


def wired(arm: Arm, label: str) -> ActuatorSettings:
    """Where an actuator is wired."""
    return arm.wiring[arm.manipulator.actuators.index(label)]


def board_names(arm: Arm) -> list[str]:
    """The boards' names, in the order of their nodes."""
    return [f"{bus}/{node}" for bus, node in sorted({(channel.bus, channel.node) for channel in arm.wiring})]


class Observer:
    """Hears everything an arm's daemon says.

    Attributes:
        client: to ask the daemon with.
        heard: what came on each key, oldest first.
        times: when it came, UNIX seconds.
        accepted: ids of the goals it sent that were accepted.
        sent: when, by id, UNIX seconds.
    """

    def __init__(self, client: Client) -> None:
        self.client = client
        self.heard: dict[str, list[Message]] = {key: [] for key in KEYS}
        self.times: dict[str, list[float]] = {key: [] for key in KEYS}
        self.accepted: list[str] = []
        self.sent: dict[str, float] = {}
        self._subscribers = [client.subscribe(key, self._remember(key)) for key in KEYS]

    def _remember(self, key: str) -> Any:
        def remember(message: Message) -> None:
            self.times[key].append(time.time())
            self.heard[key].append(message)

        return remember

    def ask(self, key: str, **payload: Any) -> Message:
        return self.client.request(key, payload, timeout=PATIENCE)

    def goal(self, *positions: tuple[float, float], times: list[float] | None = None, **fields: Any) -> Message:
        """Sends a goal; without times, a single waypoint now, or one every 0.2 s; on a slow machine slower."""
        times = times or [0.2 * k for k in range(len(positions))]
        points = [{"t": t * SLOWNESS, "position": list(position)} for t, position in zip(times, positions, strict=True)]
        sent = time.time()
        answer = self.ask("goal", waypoints=points, **fields)
        self.sent |= {answer["id"]: sent} if answer["accepted"] else {}
        self.accepted += [answer["id"]] * answer["accepted"]
        return answer

    def wait_for(self, mode: str, reason: str = "", after: int = 0) -> Message:
        """Waits until a state heard from the one of index `after` on is in a mode; returns that state."""

        def found() -> Message | None:
            states = self.heard["state"][after:]
            return next((s for s in states if s["mode"] == mode and reason in s["reason"]), None)

        return eventually(found, told=lambda: f"among {len(self.heard['state'])} states: {self.heard['state'][-1:]}")

    def wait_now(self, mode: str, reason: str = "") -> Message:
        """Waits until a state that is told from now on is in a mode."""
        return self.wait_for(mode, reason, after=len(self.heard["state"]))

    def wait_fault(self, code: str, since: float, within: float | None = None) -> Message:
        """Waits for a state that names a fault.

        Args:
            code: of the fault.
            since: when it happened [UNIX s]; states of before do not count.
            within: the longest it may take [s]; on a slow machine longer.
        """

        def found() -> Message | None:
            states = [s for s in self.heard["state"] if s["stamp"] >= since]
            return next((s for s in states if code in [fault["code"] for fault in s["faults"]]), None)

        state = eventually(found)
        assert within is None or state["stamp"] - since < within * SLOWNESS, (
            f"{code} came after {state['stamp'] - since:.2f} s"
        )
        return state

    def result(self, goal: str) -> Message:
        """Waits for the result of a goal, and sees that it has no other so far."""
        eventually(lambda: self.results(goal))
        (result,) = self.results(goal)
        return result

    def results(self, goal: str | None) -> list[Message]:
        return [result for result in self.heard["result"] if result["id"] == goal]

    def span(self, goal: str) -> tuple[float, float]:
        """From when to when a goal may have moved the arm: from sending it to hearing its result [UNIX s]."""
        heard = [time for time, it in zip(self.times["result"], self.heard["result"], strict=True) if it["id"] == goal]
        return self.sent[goal], heard[-1]

    def feedback(self, goal: str) -> list[Message]:
        return [feedback for feedback in self.heard["feedback"] if feedback["id"] == goal]

    def move(self, *positions: tuple[float, float], goal: str = "move", times: list[float] | None = None) -> Message:
        """Sends a goal that must succeed; returns its result."""
        answer = self.goal(*positions, times=times, id=goal)
        assert answer["accepted"], answer
        result = self.result(goal)
        assert result["status"] == "succeeded", result
        return result
