"""Accuracy of `hyperbit calibrate` for the paper's arm with manufacturing errors in each leg.

Usage: python -m tests.benchmarks.calibration
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from controller.arm.arm import load
from controller.calibration.calibration import calibrated
from tests.calibration.making import erring, measured

SAMPLES, SEED = 300, 1
LENGTH, BASE = 0.0005, 0.005  # errors: of each leg and width, and of the base's coordinates and angle

ARM = Path(__file__).parents[2] / "deploy" / "planar16.yaml"


def main() -> None:
    arm, rng = load(ARM), np.random.default_rng(SEED)
    samples = measured(arm, erring(arm, rng, each=True, size=LENGTH, base=BASE), rng, SAMPLES)
    for each in (False, True):
        began = time.perf_counter()
        found = calibrated(arm, samples, each=each)
        seconds = time.perf_counter() - began
        print(f"{'every leg by itself' if each else 'as in the file'}: {len(found.changes)} numbers, {seconds:.1f} s")
        for name, residuals in (
            ("before", found.before),
            ("base only", found.base_only),
            ("after", found.after),
            ("held out", found.held_out),
            ("held out, base only", found.held_out_base_only),
        ):
            values = ", ".join(
                f"{kind} {r.rms:.3g} / {r.most:.3g} / {r.worst:.3g}"
                for kind, r in (("position", residuals.position), ("orientation", residuals.orientation))
                if r is not None
            )
            print(f"  {name}: {values}")


if __name__ == "__main__":
    main()
