"""A spatial arm of four binary Stewart platforms, and a goal with an orientation."""

import numpy as np

import hyperbit as hb

lower = np.radians([-10, 10, 110, 130, 230, 250])
upper = np.radians([-50, 50, 70, 170, 190, 290])
base = 0.15 * np.column_stack((np.cos(lower), np.sin(lower), np.zeros(6)))
top = 0.15 * np.column_stack((np.cos(upper), np.sin(upper), np.zeros(6)))
arm = hb.Arm([hb.platform(base, top, lengths=(0.18, 0.22), count=4)], name="platforms", tolerance=0.01, pixel=0.02)

wanted = arm.sample(1, seed=1)[0]
frame = arm.frame(wanted)
ik = hb.Solver(arm)
free = ik.solve(frame[:3, 3])
print(f"position only: {free.switches} switches, {free.error:.4f} away, {free.certificate}")

# Quaternion x, y, z, w of the frame's rotation; the scalar part is not 0 here.
w = np.sqrt(1.0 + np.trace(frame[:3, :3])) / 2
r = frame[:3, :3]
quaternion = [*(np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (4 * w)), w]
turned = ik.solve(hb.Goal(frame[:3, 3], quaternion, tolerance=0.01, angle_tolerance=0.05))
print(f"with orientation: {turned.switches} switches, {turned.error:.4f} and {turned.angle:.4f} rad away")
hb.plot(arm, {"any orientation": free.configuration, "this orientation": turned.configuration}).savefig("spatial.png")
