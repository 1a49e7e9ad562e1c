"""Collision checks of transitions, against motions of an independent model."""

from functools import cache
from itertools import product

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module, transforms
from hyperbit.controller.manipulator.vgt import vgt
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.displacements import Displacements
from hyperbit.controller.obstacles.obstacles import NONE, box, half_space, sphere
from hyperbit.controller.obstacles.sweep import Sweep
from tests.arms import any_frames, modules, paper_arm, planar_frames, spatial_frames
from tests.manipulator.test_platform import hexapod as joints
from tests.obstacles.dense import any_shape, obstacles_of
from tests.obstacles.moving import Part, arm, hexapod, hinge, motion, pair, room, truss

POINTS = 40  # along each line segment


@cache
def stewart() -> Part:
    """A platform of six legs, which takes 0.3 s to build."""
    return hexapod(*joints(), 0.18, 0.22)


angles = st.floats(-2.5, 2.5)
flat_parts = st.builds(
    truss, st.sampled_from(["BC", "AD"]), st.just(0.2), st.just(0.2), st.floats(0.22, 0.27)
) | st.builds(hinge, angles, angles, st.floats(0.1, 0.4))
solid_parts = flat_parts | st.builds(pair, spatial_frames, spatial_frames) | st.builds(stewart)
among = st.tuples(
    st.lists(flat_parts, min_size=1, max_size=5), planar_frames, st.lists(any_shape(2, planar_frames), max_size=3)
) | st.tuples(st.lists(solid_parts, min_size=1, max_size=4), any_frames, st.lists(any_shape(3), max_size=3))


@settings(max_examples=150, deadline=None)
@given(among, st.sampled_from([0.0, 0.03]), st.booleans(), st.integers(0, 2**32))
def test_what_is_told_clear_touches_nothing_on_any_way(given_arm, radius, pairs, seed):
    parts, base, around = given_arm
    rng, manipulator = np.random.default_rng(seed), arm(parts, base)
    clearance = BodyClearance(manipulator, obstacles_of(around), radius, self_collision=pairs)
    before = rng.integers(0, 2, len(manipulator.actuators), dtype=np.uint8)
    stage = rng.permutation(len(before))[: rng.integers(1, 5)]
    touch = Sweep(clearance).first_collision(before, stage)
    after = before.copy()
    after[stage] ^= 1
    if touch is None and not clearance.free:
        displacements = np.concatenate([motion(rng, before, after, 12) for _ in range(4)])
        away, apart = room(parts, base, around, displacements, POINTS, pairs)
        assert away >= radius
        assert apart >= 2 * radius


@settings(max_examples=60, deadline=None)
@given(modules | st.builds(lambda: stewart().module), st.integers(0, 2**32))
def test_rates_bound_what_displacements_do(module, seed):
    rng, own = np.random.default_rng(seed), Displacements(module)
    count = module.bits.shape[1]
    states, moving = module.bits[rng.integers(len(module.bits))], np.sort(rng.permutation(count)[: rng.integers(1, 4)])
    rates = own.rates(states.astype(float), moving)
    if not np.isfinite(rates).all():
        return
    displacements = np.tile(states.astype(float), (100, 1))
    displacements[:, moving] = rng.random((100, len(moving)))
    found, bodies = own.at(displacements)
    for a, b in rng.integers(0, 100, (200, 2)):
        most = abs(displacements[a] - displacements[b])[moving] @ rates + 1e-9
        assert np.linalg.norm(found[a, :3, 3] - found[b, :3, 3]) <= most[0]
        assert np.linalg.norm(found[a, :3, :3] - found[b, :3, :3], 2) <= most[1]
        assert np.linalg.norm(bodies[a] - bodies[b], axis=-1).max() <= most[2]


def steepest(module: Module, fixed: np.ndarray, moving: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Greatest rates (k, 3) at 100 random displacements and at all ends, by finite differences."""
    ends = np.array(list(product((0.0, 1.0), repeat=len(moving))))
    at = np.tile(fixed, (100 + len(ends), 1))
    at[:, moving] = np.concatenate([rng.random((100, len(moving))), ends])
    found = np.zeros((len(moving), 3))
    for k, a in enumerate(moving):
        first, second = at.copy(), at.copy()
        first[:, a] = np.clip(at[:, a] - 5e-7, 0, 1 - 1e-6)
        second[:, a] = first[:, a] + 1e-6
        (f, b), (g, c) = module.between(first), module.between(second)
        found[k] = (
            np.linalg.norm(g[:, :3, 3] - f[:, :3, 3], axis=1).max(),
            np.linalg.norm(g[:, :3, :3] - f[:, :3, :3], 2, axis=(1, 2)).max(),
            np.linalg.norm(c - b, axis=-1).max(),
        )
    return found / 1e-6


FLAT = vgt("BC", 0.2, (0.2, 0.3999), (0.2, 0.2), (0.2, 0.21))  # its first triangle nearly flat, which samples miss
SINGULAR = [FLAT, vgt("AD", 0.2, (0.2, 0.21), (0.2, 0.2), (0.2, 0.3999))]


@settings(max_examples=30, deadline=None)
@given(modules | st.sampled_from(SINGULAR), st.integers(0, 2**32))
def test_proven_rates_are_above_the_steepest_slope(module, seed):
    rng = np.random.default_rng(seed)
    count = module.bits.shape[1]
    fixed = module.bits[rng.integers(len(module.bits))].astype(float)
    moving = np.sort(rng.permutation(count)[: rng.integers(1, 4)])
    fixed[moving] = 0.0
    assert module.proven
    bounds = module.bounds(fixed, moving)
    if np.isfinite(bounds).all():
        assert (steepest(module, fixed, moving, rng) <= bounds * (1 + 1e-6) + 1e-7).all()


def test_samples_would_miss_what_the_bounds_do_not():
    """Sampled bounds fail near a flat triangle, where the rate between samples is far above that at the samples."""
    fixed, moving = np.zeros(3), np.array([0])
    steep = steepest(FLAT, fixed, moving, np.random.default_rng(0))
    assert (Displacements(FLAT).rates(fixed, moving) >= steep).all()


def test_rates_of_a_truss_are_not_much_too_great():
    truss = vgt("BC", 0.2, (0.2, 0.25), (0.2, 0.25), (0.2, 0.25))
    fixed, moving = np.zeros(3), np.arange(3)
    steep = steepest(truss, fixed, moving, np.random.default_rng(0))
    assert (truss.bounds(fixed, moving)[[0, 2]] <= 1.5 * steep[[0, 2]]).all()
    assert (truss.bounds(fixed, moving)[:, [0, 2]] <= 2 * steep[:, [0, 2]]).all()
    assert (
        truss.bounds(fixed, moving)[1, 1] <= 0.25
    )  # [rad] per displacement of the diagonal, which turns the top little


def test_platforms_are_sampled_and_said_to_be():
    assert not stewart().module.proven
    walls = half_space("wall", (0, 0, -9), (0, 0, 1))
    assert not Sweep(BodyClearance(arm([stewart()]), walls)).proven
    assert Sweep(BodyClearance(paper_arm(3), half_space("wall", (0, -9), (0, 1)))).proven


def test_a_disc_that_only_the_way_meets_is_seen():
    swing = hinge(-0.5, 0.5, 1.0)
    manipulator = arm([swing])
    between = BodyClearance(manipulator, sphere("disc 'pillar'", (1.0, 0.0), 0.05))
    assert not between.blocked([[0], [1]]).any()
    sweep = Sweep(between)
    touch = sweep.first_collision(np.array([0], dtype=np.uint8), np.array([0]))
    assert touch is not None
    assert sweep.describe(touch) == "module 1 is in disc 'pillar'"
    beyond = Sweep(BodyClearance(manipulator, sphere("disc", (1.07, 0.0), 0.05)))
    assert beyond.first_collision(np.array([0], dtype=np.uint8), np.array([0])) is None


def test_subsets_that_touch_are_seen_whatever_their_ends_do():
    manipulator = arm([hinge(0.0, np.pi / 2, 1.0), hinge(0.0, -np.pi / 2, 1.0)])
    sweep = Sweep(BodyClearance(manipulator, box("box", (0.0, 2.0), (0.4, 0.4))))
    start = np.zeros(2, dtype=np.uint8)
    assert sweep.first_collision(start, np.array([0, 1])) is not None  # the first alone brings the tip there
    assert sweep.first_collision(start, np.array([1])) is None
    assert sweep.first_collision(np.array([0, 1], dtype=np.uint8), np.array([0])) is None


def test_modules_that_pass_through_each_other_are_seen():
    folding = [hinge(0.0, 2.6, 1.0) for _ in range(3)]
    manipulator = arm(folding)
    sweep = Sweep(BodyClearance(manipulator, NONE, 0.01, self_collision=True))
    touch = sweep.first_collision(np.array([0, 1, 0], dtype=np.uint8), np.array([2]))
    assert touch is not None
    assert sweep.describe(touch) == "modules 1 and 3 touch"
    assert sweep.first_collision(np.array([0, 1, 0], dtype=np.uint8), np.array([0])) is None


def test_where_nobody_knows_the_module_is_not_clear():
    three = transforms([frames.planar(0.1 * k, 0.2) for k in range(3)], planar=True)  # 11 has no state
    manipulator = Manipulator([three])
    sweep = Sweep(BodyClearance(manipulator, half_space("wall", (0, -1), (0, 1))))
    touch = sweep.first_collision(np.array([0, 0], dtype=np.uint8), np.array([0, 1]))
    assert touch is not None
    assert sweep.describe(touch) == "the position of module 1 in mid-travel is unknown"
    assert sweep.first_collision(np.array([0, 0], dtype=np.uint8), np.array([1])) is None


def test_most_stages_among_few_regions_are_shown_to_be_clear():
    """The bounds must also be tight enough to be useful."""
    manipulator, rng = paper_arm(16), np.random.default_rng(0)
    clearance = BodyClearance(manipulator, sphere("disc", (1.5, 2.0), 0.3), 0.02)
    sweep, shown, fine = Sweep(clearance), 0, 0
    while fine < 60:
        before = rng.integers(0, 2, 48, dtype=np.uint8)
        stage = rng.permutation(48)[:4]
        displacements = np.tile(before.astype(float), (200, 1))
        displacements[:, stage] = rng.random((200, 4))
        subsets = [manipulator.configuration(np.round(s)) for s in displacements[:16]]
        if not clearance.blocked(subsets).any():
            fine += 1
            shown += sweep.first_collision(before, stage) is None
    assert shown >= 50
