"""Decoders of requests, arms' files and texts: each input is read, or refused with a sentence."""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hyperbit.controller.arm.arm import load
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.armfile.goal_files import parse_goal
from hyperbit.controller.armfile.settings import MOST_OBSTACLES
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.executor.arm.arm import read_arm
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.manipulator.notation import format_configuration, parse_configuration
from hyperbit.controller.motion.decoding import goal, requests, setpoint
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.motion.tracking import bias
from hyperbit.controller.refusals.codes import INVALID_GOAL, OLD_HEADER_TIMESTAMP
from hyperbit.controller.refusals.refusal import LONGEST_SENTENCE, Refusal
from tests import told

LONGEST = 2 * LONGEST_SENTENCE + 100  # characters of a refusal; half pairs of surrogates take six to write
OBSTACLES, SPHERES = told.OBSTACLES["regions"], told.OBSTACLES_IN_SPACE["regions"]
PLANAR: dict[str, Any] = {
    "name": "short",
    "modules": [
        {"type": "vgt", "count": 2, "width": 0.2, "lengths": [0.2, 0.25], "first_diagonal": "BC"},
        {"type": "vgt", "width": 0.2, "lengths": {"left": [0.2, 0.25], "diagonal": [0.3, 0.35], "right": [0.2, 0.25]}},
        {"type": "transforms", "states": [{"position": [0, 0.2]}, {"position": [0.1, 0.2], "orientation": 0.5}]},
    ],
    "base": {"position": [0.5, 0.25], "orientation": 0.1},
    **{"tolerance": {"position": 0.002}, "inrush": 4, "obstacles": OBSTACLES, "body_radius": 0.01},
    **{"self_collision": True, "weights": {"base": 2, "wear": 1}, "workspace": {"pixel": 0.01, "memory": 512}},
    "buses": [{"name": "can0", "channel": "can0", "bitrate": 500000}],
    "boards": {"heartbeat": 0.1, "heartbeat_timeout": 0.35, "on_loss": "hold"},
    "actuators": [
        *(
            {"module": m + 1, "actuator": name, "bus": "can0", "node": m + 1, "output": k, "input": k}
            for m in range(3)
            for k, name in enumerate(("left", "diagonal", "right"))
        ),
        {"module": 4, "actuator": "1", "bus": "can0", "node": 4, "output": 0},
    ],
}
SPATIAL: dict[str, Any] = {
    "name": "s",
    "modules": [{"type": "transforms", "states": [{"position": [0, 0, 1], "orientation": [0, 0, 0, 1]}] * 2}],
    **{"tolerance": {"position": 1}, "obstacles": SPHERES},
}
ARM_FILES = (PLANAR, SPATIAL)
NOTATIONS = ["071", "0,7,1", "11,0,1", " 0,1,1\n", "0.55,2.9", "1e-3,-2", "-1,0,0", "1_0,1,1", "٣,0,1", "9" * 5000]
LABELS = tuple(f"{module}.{name}" for module in (1, 2) for name in ("left", "diagonal", "right"))


def arm_of(*states: int) -> Manipulator:
    return Manipulator([transforms([frames.planar(k, 1) for k in range(n)], planar=True) for n in states])


ARMS = (arm_of(8, 8, 2), arm_of(12, 2, 2))


def check_sentence(sentence: str) -> None:
    assert 0 < len(sentence) <= 6 * LONGEST, f"a sentence of {len(sentence)} characters"
    assert sentence.encode() is not None


def read_request(key: str, data: bytes) -> None:
    for dimension in (2, 3):
        try:
            decode(key, data, dimension)
        except Refusal as error:
            check_sentence(str(error))
            assert key != "goal" or error.code in (INVALID_GOAL, OLD_HEADER_TIMESTAMP)  # noqa: PT017 - no test


def decode(key: str, data: bytes, dimension: int) -> None:
    """Decodes a request of an arm in the plane or in space, and checks what was read. Raises Refusal."""
    match key:
        case "goal":
            rules = goal.GoalRules(2, 0.002, 0.05, Pace(0.06), ARMS[0])
            plan = goal.schedule(goal.parse(data), rules, told.NOW)
            assert plan.positions.shape == (len(plan.times), 2)
            assert np.isfinite(plan.positions).all()
            assert np.isfinite(plan.times).all()
            assert (np.diff(plan.times) > 0).all()
            assert ((plan.tolerances > 0) & (plan.tolerances < 1e7)).all()
            assert plan.waypoints[-1] == len(plan.times) - 1
            assert all(len(states) == len(ARMS[0].actuators) for states in plan.fixed.values())
        case "jog":
            states = requests.decode_jog(data, LABELS).states
            assert states
            assert all(0 <= k < len(LABELS) and state in (0, 1) for k, state in states.items())
        case "setpoint":
            point = setpoint.decode(data, dimension=dimension, tolerance=0.002)
            assert point.position.shape == (dimension,)
            assert np.isfinite(point.position).all()
            assert 0 < point.tolerance < 1e7
        case "degrade":
            lock = requests.decode_degrade(data)
            assert isinstance(lock.actuator, str)
            assert lock.state in (0, 1, None)
        case "measured_tip":
            position, stamp = bias.decode(data, dimension)
            assert position.shape == (dimension,)
            assert np.isfinite(position).all()
            assert 0 <= stamp < np.inf
        case _:
            it = requests.decode_obstacles(data, dimension)
            assert len(it) == len(it.kinds) == len(it.axes) == len(it.centres) == len(it.sizes) <= MOST_OBSTACLES
            assert np.isfinite(it.depths([[0.0, 0.0, 0.0], [0.5, -3.0, 0.0]])).all()
            assert all(it.names)


def read_notation(key: str, data: bytes) -> None:
    """Reads what a person writes on the command line: a configuration, and a position."""
    text = data.decode("utf-8", "surrogateescape")
    for arm in ARMS:
        try:
            configuration = parse_configuration(arm, text)
        except ValueError as error:
            assert str(error).startswith("configuration ")  # noqa: PT017 - no test
            continue
        assert parse_configuration(arm, format_configuration(arm, configuration)).tolist() == configuration.tolist()
    with contextlib.suppress(InputFaults):
        assert np.isfinite(parse_goal(text.split(","), 2, "--goal")[0]).all()


def read_arm_file(key: str, data: bytes) -> None:
    """Reads an arm's file as planner and executor do; the executor reads it without its geometry."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "arm.yaml")
        path.write_bytes(data)
        try:
            arm = load(path)
            executed = read_arm(path) if arm.wiring else None
        except InputFaults as error:
            assert error.faults  # noqa: PT017 - no test
            for fault in error.faults:
                assert "\n" not in fault, fault
                check_sentence(fault)
            with contextlib.suppress(InputFaults):
                read_arm(path)
            return
    assert executed is None or executed.actuators == arm.manipulator.actuators, "the two processes agree"
    assert np.isfinite(arm.manipulator.frames).all()
    assert len(arm.wiring) in (0, len(arm.manipulator.actuators))
    assert np.isfinite(weights_of(arm)).all()
    assert arm.level_pixels >= 1
    assert arm.clearance().blocked(np.zeros((1, len(arm.manipulator.modules)), dtype=int)).shape == (1,)
