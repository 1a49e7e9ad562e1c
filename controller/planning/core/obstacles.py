"""The obstacles of the arm's file, and those sent since: their generation, checks among them, and requests for others.

A new generation counts from its request on. No unchecked stage begins until the new scene is built and all stages in
flight were checked in it.
"""

import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from hyperbit.controller.messages.goals import done, refused
from hyperbit.controller.messages.parts import Region
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.events import SentObstacles, ToExecutor
from hyperbit.controller.planning.core.parts import Parts, Pending
from hyperbit.controller.planning.core.tasks import Answer, SceneBuilt, VersionedScene
from hyperbit.controller.program import Clearance, Question
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

CHECKED_AGAIN = 1.0  # [s] until a failed check of the resting arm is repeated
LONGEST = 5.0  # [s], longest wait of the answer to new obstacles for checks of programs in flight


@dataclass(eq=False)
class Change(Pending):
    generation: int = 0  # of its obstacles
    effects: list[str] = field(default_factory=list)  # on running goals, as sentences


class ObstacleOwner:
    def __init__(self, parts: Parts, scene: VersionedScene, total: int) -> None:
        self.generation = scene.generation  # grows with each change
        self.standing: str | None = None  # the collision of the arm at rest, in words
        self._view, self._jobs, self._moment, self._act = parts.view, parts.jobs, parts.moment, parts.act
        self._sent: SentObstacles | None = None  # the obstacles of this generation
        self._built = SceneBuilt(scene, total, 0)  # the last scene
        self._built_of: SentObstacles | None = None  # its message
        self._requests = parts.requests
        self._questions: list[Question] = []
        self._standing_seen: tuple[int, bytes, bytes] | None = None  # inputs of the last check
        self._standing_job: int | None = None
        self._standing_from = -math.inf  # time of the next check [s]

    @property
    def scene(self) -> VersionedScene | None:
        """The scene of this generation; None while it is built."""
        return self._built.scene if self._built.scene.generation == self.generation else None

    @property
    def regions(self) -> list[Region]:
        return [] if self._sent is None else self._sent.regions

    # --- requests

    def change(self, request: int, message: SentObstacles) -> bool:
        """Stores other obstacles; returns whether they differ from the present ones."""
        before, obstacles = self._sent, message.obstacles
        same = not len(obstacles) if before is None else same_content(before.obstacles, obstacles)
        self.generation += not same
        self._requests.add(Change(request, self._moment.now, self.generation))
        if same:
            return False
        self._sent = message
        task = tasks.BuildScene(self.generation, obstacles)
        self._jobs.start(task, partial(self._scene_answered, self.generation))
        return True

    def check(self, unchecked: list[str]) -> None:
        """Asserts that requests wait only for a scene or a check of this generation; see `Core.check`."""
        generation = self._built.scene.generation
        assert generation <= self.generation, f"scene {generation} is newer than its obstacles"
        waits = self.scene is None or unchecked or self._standing_job is not None
        changes = self._requests.of(Change)
        assert waits or not changes, f"{changes} have no answer"
        assert self.scene is None or self._built_of is self._sent, "the obstacles are not those of the scene"
        assert self.scene is None or not self._questions, "a question of the executor waits for nothing"

    def note(self, effect: str) -> None:
        for change in self._requests.of(Change):
            change.effects.append(effect)

    def answer(self, unchecked: list[str], at_once: bool = False) -> None:
        """Answers requests if all programs in flight are checked; `unchecked` are the ids of goals that are not."""
        if self.scene is None:
            if at_once:
                self._refuse(Refusal(Reason.SHUTTING_DOWN), since=0)
            return
        checked = not unchecked and self._standing_job is None
        for change in self._requests.of(Change):
            if checked or at_once or self._moment.now > change.since + LONGEST:
                _, total, sent = self._built
                said = f"{total} {'obstacle' if total == 1 else 'obstacles'}, {sent} of them sent"
                standing = [] if self.standing is None else [f"{self.standing} where the arm stands"]
                later = [f"goal {goal} is still being checked, no stage begins before" for goal in unchecked]
                self._requests.end(change, done("; ".join([said, *standing, *change.effects, *later])))

    def _scene_answered(self, generation: int, answer: Answer) -> None:
        if generation != self.generation:
            return
        if isinstance(answer, SceneBuilt):
            self._built, self._built_of = answer, self._sent
        else:  # the previous obstacles stay valid, as a new generation, because all programs were parked
            self._refuse(Refusal(Reason.OBSTACLES_NOT_CHECKED), since=self._built.scene.generation + 1)
            self.generation += 1
            self._built = self._built._replace(scene=self._built.scene._replace(generation=self.generation))
            self._sent = self._built_of
        questions, self._questions = self._questions, []
        for question in questions:
            self.ask(question)

    def _refuse(self, refusal: Refusal, since: int) -> None:
        """Refuses the requests of the generations from `since` on; those before are in force."""
        for change in self._requests.of(Change):
            if change.generation >= since:
                self._requests.end(change, refused(refusal))

    # --- the executor's questions

    def ask(self, question: Question) -> None:
        """Answers the executor: with what a stage collides from states for which it was not planned."""
        scene = self.scene
        if scene is None:
            self._questions.append(question)
        elif scene.free:
            self._act(ToExecutor(Clearance(question.question, None)))
        else:
            task = tasks.CheckStages(scene, question.start, (question.stage,))
            self._jobs.start(task, partial(self._question_answered, question, scene.generation))

    def _question_answered(self, question: Question, generation: int, answer: Answer) -> None:
        if generation != self.generation:
            self.ask(question)
            return
        touched = tasks.collision_of(answer)
        self._act(ToExecutor(Clearance(question.question, None if touched is None else touched[:1_000])))

    # --- where the arm stands

    def check_standing(self) -> None:
        """Checks whether the arm collides where it stands, if this may have changed. Call at the end of each step."""
        scene, state = self.scene, self._view.state
        if scene is None or state is None or self._standing_job is not None or self._moment.now < self._standing_from:
            return
        depends = scene.generation, state.snapshot.measured, state.snapshot.known
        if depends == self._standing_seen:
            return
        self._standing_seen = depends
        if scene.free or not bool((state.measured >= 0).all()):
            self.standing = None
            return
        task = tasks.CheckStanding(scene, state.snapshot.measured)
        self._standing_job = self._jobs.start(task, self._standing_answered)

    def _standing_answered(self, answer: Answer) -> None:
        self._standing_job = self.standing = None
        if isinstance(answer, tasks.Checked):
            self.standing = answer.collision
        else:
            self._standing_seen, self._standing_from = None, self._moment.now + CHECKED_AGAIN


def same_content(first: Any, second: Any) -> bool:
    arrays = ("kinds", "axes", "centres", "sizes")
    return bool(first.names == second.names) and all(
        np.array_equal(getattr(first, name), getattr(second, name)) for name in arrays
    )
