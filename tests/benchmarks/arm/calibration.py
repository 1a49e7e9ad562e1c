"""Accuracy of `hyperbit calibrate` for the paper's arm with manufacturing errors in each leg.

Usage: python -m tests.benchmarks.arm.calibration
"""

from __future__ import annotations

import numpy as np

from hyperbit.controller.arm.arm import load
from hyperbit.controller.calibration.calibration import calibrated
from tests.benchmarks.harness import PAPER_ARM, CommandLine, timed, write_figures
from tests.calibration.making import erring, measured

SAMPLES, SEED = 300, 1
LENGTH, BASE = 0.0005, 0.005  # errors: of each leg and width, and of the base's coordinates and angle


def main() -> None:
    given = CommandLine(__doc__).parse()
    figures = {}
    arm, rng = load(PAPER_ARM), np.random.default_rng(SEED)
    samples = measured(arm, erring(arm, rng, each=True, size=LENGTH, base=BASE), rng, SAMPLES)
    for each in (False, True):
        found, seconds = timed(lambda each=each: calibrated(arm, samples, each=each))
        kind = "every leg by itself" if each else "as in the file"
        print(f"{kind}: {len(found.changes)} numbers, {seconds:.1f} s")
        figures[kind] = own = {
            "before": found.before,
            "base only": found.base_only,
            "after": found.after,
            "held out": found.held_out,
            "held out, base only": found.held_out_base_only,
        }
        for name, residuals in own.items():
            values = ", ".join(
                f"{of} {r.rms:.3g} / {r.most:.3g} / {r.worst:.3g}"
                for of, r in (("position", residuals.position), ("orientation", residuals.orientation))
                if r is not None
            )
            print(f"  {name}: {values}")
    write_figures(given.json, figures)


if __name__ == "__main__":
    main()
