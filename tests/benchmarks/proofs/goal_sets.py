"""Draws the goal sets of `hyperbit bench` and proves each optimum.

python -m tests.benchmarks.proofs.goal_sets --set NAME

Goals of a set are drawn from a seed, each with a seed of its own. Goals that the file has with a proof are kept; with
--again all are proven again, and a difference ends the program. Without --write nothing is written.
"""

import argparse
import csv
import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.bench.goal_sets import FOLDER, SETS, Task, goal_frame, load_arm, read
from hyperbit.controller.manipulator.frames import angle
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.manipulator.notation import format_configuration
from tests.benchmarks.proofs.acceptance import check_of, clear
from tests.benchmarks.proofs.proof import Proof, prove

# Start, position, angle, tolerances, and a configuration that serves.
Drawn = tuple[Configuration, tuple[float, ...], float | None, float, float, Configuration]
Draw = Callable[[Arm, np.random.Generator], Drawn]

COLUMNS = ("arm", "start", "goal", "tolerance", "angle_tolerance", "bound", "best")
POSE = 0.005, 0.03  # tolerances of poses
ROUNDING = 1e-9  # differences of positions and angles between processors; goals of two seeds differ by far more


def position(arm: Arm, rng: np.random.Generator) -> Drawn:
    start, end = free(arm, rng), free(arm, rng)
    return start, tip(arm, end), None, arm.tolerance, math.inf, end


def pose(arm: Arm, rng: np.random.Generator) -> Drawn:
    start, end = free(arm, rng), free(arm, rng)
    return start, tip(arm, end), float(angle(arm.manipulator.tip(end))), *POSE, end


def lattice(arm: Arm, rng: np.random.Generator) -> Drawn:
    """Draws a point at a lattice distance from a tip, with this distance or an adjacent float as tolerance; or the tip.

    Goals out of reach are drawn again.
    """
    m = arm.manipulator
    while True:
        start, end = rng.integers(0, m.states), rng.integers(0, m.states)
        goal = np.array(tip(arm, end))
        if rng.random() < 0.25:
            return start, tuple(goal.tolist()), None, 0.01, math.inf, end
        away = float(rng.choice((0.125, 0.25, 0.5)))
        goal[rng.integers(m.dimension)] += away * rng.choice((-1.0, 1.0))
        tolerance = float(np.nextafter(away, away + rng.integers(-1, 2)))
        numbers = tuple(goal.tolist())
        end = prove(arm.clearance(), goal_frame(numbers, None), start, tolerance).configuration
        if end is not None:
            return start, numbers, None, tolerance, math.inf, end


def free(arm: Arm, rng: np.random.Generator) -> Configuration:
    check = check_of(arm.clearance(), np.eye(4), 1.0, math.inf)
    while True:
        own = rng.integers(0, arm.manipulator.states)
        if clear(check, own):
            return own


def tip(arm: Arm, configuration: NDArray[np.int64]) -> tuple[float, ...]:
    return tuple(arm.manipulator.tip(configuration)[: arm.manipulator.dimension, 3].tolist())


LATTICES = ("lattice-slides", "lattice-turns", "lattice-mixed", "lattice-space", "lattice-boxes")
SCENES = {f"planar16-{name}": 35 for name in ("pillar", "gate", "room", "clutter")}
SCENES |= {f"platform8-{name}": 30 for name in ("spheres", "corner")}

Recipe = tuple[Draw, int, dict[str, int]]  # how goals are drawn, a seed, and how many for each arm

RECIPES: dict[str, Recipe] = {
    "paper": (position, 1, {"planar16": 1000}),
    "paper-poses": (pose, 2, {"planar16": 200}),
    "planar16": (position, 3, {"planar16": 200}),
    "revolute24": (position, 4, {"revolute24": 200}),
    "platform8": (position, 5, {"platform8": 200}),
    "motor12": (position, 6, {"motor12": 200}),
    "lattice": (lattice, 7, dict.fromkeys(LATTICES, 40)),
    "obstacles": (position, 8, SCENES),
}


def drawn(recipe: Recipe) -> list[tuple[str, Drawn]]:
    draw, seed, counts = recipe
    seeds = [(arm, [seed, k, n]) for k, (arm, count) in enumerate(counts.items()) for n in range(count)]
    return [(arm, draw(load_arm(arm), np.random.default_rng(own))) for arm, own in seeds]


def prove_task(task: Task, seconds: float, known: Configuration | None = None) -> Proof:
    own = task.frame, task.start, task.tolerance, task.angle_tolerance
    return prove(load_arm(task.arm).clearance(), *own, seconds=seconds, known=known)


def row_of(arm: str, asked: Drawn, seconds: float) -> dict[str, str]:
    start, goal, turned, tolerance, turn, end = asked
    m = load_arm(arm).manipulator
    proof = prove_task(Task(arm, start, goal, turned, tolerance, turn, 0, end, 0), seconds, end)
    assert proof.configuration is not None
    numbers = goal if turned is None else (*goal, turned)
    return {
        "arm": arm,
        "start": format_configuration(m, start),
        "goal": " ".join(map(repr, numbers)),
        "tolerance": repr(tolerance),
        "angle_tolerance": "" if turned is None else repr(turn),
        "bound": str(proof.bound),
        "best": format_configuration(m, proof.configuration),
    }


def same(task: Task, arm: str, asked: Drawn) -> bool:
    """Returns whether a set has a goal as the seed draws it.

    Positions and angles agree within ROUNDING, since their last bits depend on the processor. Start and tolerances are
    not computed, and agree exactly.
    """
    start, goal, turned, *tolerances, _ = asked
    return (
        (task.arm, task.angle is None) == (arm, turned is None)
        and [task.tolerance, task.angle_tolerance] == tolerances
        and bool(np.array_equal(task.start, start))
        and bool(np.allclose(task.position, goal, rtol=0.0, atol=ROUNDING))
        and bool(np.allclose(task.angle or 0.0, turned or 0.0, rtol=0.0, atol=ROUNDING))
    )


def again(task: Task, seconds: float) -> None:
    proof = prove_task(task, seconds)
    wrong = proof.switches < task.bound or task.switches < proof.bound
    if wrong or (task.proven and proof.proven and proof.switches != task.switches):
        raise SystemExit(f"{task}: proven now: {proof}")


def write(path: Path, rows: list[dict[str, str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", choices=SETS, required=True)
    parser.add_argument("--seconds", type=float, default=60.0, help="no deeper lists for a goal after this time")
    parser.add_argument("--again", action="store_true", help="prove again what the file has")
    parser.add_argument("--write", action="store_true", help="write the set's file, after each goal")
    given = parser.parse_args()
    path = FOLDER / "sets" / f"{given.set}.csv"
    known = read(given.set) if path.exists() else []
    lines = list(csv.DictReader(path.open(newline="", encoding="utf-8"))) if path.exists() else []
    rows: list[dict[str, str]] = []
    bounds = 0
    for n, (arm, asked) in enumerate(drawn(RECIPES[given.set])):
        kept = n < len(known) and same(known[n], arm, asked)
        if kept and given.again:
            again(known[n], given.seconds)
        rows.append(lines[n] if kept and (given.again or known[n].proven) else row_of(arm, asked, given.seconds))
        bounds += int(rows[-1]["bound"] != str(known[n].switches)) if kept and given.again else 0
        if given.write:
            write(path, rows + lines[len(rows) :])
        sys.stderr.write(f"\r{given.set}: {n + 1}")
    sys.stderr.write(f"\n{given.set}: {len(rows)} goals, {len(rows) - bounds} of them with a proof\n")


if __name__ == "__main__":
    main()
