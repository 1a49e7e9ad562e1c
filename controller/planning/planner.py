"""The planner as the gateway uses it."""

import contextlib
import uuid
from collections.abc import Collection, Iterator

import msgspec
import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.arm.description import density, description, drawing, file
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.decoding.decoding import decode
from hyperbit.controller.flight_recorder import FlightRecorder
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.motion.decoding import payloads
from hyperbit.controller.motion.decoding.goal import Id, check_reach, parse
from hyperbit.controller.motion.decoding.requests import decode_degrade, decode_fault, decode_jog, decode_obstacles
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.obstacles.obstacles import NONE
from hyperbit.controller.planning.core import events
from hyperbit.controller.planning.core.core import Beginning, Core
from hyperbit.controller.planning.core.tasks import BuildScene, BuildTables
from hyperbit.controller.planning.link import ExecutorLink
from hyperbit.controller.planning.loop import Loop, Services
from hyperbit.controller.planning.workers.computations import build_scene, build_tables
from hyperbit.controller.planning.workers.pool import Workers
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.workspace.densities import Densities


class Planner:  # for any thread
    def __init__(self, arm: Arm, densities: Densities, loop: Loop) -> None:
        self.loop, self.decoder = loop, RequestDecoder(arm)
        self._arm, self._densities, self._description = arm, densities, description(arm)

    def description(self, wanted: Collection[str] = ()) -> Description:
        """Returns the constant parts of the description, with those `wanted`: drawing, file, density."""
        return replace(
            self._description,
            drawing=drawing(self._arm) if "drawing" in wanted else UNSET,
            file=file(self._arm) if "file" in wanted else UNSET,
            density=density(self._densities, planar=self._arm.manipulator.planar) if "density" in wanted else UNSET,
        )


@contextlib.contextmanager
def planning(
    arm: Arm,
    densities: Densities,
    link: ExecutorLink,
    services: Services,
    recorder: FlightRecorder | None = None,
    *,
    simulated: bool = False,
) -> Iterator[Planner]:
    """Yields a planner with its core and workers; at the end goals end, and all parts close.

    `arm` has its wiring, `densities` are of the arm reduced by locked actuators. If `simulated`, the executor simulates
    the boards.
    """
    known = services.ledger.known
    weights = weights_of(arm, dict(zip(arm.manipulator.actuators, known, strict=True)))
    tables = build_tables(arm, densities, weights, BuildTables(0, arm.locked.astype(np.uint8).tobytes()))
    built, published = build_scene(arm, BuildScene(0, NONE)), services.published.known()
    name, owed = uuid.uuid4().hex[:8], services.ledger.owed
    beginning = Beginning(name, tables, built.scene, built.total, known, published, owed, simulated)
    core = Core(arm, pace_of(arm.settings), beginning)
    if recorder is not None:
        recorder.begin(core, lambda count: True)
    with contextlib.ExitStack() as closing:
        workers = Workers(arm, densities, weights, services.inbox.post, services.fatal)
        closing.callback(workers.close)
        loop = Loop(core, link, workers, services, recorder)
        closing.callback(loop.close)
        closing.callback(loop.end_goals)
        yield Planner(arm, densities, loop)


class _NamedGoal(msgspec.Struct):  # the payload of a `cancel`; other fields are ignored
    id: Id | None = None


class RequestDecoder:
    """Decodes the requests for one arm. Thread-safe."""

    def __init__(self, arm: Arm) -> None:
        manipulator, tracker = arm.manipulator, arm.settings.tracker
        self.tracker = tracker is not None  # whether measured tips are accepted
        self._actuators, self._dimension = manipulator.actuators, manipulator.dimension
        self._base = manipulator.base[: manipulator.dimension, 3].tolist()
        self._farthest = manipulator.length + (tracker.clamp if tracker else 0.0)  # greatest distance of a tip
        self._tolerance = arm.tolerance

    def decode(self, key: events.Key, payload: bytes) -> events.Message:
        """Decodes any payload in microseconds; None for keys without a content. Raises only Refusal."""
        match key:
            case "goal" | "plan":  # refuses positions beyond the arm's length without a search
                goal = parse(payload)
                check_reach(goal, self._base, self._farthest, self._tolerance)
                return goal
            case "jog":
                return decode_jog(payload, self._actuators)
            case "cancel":
                return decode_cancel(payload)
            case "degrade":
                return decode_degrade(payload)
            case "obstacles":
                obstacles = decode_obstacles(payload, self._dimension)
                return events.SentObstacles(obstacles, decode(payload)["regions"])
            case "fault":
                return decode_fault(payload)
            case "stop" | "reset" | "arm":
                return None


def decode_cancel(payload: bytes) -> events.CancelMessage:
    """Returns the content of a `cancel`: the goal of {"id": ...}, or all goals.

    A payload that cannot be read cancels all: a cancel must never do less than its sender wanted.
    """
    if not payload:
        return events.CancelMessage()
    try:
        return events.CancelMessage(payloads.parse(payload, _NamedGoal, "cancel").id)
    except Refusal as refusal:
        return events.CancelMessage(unread=str(refusal))
