"""The planner as the gateway uses it."""

import contextlib
import itertools
import json
import math
import time
import uuid
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from controller.config import Arm
from controller.description import density, description, drawing, file
from controller.flight_recorder import FlightRecorder
from controller.motion.codes import GOAL_TOLERANCE_VIOLATED, Refusal
from controller.motion.goal import GoalMessage, Id, parse
from controller.motion.pacing import pace_of
from controller.motion.requests import decode_degrade, decode_jog, decode_obstacles
from controller.notify import Notifier
from controller.obstacles.obstacles import NONE
from controller.planning.core import events
from controller.planning.core.core import Beginning, Core
from controller.planning.core.tasks import BuildScene, BuildTables
from controller.planning.ledger import Ledger, PublishedResults
from controller.planning.link import ExecutorLink, Inbox
from controller.planning.loop import Loop, OnReply, Out, Receive, Services
from controller.planning.workers.arm_model import build_scene, build_tables
from controller.planning.workers.pool import Workers
from controller.program import Cancel, Fault, Halt
from controller.workspace.densities import Densities

CANCELED = "canceled; the arm holds"
LAST_RESULTS = 1.5  # [s] for the core and the executor to end the running goal


class Outside(NamedTuple):
    """What the planner needs from its process.

    Attributes:
        inbox: of the loop; the others post their events there.
        ledger: of goals and switches.
        published: marks of published results.
        out: sends publications.
        notifier: notifies systemd.
        warnings: returns the active warnings of the clock, the network and the ledger.
        fatal: ends the process with a message.
    """

    inbox: Inbox
    ledger: Ledger
    published: PublishedResults
    out: Out
    notifier: Notifier
    warnings: Callable[[], tuple[Fault, ...]]
    fatal: Callable[[str], None]


class Planner:
    """Passes requests to the core. For any thread; all methods but `end_goals` and `close` return at once.

    Args:
        arm: with wiring.
        densities: of the arm reduced by the actuators that its file declares stuck.
        loop: around the core; started and closed with this object.
        link: of the loop.
    """

    def __init__(self, arm: Arm, densities: Densities, loop: Loop, link: ExecutorLink) -> None:
        self._arm, self._densities, self._loop, self._link = arm, densities, loop, link
        self._decoder, self._description = RequestDecoder(arm), description(arm)
        self._numbers = itertools.count(1)

    def start(self) -> None:
        """Starts the loop, which connects to the executor."""
        self._loop.start()

    def end_goals(self) -> None:
        """Ends the running goal, and waits for its result; the executor stays connected."""
        self._loop.post(events.Quit())
        self._loop.ended.wait(LAST_RESULTS)

    def close(self) -> None:
        """Ends goals, the loop, and the connection to the executor."""
        self.end_goals()
        self._loop.close()
        self._link.close()

    # --- requests

    def decode(self, key: events.Key, payload: bytes) -> events.Message:
        """Returns the content of a request; see `RequestDecoder.decode`.

        Raises:
            Refusal: the payload is invalid.
        """
        return self._decoder.decode(key, payload)

    def request(self, key: events.Key, message: events.Message, reply: OnReply) -> None:
        """Posts a request. A stop, or a cancel without an id, goes to the executor before this method returns.

        Simultaneous requests of several threads may reach the core in another order than their numbers.

        Args:
            key: of the interface.
            message: of `decode`.
            reply: takes the answer, once, in the loop's thread; must not wait.
        """
        number = next(self._numbers)
        self._loop.request(events.Request(number, key, message, time.time()), reply)
        if key == "stop":
            reason = self._link.send_now(Halt(number))
        elif key == "cancel" and message == events.CancelMessage():
            reason = self._link.send_now(Cancel(number, None, CANCELED))
        else:
            return
        if reason is not None:
            self._loop.post(events.Unsent(number, reason))

    def read_setpoints(self, receive: Receive) -> None:
        """Sets the mailbox of set-points: `receive` returns the latest, or None, and never waits."""
        self._loop.read(events.SetpointArrived, receive)

    def read_measured_tips(self, receive: Receive) -> None:
        """Sets the mailbox of measured tips; see `read_setpoints`."""
        self._loop.read(events.TipArrived, receive)

    def description(self, wanted: Collection[str] = ()) -> events.Payload:
        """Returns the parts of the payload of `arm` that do not change.

        Args:
            wanted: parts to include besides: "drawing", "file", "density".
        """
        made: dict[str, Callable[[], events.Payload | None]] = {
            "drawing": lambda: drawing(self._arm),
            "file": lambda: file(self._arm),
            "density": lambda: density(self._densities, planar=self._arm.manipulator.planar),
        }
        return {**self._description, **{name: make() for name, make in made.items() if name in wanted}}


@contextlib.contextmanager
def planning(
    arm: Arm, densities: Densities, link: ExecutorLink, outside: Outside, recorder: FlightRecorder | None = None
) -> Iterator[Planner]:
    """A planner with its core and workers; at the end all are closed. `recorder` takes each step of the core."""
    known = outside.ledger.known()
    weights = arm.weights(dict(zip(arm.manipulator.actuators, known, strict=True)))
    tables = build_tables(arm, densities, weights, BuildTables(0, arm.locked.astype(np.uint8).tobytes())).tables
    built, published = build_scene(arm, BuildScene(0, NONE)), outside.published.known()
    owed = tuple(goal for goal in outside.ledger.owed() if not recorded(goal, outside))
    beginning = Beginning(uuid.uuid4().hex[:8], tables, built.scene, built.total, known, published, owed)
    workers = Workers(arm, densities, weights, outside.inbox.post, outside.fatal)
    with contextlib.closing(workers):
        services = Services(workers, outside.ledger, outside.out, outside.notifier, outside.warnings, outside.fatal)
        core = Core(arm, pace_of(arm.settings), beginning)
        if recorder is not None:
            recorder.begin(core, lambda count: True)
        loop = Loop(core, outside.inbox, link, services, recorder)
        with contextlib.closing(Planner(arm, densities, loop, link)) as planner:
            yield planner


def recorded(goal: events.OpenGoal, outside: Outside) -> bool:
    """Records a result that an earlier process published and did not record; returns whether there is one."""
    mark = outside.published.find(goal.identity)
    if mark is not None:
        ended = events.Ended(time.time(), mark.status, mark.code, mark.message, mark.switches)
        outside.ledger.record(events.Record(0, goal.identity, None, ended))
    return mark is not None


class _NamedGoal(msgspec.Struct):
    """The payload of a `cancel` of one goal; other fields are ignored."""

    id: Id


class RequestDecoder:
    """Decodes requests. For any thread.

    Args:
        arm: that the requests are for.
    """

    def __init__(self, arm: Arm) -> None:
        manipulator, tracker = arm.manipulator, arm.settings.tracker
        self._actuators, self._dimension = manipulator.actuators, manipulator.dimension
        self._base = manipulator.base[: manipulator.dimension, 3].tolist()
        self._farthest = manipulator.length + (tracker.clamp if tracker else 0.0)  # of a tip from the base
        self._tolerance = arm.tolerance

    def decode(self, key: events.Key, payload: bytes) -> events.Message:
        """Returns the content of a request, in microseconds; None for keys without a content.

        Args:
            key: of the interface.
            payload: as it came, any bytes.

        Raises:
            Refusal: the payload is invalid; the message names the field. No other exception is raised.
        """
        match key:
            case "goal" | "plan":
                return self._goal(payload)
            case "jog":
                return decode_jog(payload, self._actuators)
            case "cancel":
                return decode_cancel(payload)
            case "degrade":
                lock = decode_degrade(payload)
                return events.LockMessage(lock.actuator, lock.state)
            case "obstacles":
                obstacles = decode_obstacles(payload, self._dimension)
                return events.ObstaclesMessage(obstacles, json.loads(payload)["regions"])
            case "stop" | "reset" | "arm":
                return None

    def _goal(self, payload: bytes) -> GoalMessage:
        """Returns a goal; positions beyond the arm's length are refused here, without a search."""
        message = parse(payload)
        farthest = self._farthest + (message.tolerance.position or self._tolerance)
        for k, waypoint in enumerate(message.waypoints):
            position = waypoint.position
            if position is None or len(position) != self._dimension:
                continue
            away = math.dist(position, self._base)
            if away > farthest:
                where = f"waypoints[{k}].position: ({', '.join(f'{x:g}' for x in position)}) is out of reach"
                words = f"{where}: {away:g} from the base, and no tip is farther from it than {self._farthest:g}"
                raise Refusal(GOAL_TOLERANCE_VIOLATED, words, message.id)
        return message


def decode_cancel(payload: bytes) -> events.CancelMessage:
    """Returns the content of a `cancel`: the goal that {"id": ...} names.

    Any other payload cancels whatever runs, because a cancel must not fail for its form.
    """
    try:
        return events.CancelMessage(msgspec.json.decode(payload, type=_NamedGoal).id)
    except (msgspec.MsgspecError, RecursionError, UnicodeError):
        return events.CancelMessage()
