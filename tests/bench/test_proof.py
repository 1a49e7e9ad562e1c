"""The proofs of the goal sets agree with enumeration of all configurations."""

import math
from functools import cache

import numpy as np
import pytest

import hyperbit as hb
from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.search.target import within
from tests.arms import every_configuration
from tests.benchmarks.proofs.acceptance import check_of, clear
from tests.benchmarks.proofs.half_rows import NONE, halves, rows
from tests.benchmarks.proofs.proof import prove

TURNS = (0.0, math.pi / 2, math.pi, -math.pi / 2)


def truss(count: int, obstacles: tuple[hb.Obstacle, ...] = (), radius: float = 0.0) -> Arm:
    modules = [hb.vgt(width=0.2, lengths=(0.2, 0.25), count=count)]
    return hb.Arm(modules, obstacles=obstacles, body_radius=radius)._arm


def spatial(obstacles: tuple[hb.Obstacle, ...] = (), radius: float = 0.0) -> Arm:
    link = (0.0, 0.0, 0.3)
    bends = [hb.revolute((-0.4, 0.1, 0.5), link=link, axis=axis) for axis in ((1, 0, 0), (0, 1, 0)) * 3]
    return hb.Arm([*bends, hb.prismatic((0, 0, 1), (0.0, 0.1, 0.2))], obstacles=obstacles, body_radius=radius)._arm


def lattice() -> Arm:
    slides = [hb.prismatic(axis, (0.0, 0.5)) for axis in ((1, 0), (0, 1)) * 2]
    return hb.Arm([hb.revolute(TURNS, link=(0.5, 0.0)), *slides, hb.revolute(TURNS, link=(1.0, 0.0))])._arm


DISCS = (hb.Disc((0.25, 0.5), 0.1), hb.Box((-0.3, 0.6), (0.2, 0.1), angle=0.4), hb.HalfPlane((-0.5, 0), (1, 0.2)))
SPHERES = (hb.Sphere((0.2, 0.2, 1.2), 0.2), hb.HalfSpace((-0.4, 0, 0), (1, 0, 0)))
ARMS = {
    "truss": truss(4),
    "truss, obstacles": truss(4, DISCS, 0.02),
    "spatial": spatial(),
    "spatial, obstacles": spatial(SPHERES, 0.02),
    "lattice": lattice(),
}


@cache
def everything(arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    every = every_configuration(arm.manipulator)
    return every, arm.manipulator.tips(every)[:, :3, 3]


def fewest(arm: Arm, goal: np.ndarray, start: np.ndarray, tolerance: float, turn: float) -> int:
    m, (every, tips) = arm.manipulator, everything(arm)
    every = every[np.linalg.norm(tips - goal[:3, 3], axis=1) <= tolerance + 1e-9]
    served = [own for own in every if within(m.tip(own), goal, tolerance, turn)]
    if not served:
        return NONE
    blocked = arm.clearance().blocked(np.array(served))
    return min((m.switches(start, own) for own, bad in zip(served, blocked, strict=True) if not bad), default=NONE)


@pytest.mark.parametrize("depths", [(0, 1, 2, 4, 8, 12), (3, 12)])
@pytest.mark.parametrize("name", ARMS)
def test_positions(name, depths):
    arm, rng = ARMS[name], np.random.default_rng(0)
    m = arm.manipulator
    for _ in range(12):
        goal = np.eye(4)
        goal[: m.dimension, 3] = m.tip(rng.integers(0, m.states))[: m.dimension, 3]
        tolerance = float(rng.choice((0.01, 0.05)))
        if name == "lattice":
            goal[0, 3] += 0.5
            tolerance = float(np.nextafter(0.5, rng.choice((0.0, 0.5, 1.0))))
        start = rng.integers(0, m.states)
        proof = prove(arm.clearance(), goal, start, tolerance, depths=depths)
        expected = fewest(arm, goal, start, tolerance, math.inf)
        assert (proof.bound, proof.switches) == (expected, expected)
        if proof.configuration is not None:
            assert m.switches(start, proof.configuration) == expected


@pytest.mark.parametrize("name", ["truss", "truss, obstacles", "lattice"])
def test_poses(name):
    arm, rng = ARMS[name], np.random.default_rng(1)
    m = arm.manipulator
    for _ in range(12):
        goal, start = m.tip(rng.integers(0, m.states)), rng.integers(0, m.states)
        turn = float(rng.choice((0.05, 0.5, 3.0)))
        proof = prove(arm.clearance(), goal, start, 0.1, turn, depths=(1, 2, 4, 8, 12))
        near = fewest(arm, goal, start, 0.1, turn)
        assert proof.switches == proof.bound == near
        if proof.configuration is not None:
            assert angle_between(m.tip(proof.configuration), goal) <= turn


def test_only_a_bound_is_proven_if_the_lists_are_too_short():
    arm, start = ARMS["truss"], np.zeros(4, dtype=np.int64)
    goal = arm.manipulator.tip(np.full(4, 7))
    proof = prove(arm.clearance(), goal, start, 1e-4, depths=(0,))
    assert (proof.bound, proof.proven) == (2, False)
    assert prove(arm.clearance(), goal, start, 1e-4).bound == fewest(arm, goal, start, 1e-4, math.inf) > 2


def test_a_short_half_that_is_listed_whole_does_not_end_the_other_one():
    angles = np.linspace(-1.5, 1.5, 64)  # six actuators in Gray code
    ends = hb.revolute((-0.1, 0.1), link=(0.5, 0.0), count=2)
    arm = hb.Arm([hb.revolute(angles, link=(1.0, 0.0)), ends])._arm
    start = np.zeros(3, dtype=np.int64)
    for own in ((42, 1, 1), (42, 0, 1), (21, 1, 0), (1, 1, 1)):
        goal = arm.manipulator.tip(np.array(own))
        proof = prove(arm.clearance(), goal, start, 1e-4, depths=(2,))
        assert proof.switches == proof.bound == fewest(arm, goal, start, 1e-4, math.inf)


def test_distances_from_obstacles_agree_with_the_product():
    rng = np.random.default_rng(2)
    for name in ("truss, obstacles", "spatial, obstacles"):
        arm = ARMS[name]
        some = rng.integers(0, arm.manipulator.states, (500, len(arm.manipulator.states)))
        check = check_of(arm.clearance(), np.eye(4), 1.0, math.inf)
        assert [not clear(check, own) for own in some] == arm.clearance().blocked(some).tolist()


def test_a_list_is_complete_without_duplicates():
    arm, start = truss(6), np.array([1, 7, 0, 2, 5, 4])
    lower, _, point, _ = halves(arm.manipulator, np.eye(4), start, 0.01, math.inf)
    listed = rows(lower, point, 3)
    assert len(set(listed.codes.tolist())) == len(listed.codes) == 1 + 9 + 36 + 84
