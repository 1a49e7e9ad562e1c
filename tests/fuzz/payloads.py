"""Payloads, configurations and arms' files, valid and corrupted: each is read, or refused with a message."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from hyperbit.controller.arm.arm import load
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.armfile.settings import MOST_OBSTACLES
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import parse_goal
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
from tests.fuzz.requests import NOW

LONGEST = 2 * LONGEST_SENTENCE + 100  # characters of a refusal; half pairs of surrogates take six to write


def told(sentence: str) -> None:
    assert 0 < len(sentence) <= 6 * LONGEST, f"a sentence of {len(sentence)} characters"
    assert sentence.encode() is not None


def read_goal(data: bytes) -> int:
    try:
        parsed = goal.parse(data)
        it = goal.schedule(parsed, goal.GoalRules(2, 0.002, 0.05, Pace(0.06), ARMS[0]), NOW)
    except Refusal as error:
        assert error.code in (INVALID_GOAL, OLD_HEADER_TIMESTAMP)  # noqa: PT017 - no test
        told(str(error))
        return 1
    assert it.positions.shape == (len(it.times), 2)
    assert np.isfinite(it.positions).all()
    assert np.isfinite(it.times).all()
    assert (np.diff(it.times) > 0).all()
    assert ((it.tolerances > 0) & (it.tolerances < 1e7)).all()
    assert it.waypoints[-1] == len(it.times) - 1
    assert all(len(states) == len(ARMS[0].actuators) for states in it.fixed.values())
    return 1


def read_jog(data: bytes) -> int:
    try:
        it = requests.decode_jog(data, LABELS).states
    except Refusal as error:
        told(str(error))
        return 1
    assert it
    assert all(0 <= k < len(LABELS) and state in (0, 1) for k, state in it.items())
    return 1


def read_setpoint(data: bytes) -> int:
    try:
        it = setpoint.decode(data, dimension=3, tolerance=0.002)
    except Refusal as error:
        told(str(error))
        return 1
    assert it.position.shape == (3,)
    assert np.isfinite(it.position).all()
    assert 0 < it.tolerance < 1e7
    return 1


def read_degrade(data: bytes) -> int:
    try:
        it = requests.decode_degrade(data)
    except Refusal as error:
        told(str(error))
        return 1
    assert isinstance(it.actuator, str)
    assert it.state in (0, 1, None)
    return 1


def read_measured_tip(data: bytes) -> int:
    """A measured tip of a planar arm, and of one in space."""
    for dimension in (2, 3):
        try:
            position, stamp = bias.decode(data, dimension)
        except Refusal as error:
            told(str(error))
            continue
        assert position.shape == (dimension,)
        assert np.isfinite(position).all()
        assert 0 <= stamp < np.inf
    return 2


def read_obstacles(data: bytes) -> int:
    for dimension in (2, 3):
        try:
            it = requests.decode_obstacles(data, dimension)
        except Refusal as error:
            told(str(error))
            continue
        assert len(it) == len(it.kinds) == len(it.axes) == len(it.centres) == len(it.sizes) <= MOST_OBSTACLES
        assert np.isfinite(it.depths([[0.0, 0.0, 0.0], [0.5, -3.0, 0.0]])).all()
        assert all(it.names)
    return 2


def arm_of(*states: int) -> Manipulator:
    return Manipulator([transforms([frames.planar(k, 1) for k in range(n)], planar=True) for n in states])


ARMS = (arm_of(8, 8, 2), arm_of(12, 2, 2))
LABELS = tuple(f"{module}.{name}" for module in (1, 2) for name in ("left", "diagonal", "right"))


def read_notation(data: bytes) -> int:
    """What a person writes on the command line: a configuration, and a position."""
    text = data.decode("utf-8", "surrogateescape")
    for arm in ARMS:
        try:
            configuration = parse_configuration(arm, text)
        except ValueError as error:
            assert str(error).startswith("configuration ")  # noqa: PT017 - no test
            continue
        assert parse_configuration(arm, format_configuration(arm, configuration)).tolist() == configuration.tolist()
    try:
        assert np.isfinite(parse_goal(text.split(","), 2, "--goal")[0]).all()
    except InputFaults as error:
        assert all(error.faults)  # noqa: PT017 - no test
    return 1


class ReadArm:
    def __init__(self) -> None:
        room = "/dev/shm" if os.access("/dev/shm", os.W_OK) else "/tmp"
        self.path = Path(room) / f"hyperbit-fuzz-{os.getpid()}.yaml"

    def __call__(self, data: bytes) -> int:
        try:
            self.path.write_bytes(data)
            arm = load(self.path)
            executed = read_arm(self.path) if arm.wiring else None
        except InputFaults as error:
            assert error.faults  # noqa: PT017 - no test
            for fault in error.faults:
                assert "\n" not in fault, fault
                told(fault)
            self._executor_reads()
            return 1
        finally:
            self.path.unlink(missing_ok=True)
        assert executed is None or executed.actuators == arm.manipulator.actuators, "the two processes agree"
        assert np.isfinite(arm.manipulator.frames).all()
        assert len(arm.wiring) in (0, len(arm.manipulator.actuators))
        assert np.isfinite(weights_of(arm)).all()
        assert arm.level_pixels >= 1
        assert arm.clearance().blocked(np.zeros((1, len(arm.manipulator.modules)), dtype=int)).shape == (1,)
        return 1

    def _executor_reads(self) -> None:
        """The executor reads the file without its geometry: it raises nothing else."""
        with contextlib.suppress(InputFaults):
            read_arm(self.path)


NOTATIONS = ["071", "0,7,1", "11,0,1", " 0,1,1\n", "0.55,2.9", "1e-3,-2", "-1,0,0", "1_0,1,1", "٣,0,1", "9" * 5000]
texts = st.sampled_from(NOTATIONS) | st.text("0123456789,-+._ e", max_size=12) | st.text(max_size=12)
notations = texts.map(lambda text: text.encode("utf-8", "surrogatepass"))
