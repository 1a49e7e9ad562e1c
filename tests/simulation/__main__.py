"""Runs worlds on a simulated clock: `python -m tests.simulation --seed N --steps M`.

Each seed has three worlds: one with a scripted planner before the executor, one with the whole daemon, and one with
boards and the CANopen master alone. Each kind gets a third of the steps.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from tests.simulation import events
from tests.simulation.fieldbus.world import BoardWorld
from tests.simulation.statements.every import OF_CLIENTS, OF_THE_ARM, OF_THE_EXECUTOR
from tests.simulation.verdict import Violation
from tests.simulation.whole.planner_process import LOGS
from tests.simulation.world import World

KINDS = ("scripted", "whole", "boards")
STEPS_A_SEED = {"scripted": 5_000, "whole": 15_000, "boards": 3_000}  # many arms find more than long lives
LONG = 100_000  # steps of scripted or whole worlds, within which each of their statements must have been armed
JUDGES = {"scripted": OF_THE_EXECUTOR, "whole": (*OF_CLIENTS, *OF_THE_ARM), "boards": ()}  # statements with a floor
MOST_FAILED = 20  # failed seeds, after which the run ends


def main() -> int:
    """Runs one seed, or as many seeds as the steps need; returns 1 if a seed fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, help="run only this seed; without it, many seeds from 0")
    parser.add_argument("--steps", type=int, default=15_000, help="number of steps of all seeds")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--kind", choices=KINDS, help="only worlds of this kind; without it, all in turn")
    parser.add_argument("--events", type=Path, metavar="FILE", help="replay the recorded events of a process instead")
    options = parser.parse_args()
    for log in LOGS:
        log.setLevel(logging.CRITICAL + 1)
    if options.events is not None:
        return events.main(options.events)
    began, told = time.monotonic(), options.seed is not None
    kinds = KINDS if options.kind is None else (options.kind,)
    turns = Turns(kinds, options.seed if told else options.first)
    counts: Counter[str] = Counter()
    failed: list[str] = []
    while turns.steps < options.steps and len(failed) < MOST_FAILED:
        kind, seed = turns.next()
        most = -(-options.steps // len(kinds)) if told else min(STEPS_A_SEED[kind], options.steps - turns.steps)
        turns.ran(kind, run(seed, kind, most, told, counts, failed))
        if told and all(turns.of.values()):
            break
    seeds = f"seed {options.seed}" if told else f"seeds {turns.seeds()}"
    print(f"{turns.steps} steps, {seeds}, {time.monotonic() - began:.0f} s")
    for name, count in sorted(counts.items()):
        print(f"  {name}: {count}")
    long = [one for kind, steps in turns.of.items() if steps >= LONG for one in JUDGES[kind]]
    idle = [one.title() for one in long if counts[f"{one.title()}: armed"] < one.least]
    if idle:
        print(f"too seldom armed: {', '.join(idle)}")
    print(f"failed seeds: {failed}" if failed else "no statement was violated")
    return bool(failed or idle)


class Turns:
    """Which world runs next: that of the kind with the fewest steps so far, with its next seed.

    Attributes:
        of: number of steps of each kind.

    Args:
        first: seed of the first world of each kind.
    """

    def __init__(self, kinds: Sequence[str], first: int) -> None:
        self.of = dict.fromkeys(kinds, 0)
        self._first, self._seeds = first, dict.fromkeys(kinds, first)

    @property
    def steps(self) -> int:
        return sum(self.of.values())

    def next(self) -> tuple[str, int]:
        kind = min(self.of, key=self.of.__getitem__)
        return kind, self._seeds[kind]

    def ran(self, kind: str, steps: int) -> None:
        self.of[kind] += steps
        self._seeds[kind] += 1

    def seeds(self) -> str:
        return ", ".join(f"{self._first} to {seed - 1} ({kind})" for kind, seed in self._seeds.items())


def world_of(seed: int, kind: str, remembered: int = 300) -> World | BoardWorld:
    """Returns a world with its last `remembered` events."""
    return BoardWorld(seed, remembered) if kind == "boards" else World(seed, kind == "whole", remembered)


def run(seed: int, kind: str, most: int, told: bool, counts: Counter[str], failed: list[str]) -> int:
    """Runs one world; returns the number of its steps."""
    world, name = world_of(seed, kind), f"{seed} {kind}"
    try:
        world.run(most)
    except (Exception, Violation) as error:
        failed.append(name)
        if told:
            print(world.story())
        print(f"seed {name}, step {world.agenda.steps}: {type(error).__name__}: {error}", flush=True)
        if told:
            print(world.arm)
            raise
    counts += world.counts()
    counts["simulated seconds"] += round(world.agenda.now - 1000.0)
    return world.agenda.steps


if __name__ == "__main__":
    sys.exit(main())
