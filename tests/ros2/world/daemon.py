"""A daemon for the bridge: one goal at a time, a ledger, and requests that arrive late."""

import json
import math
import random
from collections.abc import Callable, Mapping
from typing import Any

from hyperbit.controller.network.client import Unanswered
from tests import told

KEPT_RESULTS = 100
LATEST, LONGEST = 8.0, 20.0  # [s] until a goal begins, and that it runs
CODES = {"succeeded": 0, "canceled": -1, "replaced": -1}
UNKNOWN = {"accepted": False, "message": "no such goal", "reason": "unknown-goal"}
OUT_OF_REACH = {"accepted": False, "code": -5, "message": "out of reach", "reason": "out-of-reach"}


class Daemon:
    """Without `chance`, it accepts all, and carries out nothing by itself.

    Attributes:
        asked: key and id of each request.
        away: keys whose requests are not answered.
        junk: what is answered to a key, in place of an answer.
    """

    def __init__(
        self, chance: random.Random | None, clock: Callable[[], float], tell: Callable[[str, bytes], None]
    ) -> None:
        self._chance, self._clock, self._tell = chance, clock, tell
        self.goal: str | None = None
        self.asked: list[tuple[str, str]] = []
        self.away: set[str] = set()
        self.junk: dict[str, Any] = {}
        self.ledger: dict[str, dict[str, Any] | None] = {}
        self._status, self._ends_at, self._stopped = "", 0.0, False
        self._late: list[tuple[float, bool, Mapping[str, Any]]] = []  # when it begins [s], whether it has arrived

    def count(self, key: str, name: str = "") -> int:
        return self.asked.count((key, name))

    def request(self, key: str, payload: Mapping[str, Any]) -> Any:
        name = payload.get("id")
        if self._chance is None:
            self.asked.append((key, str(name or "")))
        if key in self.away:
            raise Unanswered("no daemon")
        if key in self.junk:
            return self.junk[key]
        if key in ("stop", "cancel"):
            self._late = [it for it in self._late if not it[1] or name not in (None, it[2]["id"])]
        match key:
            case "arm":
                return told.described() | {"travel_time": 0.5}
            case "result":
                known = {"accepted": True, "message": "ended", "result": self.ledger.get(str(name))}
                return known if name in self.ledger else UNKNOWN
            case "plan" if self._chance is None or self._draw(0.9):
                return {**told.ANSWER, "waypoints": [{"position": [0.1, 0.2], "orientation": 0.1}]}
            case "plan":
                return OUT_OF_REACH
            case "goal":
                if self._stopped or self._draw(0.1):
                    return OUT_OF_REACH
                self._start(str(name))
            case "stop" | "cancel" if self._chance and self.goal and name in (None, self.goal):
                self._status = "aborted" if key == "stop" else "canceled"
                self._ends_at = self._clock() + self._chance.random()
        if key in ("stop", "reset"):
            self._stopped = key == "stop" and self._chance is not None
        return {"accepted": True, "code": 0, "message": "yes"}

    def receive_late(self, payload: Mapping[str, Any]) -> None:
        """Accepts a goal whose sender waits no longer: it waits for its begin, or is still on its way."""
        assert self._chance
        self._late.append((self._clock() + self._chance.random() * LATEST, self._chance.random() < 0.5, payload))

    def pass_time(self) -> None:
        """Ends the goal if it has run long enough; receives what was on its way; publishes a state."""
        assert self._chance
        for item in [it for it in self._late if it[0] <= self._clock()]:
            self._late.remove(item)
            self.request("goal", item[2])
        if self.goal is not None and self._clock() >= self._ends_at:
            self.end(self._status)
        state = told.state(faults=[told.FAULT] * self._draw(0.1), goal=self.goal, target={"position": [0.5, 2.8]})
        state["measured"] = [self._chance.randrange(2) for _ in state["measured"]]
        self._tell("state", json.dumps(state).encode())

    def end(self, status: str) -> dict[str, Any]:
        """Ends the goal, or the latest one; returns its result. A random daemon may lose its message."""
        name = self.goal or list(self.ledger)[-1]
        result = {"id": name, "status": status, "code": CODES.get(status, -4), "message": f"it is {status}"}
        self.ledger.pop(name, None)  # the latest comes last
        self.ledger[name], self.goal = result, None
        if len(self.ledger) > KEPT_RESULTS:
            del self.ledger[next(iter(self.ledger))]
        if self._draw(0.8):
            self._tell("result", json.dumps(result).encode())
        return result

    def _start(self, name: str) -> None:
        if name == self.goal:
            return
        if self.goal is not None and self._chance:
            self.end("replaced")
        self.goal, self.ledger[name], self._ends_at = name, None, math.inf
        if self._chance:
            self._status = "succeeded" if self._draw(0.7) else "aborted"
            self._ends_at = self._clock() + self._chance.random() * LONGEST
            if self._draw(0.2):
                self.end("succeeded")

    def _draw(self, share: float) -> bool:
        return self._chance is not None and self._chance.random() < share
