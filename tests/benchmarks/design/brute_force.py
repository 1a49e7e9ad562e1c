"""The merit of twenty random arms against all of their configurations.

    python -m tests.benchmarks.design.brute_force --arms 20 --bits 21

Searches without a limit of effort must equal brute force. A second line counts what the efforts of a study find.
"""

from __future__ import annotations

import argparse

import numpy as np

from hyperbit.controller.design.judging import judge
from hyperbit.controller.design.merit import Effort
from tests.design.brute import tried
from tests.design.making import random_arm, random_targets

EFFORTS = {"without a limit": Effort(1e6, 1e6), "search 20, missed 200": Effort(20.0, 200.0)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--bits", type=int, default=21)
    parser.add_argument("--targets", type=int, default=10)
    options = parser.parse_args()
    for name, effort in EFFORTS.items():
        found = np.zeros((3, 2))
        for seed in range(options.arms):
            random = np.random.default_rng(seed)
            own = random_arm(random, 15 + seed % (options.bits - 14))
            targets = random_targets(random, own, options.targets)
            merit = judge(own, targets, effort, stuck=True)
            truth = tried(own, targets, merit.solutions)
            weights = np.array([target.weight for target in targets])
            met = np.array([one is not None and one.within_tolerance for one in merit.solutions])
            taken = np.array(
                [one.switches if one is not None and one.within_tolerance else np.inf for one in merit.solutions]
            )
            stuck = float(weights @ truth.survives.mean(axis=(1, 2)) / weights.sum())
            equal = [met == truth.reached, taken == truth.switches, np.abs([stuck - (merit.stuck or 0)]) < 1e-12]
            found += [[part.sum(), part.size] for part in equal]
            bits = float(np.log2(own.manipulator.states.astype(float)).sum())
            print(
                f"arm {seed}: 2^{bits:.0f}, {truth.reached.sum()} reached, stuck {stuck:.4f} {merit.stuck:.4f}",
                flush=True,
            )
        words = (
            f"{what} equal in {int(a)} of {int(b)}"
            for what, (a, b) in zip(("reached", "switches", "stuck"), found, strict=True)
        )
        print(f"{name}: {', '.join(words)}", flush=True)


if __name__ == "__main__":
    main()
