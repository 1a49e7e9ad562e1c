"""Evaluations that the search for designs needs for the hypervolume of a random search of 160.

    python -m tests.benchmarks.design.hypervolume --evaluations 160 --seeds 5

The reference points were fixed before the first run.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hyperbit.controller.design.front import losses, volume
from hyperbit.controller.design.judging import DesignJob, Share
from hyperbit.controller.design.search import Figures, evaluations
from hyperbit.controller.design.study import Impossible, Study, random_values, read_study
from hyperbit.controller.studies.shares import alone

FOLDER = Path(__file__).parent
REFERENCES = {"trusses": (1.0, 30.0, 49.0), "platforms": (1.0, 20.0, 25.0)}  # loss of reach, switches, actuators


def random_figures(study: Study, count: int, seed: int) -> list[Figures]:
    random, shares = np.random.default_rng([seed, 2]), list[Share]()
    while len(shares) < count:
        values = random_values(study.settings, random)
        try:
            study.build(values)
        except Impossible:
            continue
        shares.append(Share(values))
    return list(alone(DesignJob(study), shares))


def matched(study: Study, count: int, seed: int, goal: float, reference: np.ndarray) -> int | None:
    """Returns the number of evaluations of the search until its hypervolume is the goal; None if `count` do not do."""
    job, figures = DesignJob(study), list[Figures]()
    for one in evaluations(study, count, seed, [], lambda batch: alone(job, [Share(values) for values in batch])):
        figures.append(one.figures)
        if volume(losses(study.settings, figures), reference) >= goal:
            return one.design
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evaluations", type=int, default=160)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--studies", nargs="*", default=list(REFERENCES))
    options = parser.parse_args()
    for seed in range(options.seeds):
        for name in options.studies:
            study, reference = read_study(FOLDER / f"{name}.yaml"), np.array(REFERENCES[name])
            naive = losses(study.settings, random_figures(study, options.evaluations, seed))
            goal = volume(naive, reference)
            found = matched(study, options.evaluations, seed, goal, reference)
            print(f"{name} seed {seed}: random search {goal:.4g}, matched after {found} evaluations", flush=True)


if __name__ == "__main__":
    main()
