"""The shared parts of the core on a simulated clock, with stand-ins for locks, obstacles and programs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.planning.core.arm import ExecutorView, packed
from hyperbit.controller.planning.core.events import Action, Start
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.premises import Premises
from hyperbit.controller.planning.core.tasks import Answer, Tables, VersionedScene
from hyperbit.controller.program import Fault, Mode, Snapshot

T = TypeVar("T")


class PlayedLocks:
    def __init__(self, view: ExecutorView) -> None:
        self._view, actuators = view, len(view.manipulator.actuators)
        self.tables: Tables | None = Tables(1, b"\xff" * actuators)
        self.states: NDArray[np.int8] = np.full(actuators, -1, np.int8)

    def mode(self) -> tuple[Mode, str]:
        return self._view.mode()

    @property
    def listed(self) -> list[tuple[str, int]]:
        labels = self._view.manipulator.actuators
        return [(labels[k], int(self.states[k])) for k in np.flatnonzero(self.states >= 0)]

    def faults(self) -> Iterator[Fault]:
        return (Fault("degraded", label, "locked") for label, _ in self.listed)


@dataclass
class PlayedObstacles:
    scene: VersionedScene | None = field(default_factory=lambda: VersionedScene(1, free=True))
    generation: int = 1
    standing: str | None = None


@dataclass
class PlayedGoal:
    fields: dict[str, Any]

    def present(self, wall: float) -> dict[str, Any]:
        return {**self.fields, "progress": {"ends": wall}}


@dataclass
class PlayedPrograms:
    current: PlayedGoal | None = None
    offered: bool = False
    improving: bool = False
    last_accepted: int = 0


class PlayedCore:
    """The parts of a core with a small arm at rest.

    Attributes:
        actions: those not taken by `take`.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm, self.actions = arm, list[Action]()
        self.view = ExecutorView(arm.manipulator, arm.travel_time, pace_of(arm.settings))
        self.parts = Parts(self.view, pace_of(arm.settings), "played", self.actions.append)
        self.moment, self.admission, self.jobs = self.parts.moment, self.parts.admission, self.parts.jobs
        self.moment.now, self.moment.wall = 100.0, 1e9
        self.locks, self.obstacles, self.programs = PlayedLocks(self.view), PlayedObstacles(), PlayedPrograms()
        self.premises = Premises(self.view, self.locks, self.obstacles, None)  # type: ignore[arg-type]
        size = len(arm.manipulator.actuators)
        none, known = packed(np.zeros(size)), packed(np.ones(size))
        self.snapshot = Snapshot(
            self.now, "ready", "holding", 1, none, none, known, known, none, 0, False, 0.0, -1, -1, -1, ()
        )

    def show(self, **changes: Any) -> None:
        """Takes a snapshot with changes; new outputs are measured, too."""
        if "outputs" in changes:
            changes.setdefault("measured", changes["outputs"])
        self.snapshot = msgspec.structs.replace(self.snapshot, at=self.now, **changes)
        self.view.receive_snapshot(self.snapshot)
        self.admission.snapshot(self.snapshot.epoch)

    @property
    def now(self) -> float:
        return self.moment.now

    @property
    def wall(self) -> float:
        return self.moment.wall

    def advance(self, seconds: float) -> None:
        self.moment.now += seconds
        self.moment.wall += seconds

    def take(self, kind: type[T]) -> list[T]:
        """Returns the actions of a kind since the last call, or the messages of a kind to the executor."""
        contents = [getattr(action, "message", action) for action in self.actions]
        taken = [content for content in contents if isinstance(content, kind)]
        kept = [a for a, content in zip(self.actions, contents, strict=True) if not isinstance(content, kind)]
        self.actions[:] = kept
        return taken

    def task(self, kind: type[T]) -> tuple[int, T]:
        ((number, task),) = self.take(Start)
        assert isinstance(task, kind)
        return number, task

    def answer(self, number: int, answer: Answer) -> None:
        self.jobs.answered(number, answer, True)

    def states(self, *configuration: int) -> bytes:
        return packed(self.arm.manipulator.actuator_states(np.array(configuration)))

    def tip(self, *configuration: int) -> list[float]:
        tip = self.arm.manipulator.tips([configuration])[0]
        return tip[: self.arm.manipulator.dimension, 3].tolist()  # type: ignore[no-any-return]
