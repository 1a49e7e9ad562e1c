"""Replays the recorded events of a planner or executor: `python -m tests.simulation --events FILE`.

The core of the checkpoint takes each event at its time, and each action must be the recorded one. A test can do the
same with a file from the field: `assert replay(load(path, arm_objects)).difference is None`.
"""

from __future__ import annotations

import tempfile
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hyperbit.controller.arm import arm as config
from tests.simulation.loading import Generation, RecordedStep, load


class Difference(NamedTuple):
    """The first step whose actions are not the recorded ones.

    Attributes:
        number: of the event, from 1.
        entry: recorded event and actions.
        actions: of the core now; a string: the exception of its step.
    """

    number: int
    entry: RecordedStep
    actions: list[Any] | str

    def words(self) -> str:
        lines = [f"event {self.number} at {self.entry.now:.6f} s: {self.entry.event}"]
        recorded = self.entry.actions
        if isinstance(self.actions, str):
            return "\n".join([*lines, f"recorded: {recorded}", f"now an exception: {self.actions}"])
        if recorded is None:
            return "\n".join([*lines, "recorded: an exception", f"now: {self.actions}"])
        pairs = zip(recorded, self.actions, strict=False)
        first = next((k for k, pair in enumerate(pairs) if not same(*pair)), min(len(recorded), len(self.actions)))
        for name, actions in (("recorded", recorded), ("now", self.actions)):
            lines.append(f"action {first + 1} {name}: {actions[first] if first < len(actions) else 'none'}")
        return "\n".join(lines)


class Replayed(NamedTuple):
    """The result of a replay.

    Attributes:
        skipped: number of events before the first checkpoint, which cannot be replayed.
        difference: the first one; None if all actions were reproduced.
    """

    count: int
    skipped: int
    difference: Difference | None
    core: Any


def replay(generations: Sequence[Generation]) -> Replayed:
    """Plays the events of a file into its core, until an action differs."""
    core, count, skipped = None, 0, 0
    for generation in generations:
        core = core if generation.core is None else generation.core
        for entry in generation.entries:
            if core is None:
                skipped += 1
                continue
            count += 1
            actions = step(core, entry)
            reproduced = entry.actions is None if isinstance(actions, str) else same(entry.actions, actions)
            if not reproduced:
                return Replayed(count, skipped, Difference(count + skipped, entry, actions), core)
    return Replayed(count, skipped, None, core)


def step(core: Any, entry: RecordedStep) -> list[Any] | str:
    """Returns the actions of a core on a recorded event; the traceback if its step raises an exception."""
    times = (entry.now,) if entry.wall is None else (entry.now, entry.wall)
    try:
        return list(core.step(entry.event, *times))
    except Exception:
        return traceback.format_exc()


def same(recorded: Any, now: Any) -> bool:
    """Returns whether two values are equal; NaN equals NaN, and arrays are compared by element."""
    if isinstance(recorded, np.ndarray) or isinstance(now, np.ndarray):
        return type(recorded) is type(now) and recorded.dtype == now.dtype and recorded.tobytes() == now.tobytes()
    if isinstance(recorded, Mapping) and isinstance(now, Mapping):
        return list(recorded) == list(now) and all(same(recorded[key], now[key]) for key in recorded)
    if isinstance(recorded, list | tuple):
        alike = type(recorded) is type(now) and len(recorded) == len(now)
        return alike and all(same(*pair) for pair in zip(recorded, now, strict=True))
    if hasattr(recorded, "__dataclass_fields__"):
        return type(recorded) is type(now) and same(vars(recorded), vars(now))
    return bool(type(recorded) is type(now) and (recorded == now or (recorded != recorded and now != now)))


def arm_objects(about: Mapping[str, Any]) -> dict[str, object]:
    """Returns what a planner's core refers to by name, made from the recorded text of the arm's file."""
    if not about.get("file"):
        return {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.yaml"
        path.write_text(about["file"])
        arm = config.load(path)
    return {"arm": arm, "manipulator": arm.manipulator}


def main(path: Path) -> int:
    """Replays a file and prints the result; returns 1 if an action differs, or nothing can be replayed."""
    generations = load(path, arm_objects)
    about = generations[-1].about
    digest = str(about.get("digest", ""))[:12]
    began = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(float(about.get("wall", 0.0))))
    print(f"{about.get('kind')} of arm {about['arm']}, file {digest}; last checkpoint at {began} UTC")
    found = replay(generations)
    if found.skipped:
        print(f"the first {found.skipped} events have no checkpoint before them, and are not replayed")
    if found.difference is not None:
        print(found.difference.words())
        return 1
    print(f"{found.count} events, all actions reproduced" if found.count else "there are no events to replay")
    return int(not found.count)
