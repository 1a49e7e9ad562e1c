"""The account of what ROS clients ask for: order of arrival, and what the bridge sends to the daemon for it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from tests.ros2.judge.actions import Wrong

BARRED = {"goal": ("stop", "cancel"), "setpoint": ("stop", "cancel"), "reset": ("stop",), "plan": ()}
ENDING_WITHIN = 3.0  # [s] until a stop or cancel is sent
MOST_HEARD = 5_000  # messages on topics that may be sent to the daemon still


@dataclass(eq=False)
class Ask:
    """A message of a ROS client.

    Attributes:
        number: in the order of arrival.
        at: when it came [s].
        key: of the daemon, to which it may lead; "": it leads to none.
        points: positions of a goal, by the independent reader; None: it is no goal.
        service: whether a reply is due.
        sent: whether it was sent to the daemon.
        answer: of the daemon: whether it accepted; None: not known.
        replied: whether the client has a reply.
    """

    number: int
    at: float
    name: str
    key: str
    payload: bytes
    points: list[Any] | None
    service: bool
    sent: bool = False
    answer: bool | None = None
    replied: bool = False


@dataclass
class Ending:
    """The services stop and cancel: numbers of the last request, of the last one sent, and of the last one accepted."""

    asked: int = 0
    sent: int = 0
    accepted: int = 0
    since: float = math.inf  # when the first one came that is not sent [s]


class Asks:
    """All requests and messages of ROS clients that have not had their effect."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.open: list[Ask] = []
        self.endings = {"stop": Ending(), "cancel": Ending()}
        self._before = self.endings
        self._number = 0

    def receive(self, name: str, key: str, payload: bytes, points: list[Any] | None, service: bool) -> Ask:
        self._number += 1
        self._before = {it: replace(ending) for it, ending in self.endings.items()}
        ask = Ask(self._number, self._clock(), name, key, payload, points, service)
        self.open.append(ask)
        if key in self.endings:
            ending = self.endings[key]
            ending.since = ask.at if ending.asked <= ending.sent else ending.since
            ending.asked = ask.number
        return ask

    def forget(self, ask: Ask) -> None:
        """Takes the last message back, which the bridge has dropped."""
        self.open.remove(ask)
        self.endings = self._before

    def receive_motion(self, key: str, points: list[Any], name: str = "", uuid: bytes = b"") -> Ask:
        """Accepts that a request that asks for motion, or a plan, is sent; returns what it was sent for."""
        fits = [
            ask
            for ask in self.open
            if ask.key == key and not ask.sent and not ask.replied
            and (not name or ask.name == name) and (not uuid or ask.payload[4:20] == uuid)
            and same(points, ask.points)
        ]  # fmt: skip
        if not fits:
            raise Wrong(f"{key} is sent, and nobody asked for it: {points}")
        allowed = [ask for ask in fits if not self._barred(ask)]
        if not allowed:
            raise Wrong(f"{key} is sent, though {self._barred(fits[-1])}")
        allowed[0].sent = True
        if not allowed[0].service:
            self.open.remove(allowed[0])
        return allowed[0]

    def _barred(self, ask: Ask) -> str:
        """Returns why a request may not be sent now, or nothing."""
        for key, ending in self.endings.items():
            if key in BARRED[ask.key] and ending.asked > ask.number:
                return f"a {key} came after it"
            first = min(
                (it.number for it in self.open if it.key == key and it.number > ending.sent), default=ask.number
            )
            if BARRED[ask.key] and first < ask.number:
                return f"a {key} that came before it is not sent"
        return ""

    def receive_ending(self, key: str) -> None:
        ending = self.endings[key]
        if not any(it.key == key and not it.replied for it in self.open) and ending.asked <= ending.sent:
            raise Wrong(f"{key} is sent, and nobody asked for it")
        ending.sent, ending.since = self._number, math.inf

    def receive_ending_answer(self, key: str, accepted: bool | None) -> None:
        self.endings[key].accepted = self.endings[key].sent if accepted else 0

    def receive_reply(self, ask: Ask, success: bool) -> None:
        if ask.replied:
            raise Wrong(f"a request on {ask.name} has two replies")
        ask.replied = True
        self.open.remove(ask)
        if ask.key in self.endings:
            if success != (self.endings[ask.key].accepted >= ask.number):
                raise Wrong(f"{ask.key} is answered {success}, the daemon has not said so")
        elif ask.key in ("reset", "goal") and success != bool(ask.sent and ask.answer):
            raise Wrong(f"a request on {ask.name} is answered {success}, the daemon's answer is {ask.answer}")

    def check_time(self) -> None:
        """Checks that stops and cancels are sent in time."""
        for key, ending in self.endings.items():
            if self._clock() > ending.since + ENDING_WITHIN:
                raise Wrong(f"a {key} is not sent within {ENDING_WITHIN:g} s")
        topics = [ask for ask in self.open if not ask.service]
        for ask in topics[:-MOST_HEARD]:
            self.open.remove(ask)


def same(points: list[Any], wanted: list[Any] | None) -> bool:
    return (
        wanted is not None
        and len(points) == len(wanted)
        and all(
            point is None or all(map(math.isclose, point, want)) for point, want in zip(points, wanted, strict=True)
        )
    )
