"""Processor time and memory of judging designs, and what first searches find among obstacles.

    python -m tests.benchmarks.design.cost --designs 20

Twelve truss modules and 40 targets: time of a design, and its ratio to a bare loop of `solve` whose tables are ready.
Then as many designs as `--memory` in one process. Then targets among obstacles, by the first efforts and by 1,000.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

import hyperbit as hb
from hyperbit.controller.design.judging import judge
from hyperbit.controller.design.merit import Effort, Judged, Target
from tests.design.making import judged_fields

FIRST, LONG = Effort(20.0, 200.0), Effort(1000.0, 1000.0)
DISCS = [{"disc": {"centre": centre, "radius": 0.2}} for centre in ([0.45, 1.3], [-0.5, 1.0], [0.1, 2.4])]


def design(random: np.random.Generator, modules: int, obstacles: list[dict[str, object]]) -> Judged:
    short = random.uniform(0.18, 0.22)
    truss = {"type": "vgt", "count": modules, "width": random.uniform(0.16, 0.24), "lengths": [short, short + 0.06]}
    fields = {"name": "design", "modules": [truss], "tolerance": {"position": 5e-4 if not obstacles else 2e-3}}
    return judged_fields({**fields, "obstacles": obstacles, "body_radius": 0.01 if obstacles else 0.0})


def targets(random: np.random.Generator, count: int) -> list[Target]:
    middle, size = np.array([0.0, 1.9]), np.array([2.0, 1.2])
    return [Target(middle + size * (random.random(2) - 0.5)) for _ in range(count)]


def loop(own: Judged, goals: list[Target]) -> float:
    """Returns the processor time of a bare loop over the targets [s]."""
    ik = hb.Solver(hb.Arm._of(own.arm, own.locked))
    ik.solve(goals[0].goal, effort=1, missed=1)
    began, start = time.process_time(), ik.arm.home
    for goal in goals:
        found = ik.solve(goal.goal, start, effort=20, missed=200)
        start = found.configuration if found.within_tolerance else start
    return time.process_time() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--designs", type=int, default=20)
    parser.add_argument("--memory", type=int, default=300)
    options = parser.parse_args()
    random = np.random.default_rng(0)
    goals, times = targets(random, 40), list[tuple[float, float]]()
    judge(design(random, 12, []), goals, FIRST)
    for _ in range(options.designs):
        own, began = design(random, 12, []), time.process_time()
        judge(own, goals, FIRST)
        times.append((time.process_time() - began, loop(own, goals)))
    seconds, bare = np.median(times, axis=0)
    print(
        f"{seconds:.3f} s of processor a design, {bare:.3f} s for a bare loop: {seconds / bare:.2f} times", flush=True
    )
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    for _ in range(options.memory):
        judge(design(random, int(random.integers(8, 17)), []), goals[:3], FIRST)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"at most {before:.0f} MiB before, {after:.0f} MiB after {options.memory} more designs", flush=True)
    found = np.zeros(2, dtype=int)
    for _ in range(options.designs // 2):
        own, places = design(random, 12, DISCS), targets(random, 12)
        for k, effort in enumerate((FIRST, LONG)):
            merit = judge(own, places, effort)
            found[k] += sum(one is not None and one.within_tolerance for one in merit.solutions)
    print(f"among obstacles {found[0]} targets by first searches, {found[1]} by effort 1,000", flush=True)


if __name__ == "__main__":
    main()
