"""Fit an arm to measured tips; here a second arm with other lengths replaces the real one."""

import numpy as np

import hyperbit as hb

drawn = hb.Arm([hb.vgt("BC", width=0.2, lengths=(0.2, 0.25), count=5)], name="drawn")
real = hb.Arm([hb.vgt("BC", width=0.203, lengths=(0.199, 0.252), count=5)], base=(0.01, -0.02))

configurations = drawn.sample(60, seed=1)
noise = np.random.default_rng(2).normal(scale=1e-4, size=(60, 2))
measured = real.frames(configurations)[:, :2, 3] + noise

fitted = hb.calibrate(drawn, configurations, measured)
report = fitted.report
print(f"residuals (rms): before {report.before.position.rms:.5f}, after {report.after.position.rms:.5f}")
print(f"samples held out: {report.held_out.position.rms:.5f}")
for change in report.changes:
    print(f"  {change.parameter.path}: {change.before:.5f} -> {change.after:.5f}")

unseen = drawn.sample(20, seed=9)
away = np.linalg.norm(fitted.arm.frames(unseen)[:, :2, 3] - real.frames(unseen)[:, :2, 3], axis=1)
print(f"worst of 20 other configurations: {away.max():.5f}")
