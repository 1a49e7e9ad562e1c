"""Compiles the kernels of the proofs: they have no signatures, so only a proof compiles them."""

import numpy as np

import hyperbit as hb
from tests.benchmarks.proofs.proof import prove

arm = hb.Arm([hb.vgt(width=0.2, lengths=(0.2, 0.25), count=2)])._arm
start = np.zeros(2, dtype=np.int64)
goal = arm.manipulator.tip(start + 7)
for turn in (np.inf, 0.1):
    prove(arm.clearance(), goal, start, 0.01, turn, depths=(0, 12))
