"""The events of the planner's core are recorded and replayed, with checkpoints in mid goal."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from hyperbit.controller.flight_recorder import FlightRecorder, Label
from hyperbit.controller.host.keeper import save
from hyperbit.controller.planning.core.core import OPAQUE, Core
from hyperbit.controller.planning.core.events import Action, Event
from hyperbit.controller.program import Program
from tests.planning.rig.desk import Desk
from tests.simulation.events import replay
from tests.simulation.loading import load

A, B, C = (1, 0, 0, 0), (1, 1, 0, 0), (2, 1, 0, 1)


@pytest.fixture
def recorder(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> Iterator[FlightRecorder]:
    outside = {"manipulator": desk.arm.manipulator}
    step = Core.step
    label = Label("planner", f"recorded-{os.getpid()}", "digest")
    with FlightRecorder(label, None, OPAQUE, outside) as recorder:

        def step_recorded(self: Core, event: Event, now: float, wall: float) -> list[Action]:
            actions = step(self, event, now, wall)
            if self is desk.core:  # not that of a daemon which another test has left to its end
                recorder(event, now, wall, actions)
            return actions

        with monkeypatch.context() as patched:
            patched.setattr(Core, "step", step_recorded)
            recorder.begin(desk.core, lambda count: True)
            yield recorder


def test_goals_are_reproduced(
    desk: Desk, recorder: FlightRecorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.goal(A, B)
    program = desk.executor.expect(Program)
    desk.executor.accept(program)
    recorder.begin(desk.core, lambda count: True)  # in mid goal
    desk.executor.run(program, 0)
    desk.executor.run(program, 1)
    desk.executor.end(program)
    payloads = dict(desk.inbox.payloads)
    assert payloads["result"]["status"] == "succeeded", payloads
    path = save(recorder.paths, tmp_path, "request")
    monkeypatch.undo()
    generations = load(path, lambda about: {"manipulator": desk.arm.manipulator})
    found = replay(generations)
    assert found.difference is None, found.difference.words()
    assert [generation.core is not None for generation in generations] == [True, True]
    assert all(generation.entries for generation in generations)
