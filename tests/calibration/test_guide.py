"""Proposed configurations: allowed, informative, and as many as the held-out error asks for."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.calibration.guide import EVERY, PATIENCE, Guide
from hyperbit.controller.calibration.model import Model
from hyperbit.controller.calibration.parameters import described, parameters
from hyperbit.controller.calibration.proposals import Design
from tests.calibration.making import ARMS, JOINTS, NOISE, TRUSSES, arm_of, erring

SHORT = [{**JOINTS[0], "count": 3}, {**JOINTS[1], "count": 2}]


def design(arm: Arm, **more: object) -> Design:
    description = described(arm, each=False)
    numbers = parameters(description, arm.manipulator.length, len(arm.manipulator.modules))
    return Design(arm, Model(description, numbers), **more)


@pytest.mark.parametrize("kind", ARMS)
@pytest.mark.parametrize("oriented", [False, True])
def test_proposals_tell_more_than_random_configurations(tmp_path, kind, oriented):
    arm, random = arm_of(tmp_path, ARMS[kind]), np.random.default_rng(0)
    found, drawn = design(arm, oriented=oriented), design(arm, oriented=oriented)
    seen = set()
    for _ in range(12):
        wanted = found.propose()
        seen.add(wanted.tobytes())
        found.add(wanted[None])
    drawn.add(np.column_stack([random.integers(0, count, 12) for count in arm.manipulator.states]))
    assert len(seen) == 12
    assert found.error < drawn.error


def test_proposals_keep_locks_and_are_clear_of_obstacles(tmp_path):
    crate = {"disc": {"centre": [0.4, 0.7], "radius": 0.25}, "name": "crate"}
    actuator = {"module": 1, "actuator": "left", "bus": "a", "node": 1, "output": 0, "stuck": "extended"}
    labels = [(m, name) for m in range(1, 6) for name in ("left", "diagonal", "right")]
    others = [
        {"module": m, "actuator": name, "bus": "a", "node": 1, "output": k}
        for k, (m, name) in enumerate(labels)
        if (m, name) != (1, "left")
    ]
    others[-1]["output"] = 15
    more = {
        "buses": [{"name": "a", "interface": "socketcan", "channel": "can0"}],
        "actuators": [actuator, *others],
        "travel_time": 0.1,
        "obstacles": [crate],
    }
    arm = arm_of(tmp_path, TRUSSES, **more)
    found = design(arm)
    for _ in range(15):
        wanted = found.propose()
        assert not arm.clearance().blocked(wanted[None])[0]
        states = arm.manipulator.actuator_states(wanted)
        assert (states == arm.locked)[arm.locked >= 0].all()
        found.leave_out(wanted[None])


@pytest.mark.timeout(900)
def test_measurements_end_when_the_held_out_error_no_longer_falls(tmp_path):
    with threadpool_limits(1, "blas"):
        arm, rng = arm_of(tmp_path, SHORT), np.random.default_rng(2)
        real, guide = erring(arm, rng), Guide(arm, None, oriented=False, each=False)
        while not guide.done:
            wanted = guide.propose()
            tip = real.computed(wanted[None], oriented=False).tips[0]
            tip[:2, 3] += rng.normal(size=2) * NOISE
            guide.add(wanted, tip)
            assert len(guide) < 200
    assert len(guide.held_out) == 1 + (len(guide) - guide.enough) // EVERY > PATIENCE
    assert guide.found.better
    assert guide.held_out[-1] < 3 * NOISE
