"""What a commissioner does beside an arm: it tries actuators, cancels, resets, and leaves."""

from __future__ import annotations

from random import Random

from hyperbit.controller.program import Cancel, Down, Lock, Reset, Snapshot
from tests.simulation.executor.programs import Author

NOBODY = 10**9  # number of the requests whose answers nobody awaits
TRIES = {"trial": 30, "wait": 20, "cancel": 3, "cancel program": 2, "reset": 1, "operator": 1, "planner": 1}
TRIES |= {"acknowledge": 4, "forbidden": 0.5}


def commissioning(
    author: Author, random: Random, snapshot: Snapshot, number: int, now: float
) -> tuple[str, Down | None]:
    """Returns the name of an act, and the message that it sends if it is one; `number`: of its trial or program."""
    if snapshot.mode in ("fault", "stopped") and random.random() < 0.2:
        return "reset", Reset(NOBODY, snapshot.epoch)
    act = random.choices(list(TRIES), list(TRIES.values()))[0]
    match act:
        case "trial":
            return act, author.trial(snapshot, number, now)
        case "cancel":
            return act, Cancel(NOBODY, None, "canceled by a person")
        case "cancel program":
            return act, Cancel(NOBODY, number - random.randint(0, 1), "left")
        case "reset":
            return act, Reset(NOBODY, snapshot.epoch - (random.random() < 0.2 and snapshot.epoch > 0))
        case "forbidden":
            stream, drawn = author.setpoint(snapshot, number, now), author.program(snapshot, number, now)
            return act, random.choice([drawn.program, stream, Lock(NOBODY, 0, 1)])
        case _:
            return act, None
