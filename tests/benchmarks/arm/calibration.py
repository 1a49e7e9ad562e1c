"""Accuracy of `hyperbit calibrate` for the paper's arm with manufacturing errors in each leg.

Usage: python -m tests.benchmarks.arm.calibration
"""

import numpy as np

from hyperbit.controller.arm.arm import load
from hyperbit.controller.calibration.calibration import calibrated
from tests.benchmarks.harness import PAPER_ARM, CommandLine, show, write_figures
from tests.calibration.making import erring, measured

SAMPLES, SEED = 300, 1
LENGTH, BASE = 0.0005, 0.005  # errors: of each leg and width, and of the base's coordinates and angle


def main() -> None:
    given = CommandLine(__doc__).parse()
    rows, (arm, rng) = [], (load(PAPER_ARM), np.random.default_rng(SEED))
    samples = measured(arm, erring(arm, rng, each=True, size=LENGTH, base=BASE), rng, SAMPLES)
    for each in (False, True):
        found = calibrated(arm, samples, each=each)
        for name in ("before", "base_only", "after", "held_out", "held_out_base_only"):
            position = getattr(found, name).position
            numbers = (f"{position.rms:.3g}", f"{position.most:.3g}", f"{position.worst:.3g}")
            rows.append((f"{name}, {len(found.changes)} numbers", *numbers))
    show("misses of the tip", ("", "root mean square", "most", "worst"), rows)
    write_figures(given.json, rows)


if __name__ == "__main__":
    main()
