"""What ROS clients have asked of the bridge, and what became of it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from hyperbit.controller.ros2.wire.actions import Status
from tests.ros2.world.motion import Positions

ACTIVE = (Status.ACCEPTED, Status.EXECUTING, Status.CANCELING)
ENDS = (Status.SUCCEEDED, Status.CANCELED, Status.ABORTED)
# Steps of a goal's status. The end of the server may take both steps of an accepted goal at once.
LEGAL = {
    (Status.UNKNOWN, Status.ACCEPTED),
    *((Status.ACCEPTED, new) for new in (Status.EXECUTING, Status.CANCELING, Status.ABORTED)),
    *((Status.EXECUTING, new) for new in (Status.CANCELING, Status.SUCCEEDED, Status.ABORTED)),
    *((Status.CANCELING, new) for new in ENDS),
}


SENT_WITHIN = 3.0  # [s] until a stop or cancel is sent
REPEATED_WITHIN = 5.0  # [s] until an owed cancel is sent again, for each that is owed
KNOWN_WITHIN = 15.0  # [s] after which a goal that the ledger does not have is lost
GONE_AFTER = 60.0  # [s] without a daemon, after which its goals are lost
KEPT, MOST_LATER = 50.0, 30  # a result is kept so long [s], and until so many later requests
BARRED = {"goal": ("stop", "cancel"), "setpoint": ("stop", "cancel"), "reset": ("stop",), "plan": ()}


class Wrong(BaseException):
    """The bridge has broken a rule. No `except Exception` of the bridge catches it."""


class Result(NamedTuple):
    status: int
    code: int
    text: str


class Told(NamedTuple):
    """The end of a goal, as the daemon tells it. `sure`: the bridge can read it, and no kill came between."""

    status: str
    code: int
    text: str
    sure: bool


@dataclass(eq=False)
class Ask:
    """A message of a ROS client.

    Attributes:
        key: of the daemon, to which it may lead.
        points: of a request for motion that is valid; None: it may not move the arm.
        uuid: of an action's goal.
        sent: whether it was sent to the daemon.
        answer: whether the daemon accepted it; None: not known.
    """

    number: int
    name: str
    key: str
    message: Any
    points: Positions | None
    uuid: bytes
    service: bool
    sent: bool = False
    answer: bool | None = None
    replied: bool = False


@dataclass
class Ending:
    """The service stop or cancel: numbers of its last request, of the last one sent, and of the last one accepted."""

    asked: int = 0
    sent: int = 0
    accepted: int = 0
    since: float = math.inf  # when the first one came that is not sent [s]


@dataclass
class Debt:
    """A cancel that is owed to the daemon: when it began, and when it was sent last [s]."""

    began: float
    last: float = -math.inf


@dataclass
class Goal:
    """An accepted goal.

    Attributes:
        joints: of its trajectory; none: they are not known.
        status: last one on the wire.
        canceled: whether a cancel was accepted.
        ended: when it ended [s].
        result: first one that a client received.
        told: what the daemon had told of it when it ended.
        later: requests for goals that came after its acceptance.
        due: earliest time at which its time limit is over [s].
    """

    server: str
    uuid: bytes
    joints: list[str]
    status: Status = Status.UNKNOWN
    canceled: bool = False
    ended: float = 0.0
    result: Result | None = None
    told: list[Told] = field(default_factory=list)
    later: int = 0
    due: float = math.inf

    @property
    def id(self) -> str:
        return identity(self.uuid)

    @property
    def active(self) -> bool:
        return self.status not in ENDS

    def is_kept(self, now: float) -> bool:
        """Whether its result must be known."""
        return now < self.ended + KEPT and self.later < MOST_LATER

    def step(self, status: Status) -> bool:
        """Takes a status; returns whether it is new. A first status may come late."""
        old, self.status = self.status, status
        if old != status and (old, status) not in LEGAL and (old or status not in (*ACTIVE, Status.ABORTED)):
            raise Wrong(f"{self.id} has come from status {old} to {status}")
        return old != status


def identity(uuid: bytes) -> str:
    """Returns the daemon's id of an action's goal."""
    return f"ros2-{uuid.hex()}"


def status_of(word: str, *, canceled: bool) -> Status:
    """Returns the status of a goal whose end the daemon tells by this word."""
    if word == "succeeded":
        return Status.SUCCEEDED
    return Status.CANCELED if word == "canceled" and canceled else Status.ABORTED


def points_of(payload: Mapping[str, Any]) -> list[Any]:
    return [it.get("position") for it in payload.get("waypoints", ())]


def fits(points: Positions, wanted: Positions | None) -> bool:
    """Returns whether these points were asked for; a point None is a configuration."""
    return (
        wanted is not None
        and len(points) == len(wanted)
        and all(it is None or all(map(math.isclose, it, want)) for it, want in zip(points, wanted, strict=True))
    )


class Debts(dict[str, Debt]):
    """Cancels that are owed to the daemon, by the ids of goals.

    Attributes:
        paid: goals whose cancel was owed once, and may be under way.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        super().__init__()
        self._clock, self.paid = clock, set[str]()

    def owe(self, name: str) -> None:
        self.setdefault(name, Debt(self._clock()))

    def pay(self, name: str) -> None:
        if self.pop(name, None) is not None:
            self.paid.add(name)

    def send(self, name: str) -> None:
        if name in self:
            self[name].last = self._clock()
        elif name not in self.paid:
            raise Wrong(f"goal {name} is canceled, and nobody asked for it")

    def check_time(self, since: float) -> None:
        """`since`: the bridge can send from then on [s]."""
        for name, debt in self.items():
            if self._clock() > max(debt.last, debt.began, since) + REPEATED_WITHIN * len(self):
                raise Wrong(f"the accepted cancel of {name} is not repeated; the goal has not ended")


class Losses:
    """When the bridge may say that a goal of the daemon is lost.

    Attributes:
        since: when a goal was sent, or restored [s].
        gone: since when there is no daemon [s].
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self.since, self.gone = clock, dict[str, float](), math.inf
        self._unknown: dict[str, float] = {}  # when the ledger did not have a goal [s]

    def begin(self, name: str) -> None:
        self._unknown.pop(name, None)
        self.since[name] = self._clock()

    def is_unknown(self, name: str) -> bool:
        """Accepts that the ledger does not have a goal; returns whether it had time to."""
        self._unknown[name] = self._clock()
        return self._clock() >= self.since.get(name, -math.inf) + KNOWN_WITHIN

    def may_be_lost(self, name: str) -> bool:
        since = self.since.get(name, -math.inf)
        unknown = self._unknown.get(name, -math.inf) > since + KNOWN_WITHIN
        return unknown or self._clock() > max(self.gone, since) + GONE_AFTER


class Asks:
    """Requests and messages of ROS clients that have not had their effect, in the order of their arrival."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self.number = clock, 0
        self.open: list[Ask] = []
        self.endings = {"stop": Ending(), "cancel": Ending()}
        self._before = self.endings

    def receive(self, ask: Ask) -> None:
        self.number = ask.number
        self.open.append(ask)
        self._before = {key: replace(it) for key, it in self.endings.items()}
        if ask.key in self.endings:
            ending = self.endings[ask.key]
            ending.since = ending.since if ending.asked > ending.sent else self._clock()
            ending.asked = ask.number

    def forget(self, ask: Ask) -> None:
        """Takes the last message back."""
        self.open.remove(ask)
        self.endings = self._before

    def send(self, key: str, points: Positions, topic: str = "", uuid: bytes = b"") -> Ask:
        """Returns what a request for motion, or a plan, is sent for. No stop or cancel bars it, or waits before it."""
        found = [
            it
            for it in self.open
            if (it.key, it.sent) == (key, False) and fits(points, it.points)
            and topic in ("", it.name) and uuid in (b"", it.uuid)
        ]  # fmt: skip
        if not found:
            raise Wrong(f"{key} is sent, and nobody asked for it: {points}")
        allowed = [it for it in found if not self._barred(it)]
        if not allowed:
            raise Wrong(f"{key} is sent, though {self._barred(found[-1])}")
        allowed[0].sent = True
        if not allowed[0].service:
            self.open.remove(allowed[0])
        return allowed[0]

    def _barred(self, ask: Ask) -> str:
        for key, ending in self.endings.items():
            if key in BARRED[ask.key] and ending.asked > ask.number:
                return f"a {key} came after it"
            waiting = [it.number for it in self.open if it.key == key and it.number > ending.sent]
            if BARRED[ask.key] and min(waiting, default=ask.number) < ask.number:
                return f"a {key} that came before it is not sent"
        return ""

    def send_ending(self, key: str) -> None:
        ending = self.endings[key]
        if not any(it.key == key for it in self.open) and ending.asked <= ending.sent:
            raise Wrong(f"{key} is sent, and nobody asked for it")
        ending.sent, ending.since = self.number, math.inf

    def reply(self, ask: Ask) -> None:
        if ask.replied:
            raise Wrong(f"a request on {ask.name} has two replies")
        ask.replied = True
        self.open.remove(ask)

    def check_time(self) -> None:
        for key, ending in self.endings.items():
            if self._clock() > ending.since + SENT_WITHIN:
                raise Wrong(f"a {key} is not sent within {SENT_WITHIN:g} s")
