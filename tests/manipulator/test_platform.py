"""Platforms: each state satisfies its constraints and continues from the middle pose, or is refused."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hyperbit.controller.manipulator.module import Module
from hyperbit.controller.manipulator.platform import platform
from tests.arms import coordinates


def ring(radius: float, *degrees: float) -> list[list[float]]:
    return [[radius * math.cos(math.radians(d)), radius * math.sin(math.radians(d)), 0.0] for d in degrees]


def hexapod(below: float = 0.15, above: float = 0.15, gap: float = 10.0) -> tuple[list, list]:
    """Joints on circles, in pairs, the top's pairs between the base's."""
    base = [turn + side * gap for turn in (0, 120, 240) for side in (-1, 1)]
    top = [turn + side * (60 - gap) for turn in (0, 120, 240) for side in (-1, 1)]
    return ring(below, *base), ring(above, *top)


TRIPOD = ring(0.12, 90, 210, 330), ring(0.09, 90, 210, 330)
FLAT = [[-0.1, 0.0], [0.1, 0.0], [0.1, 0.02]], [[-0.08, 0.0], [-0.08, 0.02], [0.08, 0.0]]
KINDS = {"six": (*hexapod(), (0.18, 0.22)), "three": (*TRIPOD, (0.18, 0.22)), "flat": (*FLAT, (0.18, 0.22))}


@cache
def platform_of(kind: str) -> Module:
    """Returns a platform; six legs take 0.1 s to build."""
    return platform(*KINDS[kind])


EXACT = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}


def padded(joints: list) -> np.ndarray:
    return np.pad(np.array(joints, dtype=float), ((0, 0), (0, 3 - len(joints[0]))))


def missed(base: list, top: list, lengths: tuple[float, float], module) -> np.ndarray:
    """Relative errors (K, L) of the lengths of the legs in all states."""
    ends = np.einsum("kab,lb->kla", module.frames[:, :3, :3], padded(top)) + module.frames[:, None, :3, 3]
    found = np.linalg.norm(ends - padded(base), axis=2)
    wanted = np.array(lengths)[module.bits]
    return found / wanted - 1


@pytest.mark.parametrize("kind", KINDS)
def test_every_state_has_its_lengths(kind):
    base, top, lengths = KINDS[kind]
    module = platform_of(kind)
    count = len(base)
    assert module.bits.tolist() == [[s >> (count - 1 - k) & 1 for k in range(count)] for s in range(2**count)]
    assert module.actuators == tuple(str(k + 1) for k in range(count))
    assert module.planar == (kind == "flat")
    assert np.abs(missed(base, top, lengths, module)).max() < 1e-10
    products = module.frames[:, :3, :3] @ np.swapaxes(module.frames[:, :3, :3], 1, 2)
    assert_allclose(products, np.tile(np.eye(3), (2**count, 1, 1)), atol=1e-12)


@settings(max_examples=10)
@given(st.floats(0.1, 0.2), st.floats(0.08, 0.2), st.floats(3, 20), st.floats(0.005, 0.05), st.data())
def test_six_legs_of_any_size(below, above, gap, displacement, data):
    base, top = hexapod(below, above, gap)
    noise = np.array(data.draw(st.lists(coordinates, min_size=36, max_size=36))).reshape(2, 6, 3)
    base, top = (np.array(base) + 0.01 * noise[0]).tolist(), (np.array(top) + 0.01 * noise[1]).tolist()
    lengths = (0.2, 0.2 + displacement)
    try:
        module = platform(base, top, lengths)
    except ValueError as error:
        assume("loose" not in str(error))
        raise
    assert np.abs(missed(base, top, lengths, module)).max() < 1e-10
    assert (module.frames[:, 2, 3] > 0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_each_pose_is_led_to_from_the_middle_without_a_jump(kind):
    """The same continuation in tiny steps, by another solver."""
    base, top, lengths = KINDS[kind]
    module = platform_of(kind)
    below, above, flat = padded(base), padded(top), kind == "flat"
    middle = platform(base, top, (np.mean(lengths) - 1e-9, np.mean(lengths) + 1e-9)).frames[0]

    def gaps(step, pose, wanted):
        pose = pose + step
        turn = Rotation.from_rotvec([0, 0, pose[2]] if flat else pose[3:])
        ends = turn.apply(above) + ([*pose[:2], 0] if flat else pose[:3])
        legs = np.linalg.norm(ends - below, axis=1) - wanted
        swing = ends[:, 0] * below[:, 1] - ends[:, 1] * below[:, 0] if kind == "three" else []
        return np.concatenate([legs, swing])

    for state in range(0, len(module.frames), 9):
        turn = Rotation.from_matrix(middle[:3, :3]).as_rotvec()
        pose = np.array([*middle[:2, 3], turn[2]]) if flat else np.concatenate([middle[:3, 3], turn])
        for share in np.linspace(0, 1, 51)[1:]:
            wanted = (1 - share) * np.mean(lengths) + share * np.array(lengths)[module.bits[state]]
            step = least_squares(gaps, np.zeros(len(pose)), args=(pose, wanted), **EXACT).x
            assert np.abs(gaps(step, pose, wanted)).max() < 1e-11
            assert np.abs(step).max() < 0.05
            pose = pose + step
        found = np.array([*pose[:2], 0]) if flat else pose[:3]
        assert_allclose(module.frames[state, :3, 3], found, atol=1e-9)


def test_equal_legs_lift_a_symmetric_plate_straight_up():
    base, top, (short, long) = KINDS["six"]
    module = platform_of("six")
    aside = np.linalg.norm(np.array(base[0]) - top[0])
    for state, length in ((0, short), (63, long)):
        expected = np.eye(4)
        expected[2, 3] = math.sqrt(length**2 - aside**2)
        assert_allclose(module.frames[state], expected, atol=1e-12)


def test_three_legs_swing_in_their_planes():
    base, top, _ = KINDS["three"]
    module = platform_of("three")
    ends = np.einsum("kab,lb->kla", module.frames[:, :3, :3], np.array(top)) + module.frames[:, None, :3, 3]
    across = np.column_stack([-np.array(base)[:, 1], np.array(base)[:, 0], np.zeros(3)])
    assert_allclose(np.einsum("kla,la->kl", ends, across), 0, atol=1e-12)
    assert np.ptp(module.frames[:, 2, 2]) > 0.001  # it tilts


def test_the_body_is_legs_and_plates():
    lengths, module = KINDS["six"][2], platform_of("six")
    legs = module.body[:, :6]
    assert module.body.shape == (64, 18, 2, 3)
    assert_allclose(np.linalg.norm(legs[:, :, 1] - legs[:, :, 0], axis=2), np.array(lengths)[module.bits], atol=1e-12)
    assert_allclose(module.body[:, 6:12].mean(axis=(1, 2)), np.zeros((64, 3)), atol=1e-12)
    assert_allclose(module.body[:, 12:].mean(axis=(1, 2)), module.frames[:, :3, 3], atol=1e-12)


@pytest.mark.parametrize(
    ("base", "top", "lengths", "says"),
    [
        (*hexapod(0.08, 0.08), (0.2, 0.25), r"extended legs 2, 4, 6: no assembly: the plate comes loose at \d+% of"),
        (
            *[ring(0.15, 0, 60, 120, 180, 240, 300)] * 2,
            (0.18, 0.2),
            "middle of their travel: the plate is loose, it can",
        ),
        (*hexapod(0.5, 0.1), (0.18, 0.2), "all legs in the middle of their travel: the plate has no pose near upright"),
        ([[0, 0, 0], *TRIPOD[0][1:]], TRIPOD[1], (0.18, 0.2), "a lower joint of three legs lies on the z axis"),
        (TRIPOD[0] * 2, TRIPOD[1], (0.18, 0.2), r"joints of shapes \(6, 3\) and \(3, 3\)"),
        (TRIPOD[0][:2], TRIPOD[1][:2], (0.18, 0.2), r"joints of shapes \(2, 3\) and \(2, 3\)"),
    ],
)
def test_what_cannot_be_built_is_refused(base, top, lengths, says):
    with pytest.raises(ValueError, match=says):
        platform(base, top, lengths)


def test_a_plate_that_comes_to_lie_under_its_base_is_refused():
    base = [[0, 0.9, 0], [0.9, -0.4, 0], [0.7, -0.2, 0], [-0.9, 0.5, 0], [-0.3, 0.6, 0], [-0.1, -0.7, 0]]
    top = [[-0.6, -0.5, 0], [-0.4, 0, 0], [0.9, 0.4, 0], [-0.4, -0.7, 0], [0, -0.8, 0], [0.6, 0.2, 0]]
    with pytest.raises(ValueError, match="the plate is turned over or under its base"):
        platform(base, top, (0.9, 1.1))
