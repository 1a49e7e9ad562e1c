"""A daemon for the bridge: one goal at a time, a ledger, and requests that arrive late."""

import json
import random
from collections.abc import Callable, Mapping
from typing import Any

from tests.ros2.fuzz.inputs import payloads
from tests.ros2.fuzz.stand_ins import Clock
from tests.ros2.samples import state

KEPT_RESULTS = 100
LATEST = 8.0  # [s] until a goal begins
LONGEST = 20.0  # [s] that a goal runs
CODES = {"succeeded": 0, "canceled": -1, "replaced": -1}


class Daemon:
    def __init__(self, chance: random.Random, clock: Clock, tell: Callable[[str, bytes], None]) -> None:
        self._chance, self._clock, self._tell = chance, clock, tell
        self.goal: str | None = None
        self._end, self._ends_at, self._stopped = "", 0.0, False
        self._ledger: dict[str, dict[str, Any] | None] = {}
        self._late: list[tuple[float, bool, Mapping[str, Any]]] = []  # when it begins [s], whether it has arrived

    def request(self, key: str, payload: Mapping[str, Any]) -> dict[str, Any]:
        name = payload.get("id")
        if key in ("stop", "cancel"):
            self._late = [it for it in self._late if not it[1] or name not in (None, it[2]["id"])]
        if key == "arm":
            return payloads()["arm"]
        if key == "result":
            known = {"accepted": True, "result": self._ledger.get(str(name))}
            return known if name in self._ledger else {"accepted": False, "reason": "unknown-goal"}
        if key == "plan" and self._chance.random() < 0.9:
            points = [{"position": [0.1, 0.2], "orientation": 0.1}]
            return {"accepted": True, "code": 0, "message": "", "waypoints": points}
        if key == "plan" or (key == "goal" and (self._stopped or self._chance.random() < 0.1)):
            return {"accepted": False, "code": -5, "message": "out of reach", "reason": "out-of-reach"}
        if key == "goal":
            self._start(str(name))
        elif self.goal is not None and (key == "stop" or (key == "cancel" and name in (None, self.goal))):
            self._end, self._ends_at = {"stop": "aborted"}.get(key, "canceled"), self._clock.now + self._chance.random()
        if key in ("stop", "reset"):
            self._stopped = key == "stop"
        return {"accepted": True, "code": 0, "message": "yes"}

    def receive_late(self, payload: Mapping[str, Any]) -> None:
        """Accepts a goal whose sender waits no longer: it waits for its begin, or is still on its way."""
        self._late.append((self._clock.now + self._chance.random() * LATEST, self._chance.random() < 0.5, payload))

    def pass_time(self) -> None:
        """Ends the goal if it has run long enough; receives what was on its way; publishes a state."""
        for item in [it for it in self._late if it[0] <= self._clock.now]:
            self._late.remove(item)
            self.request("goal", item[2])
        if self.goal is not None and self._clock.now >= self._ends_at:
            self._finish(self._end)
        fault = payloads()["state"]["faults"] if self._chance.random() < 0.1 else []
        told = state(faults=fault, goal=self.goal, target={"position": [0.5, 2.8], "orientation": 0.1})
        told["measured"] = [int(self._chance.random() * 2) for _ in told["measured"]]
        self._tell("state", json.dumps(told).encode())

    def _start(self, name: str) -> None:
        if name == self.goal:
            return
        if self.goal is not None:
            self._finish("replaced")
        self.goal, self._ledger[name] = name, None
        self._end = "succeeded" if self._chance.random() < 0.7 else "aborted"
        self._ends_at = self._clock.now + (0.0 if self._chance.random() < 0.2 else self._chance.random() * LONGEST)
        if self._ends_at == self._clock.now:
            self._finish("succeeded")

    def _finish(self, status: str) -> None:
        assert self.goal is not None
        result = {"id": self.goal, "status": status, "code": CODES.get(status, -4), "message": f"it is {status}"}
        del self._ledger[self.goal]  # the latest comes last
        self._ledger[self.goal], self.goal = result, None
        if len(self._ledger) > KEPT_RESULTS:
            del self._ledger[next(iter(self._ledger))]
        if self._chance.random() < 0.8:  # else the message gets lost
            self._tell("result", json.dumps(result).encode())
