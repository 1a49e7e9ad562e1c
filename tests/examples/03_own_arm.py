"""Build an arm in code: trusses on a turning joint, with a sliding joint at the tip."""

import numpy as np

import hyperbit as hb

arm = hb.Arm(
    [
        hb.revolute(np.radians([-45, -15, 15, 45]), link=(0.0, 0.1)),
        hb.vgt("BC", width=0.2, lengths=(0.2, 0.25), count=4),
        hb.prismatic((0.0, 1.0), lengths=[0.1, 0.15], link=(0.02, 0.0)),
    ],
    name="mixed",
    base=(1.0, 0.0),
    tolerance=0.01,
)
print(f"{len(arm.states)} modules with {arm.states.tolist()} states, {len(arm.actuators)} actuators")

goal = arm.position(arm.sample(1, seed=3)[0])
solution = hb.Solver(arm).solve(goal)
print(f"goal {goal.round(3)}: configuration {solution.configuration}, {solution.certificate}")
print(f"actuators extended: {arm.actuator_states(solution.configuration).sum()} of {len(arm.actuators)}")
