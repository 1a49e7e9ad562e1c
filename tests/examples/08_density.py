"""Draw the density of an arm's tips: goals in dense regions are easy to reach."""

import numpy as np

import hyperbit as hb

arm = hb.Arm([hb.vgt("BC", width=0.2, lengths=(0.2, 0.25), count=8)], name="truss8", pixel=0.01)
density = arm.density()
count = np.exp(density.total)
print(f"{density.log_counts.shape[1]} x {density.log_counts.shape[0]} pixels, {count:.4g} configurations of {8**8:.4g}")

row, column = np.unravel_index(density.log_counts.argmax(), density.log_counts.shape)
densest = density.origin + density.pixel * np.array([column, row])
within = density.at(densest) * np.pi * arm.tolerance**2
print(f"densest at {densest.round(3)}: about {within:.0f} configurations within {arm.tolerance:g}")
hb.plot(arm, targets=[densest], title="Density").savefig("density.png")
