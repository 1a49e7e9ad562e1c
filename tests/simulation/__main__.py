"""Runs worlds of an executor on a simulated clock: `python -m tests.simulation --seed N --steps M`."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

from tests.simulation import events
from tests.simulation.world import World

STEPS_A_SEED = 20_000
MOST_FAILED = 20  # failed seeds, after which the run ends


def main() -> int:
    """Runs one seed, or as many seeds as the steps need; returns 1 if a seed fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, help="run only this seed; without it, many seeds from 0")
    parser.add_argument("--steps", type=int, default=STEPS_A_SEED, help="number of steps of all seeds")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--events", type=Path, metavar="FILE", help="replay the recorded events of a process instead")
    options = parser.parse_args()
    if options.events is not None:
        return events.main(options.events)
    began, steps, seed = time.monotonic(), 0, options.first if options.seed is None else options.seed
    counts: Counter[str] = Counter()
    failed: list[int] = []
    while steps < options.steps and len(failed) < MOST_FAILED:
        most = options.steps - steps if options.seed is not None else min(STEPS_A_SEED, options.steps - steps)
        world = World(seed)
        try:
            world.run(most)
        except Exception as error:
            failed.append(seed)
            if options.seed is not None:
                print(world.story())
                print(f"seed {seed}, step {world.agenda.steps}: {type(error).__name__}: {error}")
                print(world.arm)
                raise
            print(f"seed {seed}, step {world.agenda.steps}: {type(error).__name__}: {error}", flush=True)
        steps += world.agenda.steps
        counts += world.record.counts + world.trouble.made
        counts += Counter({f"sent {kind}": count for kind, count in world.planner.connection.sent.items()})
        counts["simulated seconds"] += round(world.agenda.now - 1000.0)
        if options.seed is not None:
            break
        seed += 1
    seeds = f"seed {seed}" if options.seed is not None else f"seeds {options.first} to {seed - 1}"
    print(f"{steps} steps, {seeds}, {time.monotonic() - began:.0f} s")
    for name, count in sorted(counts.items()):
        print(f"  {name}: {count}")
    print(f"failed seeds: {failed}" if failed else "no invariant was violated")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
