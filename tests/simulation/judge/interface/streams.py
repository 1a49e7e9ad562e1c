"""Streams of set-points and measured tips: whose stream it is, what counts, what the executor gets, and the counts."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

from hyperbit.controller.program import Setpoint, unpack
from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Payload, Request
from tests.simulation.judge.interface.messages import body_of
from tests.simulation.judge.interface.refusals import REASONS
from tests.simulation.judge.interface.tasks import start_of
from tests.simulation.judge.verdict import require

PAUSE = 0.25  # [s] without a set-point, after which a stream has ended
OLDEST, AHEAD = 0.2, 0.02  # [s], age and lead of a set-point
TIP_OLDEST = 1.0  # [s], age of a measured tip
TOLD_WITHIN = 0.1  # [s], awake, from a count to its publication
SENT_WITHIN = 0.1  # [s], awake, longest time between two commands for an open stream
NOTED_EVERY = 0.95  # [s], shortest time between two commands with other reasons: a second, and the next command
DWELLED = 1.0  # [s] for which a target must stand still until the arm is there
ENDING = ("goal", "jog", "stop", "cancel", "reset", "degrade")


@dataclass
class Counts:
    """What `diagnostics` tells of set-points or tips.

    Attributes:
        surely, perhaps: least and greatest number of those that are refused.
        reason: of the last refusal; "": not known.
        heard: time of the last set-point of the stream [s].
        least, most: shortest and longest time between two set-points of the stream [s].
    """

    at: float = -math.inf
    received: int = 0
    surely: int = 0
    perhaps: int = 0
    streams: int = 0
    sender: str = ""
    reason: str = ""
    heard: float = -math.inf
    begun: float = -math.inf
    least: float = math.inf
    most: float = 0.0
    taken: int = 0  # set-points of the stream


class Streams:
    """Judges streams."""

    def __init__(self, account: InterfaceAccount) -> None:
        self._a = account
        self.begin()

    def begin(self) -> None:
        self._now, self._tips = Counts(), Counts()
        self._past = deque[Counts]([replace(self._now)], maxlen=60)
        self._past_tips = deque[Counts]([replace(self._tips)], maxlen=60)
        self._times = deque[float](maxlen=200)  # of set-points of the present stream
        self._tolerances = deque[float](maxlen=60)  # of the last set-points
        self._sent_at = self._opened_at = -math.inf  # awake
        self._sent: tuple[Setpoint, float] | None = None  # the last command, and its time [s]
        self._reason: tuple[int, str, float] = -1, "", -math.inf  # of the last command, and when it changed [s]
        self._target: tuple[float, ...] = ()
        self._stands_since = math.inf
        self._tolerance = 0.0

    def setpoint(self, payload: bytes, arrived_at: float, sender: str, now: float) -> bool:
        """The planner's core has taken a set-point; returns whether it is neither malformed nor late."""
        a, counts = self._a, self._now
        counts.at, counts.received = a.awake, counts.received + 1
        position, stamp, tolerance = fields_of(payload)
        counts_for_sender = bool(position) and now - arrived_at <= OLDEST
        if not counts_for_sender:
            self._refuse("" if not position else "stale")
        elif now - counts.heard > PAUSE:
            counts.streams, counts.sender, counts.taken = counts.streams + 1, sender, 1
            counts.least, counts.most, counts.begun = math.inf, 0.0, now
            self._take(position, stamp, tolerance, now)
        elif sender != counts.sender:
            self._refuse("stream-of-another")
        else:
            apart = now - counts.heard
            counts.least, counts.most = min(counts.least, apart), max(counts.most, apart)
            counts.taken += 1
            self._take(position, stamp, tolerance, now)
        self._past.append(replace(counts))
        self._judge_sent()
        return counts_for_sender

    def _refuse(self, reason: str) -> None:
        self._now.surely, self._now.perhaps, self._now.reason = self._now.surely + 1, self._now.perhaps + 1, reason

    def _take(self, position: tuple[float, ...], stamp: float, tolerance: float, now: float) -> None:
        a, counts = self._a, self._now
        counts.heard = now
        self._times.append(now)
        age = a.wall() - stamp
        if stamp and (age > OLDEST + 0.01 or age < -AHEAD - 0.01):
            counts.perhaps, counts.reason = counts.perhaps + 1, ""
            if self._open(now) and not a.had("clock", a.now - 5.0):
                counts.surely += 1
                counts.reason = "stale" if age > 0 else "from-the-future"
        elif stamp:
            counts.perhaps, counts.reason = counts.perhaps + 1, ""
        if position != self._target or tolerance != self._tolerance:
            self._target, self._tolerance, self._stands_since = position, tolerance, now

    def _open(self, now: float) -> bool:
        """Returns whether nothing has ended the present stream, or kept it from being followed."""
        a, since = self._a, self._now.begun - 2 * PAUSE
        asked = any(r.key in ENDING and (r.at > since or (r.query and r.answered_at > since)) for r in a.requests[-60:])
        runs = a.snapshot is not None and a.snapshot.mode in ("ready", "executing")
        noted = any(a.had(kind, since) for kind in ("epoch", "link", "fault", "still", "tables", "halted"))
        return not asked and runs and not noted and a.clear() and not a.slow and now - self._now.heard <= PAUSE

    def sends(self, message: Setpoint) -> None:
        """The planner sends a command for a stream, which may begin in the same step."""
        self._judge_sent()
        stream, reason, at = self._reason
        if message.stream != stream:
            self._reason = message.stream, message.reason, -math.inf
        elif message.reason != reason:
            soon = self._a.now - at
            require(soon >= NOTED_EVERY, f"{message} has another reason {soon:g} s after {reason!r}")
            self._reason = stream, message.reason, self._a.now
        self._sent = message, self._a.now

    def _judge_sent(self) -> None:
        """Judges the last command: the loss of an executor ends a stream."""
        sent, self._sent = self._sent, None
        if sent is not None:
            lost = self._a.lost_between(self._now.begun, sent[1])
            require(not lost, f"{sent[0]}, of a stream that began before the executor was lost")

    def follows(self, message: Setpoint) -> None:
        a, awake = self._a, self._a.awake
        text = f"{message}"
        if not a.process:
            return
        until = message.until - PAUSE
        known = any(abs(at - until) < 1e-6 for at in self._times) or a.had("still", a.now - 1.0)
        late = a.had("executor still", a.now - 5.0) or a.slow
        require(known or late or a.now - self._now.begun < 0.05, f"{text} lasts until {PAUSE} s after no set-point")
        require(message.reason.startswith("following a setpoint"), f"{text} has other words")
        snapshots = [h.snapshot for h in a.truths(0.02 + 0.5 * a.slow) if h.snapshot is not None]
        calm = a.clear() and not a.slow and not a.lately("still", 0.5)
        if calm and snapshots:
            require(any(s.outputs == message.start for s in snapshots), f"{text} starts from other outputs")
            require(any(s.epoch == message.epoch for s in snapshots), f"{text} is of another epoch")
            strict = {bool(cubes) for cubes in a.in_force()} | ({True} if a.scene_building else set())
            lately = a.had("cubes", a.now - 0.1)
            require(message.strict in strict or lately, f"{text}; there are obstacles: {strict}")
        self._sent_at = awake

    def arrives(self, payload: bytes) -> None:
        self._tolerances.append(fields_of(payload)[2])

    def searches(self, tolerance: float) -> None:
        """A worker is asked for a configuration near the target."""
        wanted = [known or self._a.tolerance for known in self._tolerances]
        require(tolerance in wanted, f"a set-point is followed within {tolerance}, asked for are {wanted}")

    def tip_arrives(self, request: Request) -> None:
        """Records a measured tip, and whether it surely counts."""
        a, snapshot = self._a, self._a.snapshot
        if "*" in request.name or a.bias is None:
            return
        a.tip_at, age = a.now, a.wall() - float(request.body.get("stamp", 0.0))
        rests = snapshot is not None and not snapshot.moving and snapshot.mode == "ready" and a.clear()
        standing = rests and not a.had("moved", a.now - 0.3) and not a.lately("still", 1.0) and not a.slow
        known = snapshot is not None and unpack(start_of(snapshot, len(a.modules.labels))[2]) in a.modules.tips
        if standing and known and not a.building and 0.0 <= age < 0.1 and not a.had("clock", a.now - 10.0):
            a.good_tip_at = a.now
        elif a.now - a.good_tip_at < 0.1:  # it may have displaced the good one
            a.good_tip_at = -math.inf

    def tip(self, payload: bytes, now: float) -> None:
        """The planner's core has taken a measured tip."""
        a, counts = self._a, self._tips
        counts.at, counts.received = a.awake, counts.received + 1
        counts.perhaps += 1
        position, stamp, _ = fields_of(payload)
        age = a.wall() - stamp
        counts.reason = ""
        if not position or age > TIP_OLDEST or age < -AHEAD:
            counts.surely += 1
            counts.reason = "" if not position else "stale" if age > TIP_OLDEST else "from-the-future"
        self._past_tips.append(replace(counts))

    def diagnostics(self, payload: Payload) -> None:
        a, told = self._a, payload["setpoint"]
        held_up = a.congested or a.lately("congested", 3.0) or a.lately("still", 1.0)
        entry = next((c for c in self._past if c.received == told["received"]), None)
        text = f"diagnostics {told}"
        require(entry is not None, f"{text}; {self._now.received} set-points came")
        assert entry is not None
        newer = next((c for c in self._past if c.received == told["received"] + 1), None)
        fresh = newer is None or a.awake - newer.at <= TOLD_WITHIN
        require(fresh or held_up, f"{text}; {self._now.received} set-points came")
        require(entry.surely <= told["refused"] <= entry.perhaps, f"{text}; {entry}")
        require(told["streams"] == entry.streams, f"{text}; {entry.streams} streams have begun")
        self._judge_refusal(told, entry, text)
        silent = a.now - entry.heard
        if not held_up:
            self._judge_alive(told, entry, silent, text)
        if "tracker" in payload:
            self._judge_tracker(payload["tracker"], held_up)
        require(("tracker" in payload) == (a.bias is not None), f"{text}; a tracker: {a.bias is not None}")

    def _judge_refusal(self, told: Payload, entry: Counts, text: str) -> None:
        words = told["last_refusal"]
        require((words is None) == (told["refused"] == 0), f"{text} names no refusal")
        if words is None:
            return
        require(any(sentence.fullmatch(words) for _, sentence in REASONS.values()), f"{text}; the page has no {words}")
        if entry.reason and entry.surely == entry.perhaps:
            require(REASONS[entry.reason][1].fullmatch(words) is not None, f"{text}; the reason is {entry.reason}")

    def _judge_alive(self, told: Payload, entry: Counts, silent: float, text: str) -> None:
        if silent > PAUSE + TOLD_WITHIN:
            over = told["sender"] is None and told["rate"] == 0.0 and not told["alive"]
            require(over, f"{text}; the last set-point came {silent:g} s ago")
        elif silent < PAUSE - 0.01:
            require(told["sender"] == entry.sender, f"{text}; the stream is that of {entry.sender!r}")
            if entry.taken > 1:
                least, most = 1 / max(entry.most, 1e-3) - 1e-6, 1 / max(entry.least, 1e-3) + 1e-6
                require(least <= told["rate"] <= most, f"{text}; the rate is {least:g} to {most:g}")
            else:
                require(told["rate"] == 0.0, f"{text}; the stream has one set-point")

    def _judge_tracker(self, told: Payload, held_up: bool) -> None:
        a, text = self._a, f"diagnostics of the tracker {told}"
        entry = next((c for c in self._past_tips if c.received == told["received"]), None)
        require(entry is not None, f"{text}; {self._tips.received} tips came")
        assert entry is not None
        newer = next((c for c in self._past_tips if c.received == told["received"] + 1), None)
        fresh = newer is None or a.awake - newer.at <= TOLD_WITHIN
        require(fresh or held_up, f"{text}; {self._tips.received} tips came")
        require(entry.surely <= told["refused"], f"{text}; {entry}")
        total = told["accepted"] + told["refused"] + told["outliers"]
        require(total == told["received"] and told["accepted"] >= 0, f"{text} has counts that do not add up")
        require((told["last_refusal"] is None) == (told["refused"] == 0), f"{text} names no refusal")
        if told["last_refusal"] and entry.reason:
            fits = REASONS[entry.reason][1].fullmatch(told["last_refusal"])
            require(fits is not None, f"{text}; the reason is {entry.reason}")
        require((told["estimate"] is None) == (told["accepted"] + told["outliers"] == 0), f"{text} has an estimate")
        if told["estimate"] is not None:
            apart = math.dist(told["estimate"], a.offset)
            require(told["accepted"] == 0 or apart < 1e-3, f"{text}; the tracker has {a.offset}")
        a.judge_bias(told["bias"], text)

    def tick(self) -> None:
        """Finds an open stream without commands, and a target at which the arm does not arrive."""
        self._judge_sent()
        a, now = self._a, self._a.now
        if not a.process or now - self._now.heard > 0.1 or self._now.perhaps or not self._open(now):
            self._opened_at = math.inf
            return
        self._opened_at = min(self._opened_at, a.awake)
        if a.awake - self._opened_at > SENT_WITHIN:
            late = a.awake - self._sent_at
            require(
                late <= SENT_WITHIN, f"the stream of {self._now.sender!r} is open, without a command for {late:g} s"
            )
        snapshot = a.snapshot
        stood = now - max(self._stands_since, self._now.begun)
        if snapshot is None or snapshot.moving or stood < DWELLED + a.longest_transition or a.had("cubes", now - 5.0):
            return
        locked, tip = unpack(snapshot.locked), a.modules.tips.get(unpack(snapshot.measured))
        if locked or any(a.in_force()) or tip is None or a.had("slow search", now - 5.0):
            return
        if a.modules.near(self._target, self._tolerance / 2):
            apart = math.dist(tip.position, self._target)
            require(apart <= 1.5 * self._tolerance + 0.02, f"the tip is {apart:g} from a target that stands still")


def fields_of(payload: bytes) -> tuple[tuple[float, ...], float, float]:
    """Returns position, stamp and tolerance of a set-point or tip; an empty position if it is malformed."""
    body = body_of(payload)
    position = body.get("position")
    if not isinstance(position, list) or len(position) != 2:
        return (), 0.0, 0.0
    return tuple(position), float(body.get("stamp", 0.0)), float((body.get("tolerance") or {}).get("position") or 0.0)
