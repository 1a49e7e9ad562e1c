"""Collision checks of configurations, against dense points along each line segment."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.locked import lock_actuators
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.collision import lines_distance
from hyperbit.controller.obstacles.distance import first_obstacle, segment_distance
from hyperbit.controller.obstacles.obstacles import NONE, box, half_space, sphere, together
from tests.arms import (
    any_frames,
    every_configuration,
    paper_arm,
    planar_frames,
    planar_modules,
    short_arms,
    spatial_arm,
)
from tests.obstacles.dense import HalfPlane, along, any_shape, nearest, obstacles_of, step

EPSILON = 1e-12  # what rounding takes, of coordinates near 1

points = st.tuples(*[st.floats(-2, 2)] * 3).map(np.array)
radii = st.just(0.0) | st.floats(0, 0.3)
flat = st.lists(any_shape(2, planar_frames), min_size=1, max_size=3)
solid = st.lists(any_shape(3), min_size=1, max_size=3)
arms_among_obstacles = st.tuples(short_arms(planar_modules, planar_frames), flat) | st.tuples(
    short_arms(bases=any_frames), solid
)


@given(st.lists(points, min_size=1, max_size=20), solid)
def test_signed_distances_are_those_of_the_check(asked, parts):
    found = obstacles_of(parts).depths(asked)
    assert np.allclose(found, np.transpose([part.signed(np.array(asked)) for part in parts]), atol=EPSILON)


@given(points, points, any_shape(3))
@example(np.zeros(3), np.zeros(3), HalfPlane((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
def test_a_line_segment_is_as_far_from_a_region_as_its_nearest_point(start, end, part):
    own, line = part.obstacle(), np.array([[start, end]])
    found = segment_distance(own.kinds[0], own.axes[0], own.centres[0], own.sizes[0], tuple(start), tuple(end))
    dense = max(nearest(line, [part]), 0.0)
    assert dense - step(line) - EPSILON <= found <= dense + EPSILON


@given(points, points, points, points)
def test_two_line_segments_are_as_far_apart_as_their_nearest_points(a, b, c, d):
    first, second = np.array([a, b]), np.array([c, d])
    dense = cKDTree(along(first[None])).query(along(second[None]))[0].min()
    found = lines_distance(first, second)
    assert dense - step(first[None]) - step(second[None]) - EPSILON <= found <= dense + EPSILON


@pytest.mark.parametrize(
    ("first", "second", "apart"),
    [
        ([[0, 0, 0], [1, 0, 0]], [[0, 0, 1], [1, 0, 1]], 1.0),  # parallel
        ([[0, 0, 0], [1, 0, 0]], [[3, 0, 0], [2, 0, 0]], 1.0),  # in one line
        ([[0, 0, 0], [1, 0, 0]], [[0.5, 0, 0], [2, 0, 0]], 0.0),  # overlapping
        ([[0, 0, 0], [0, 0, 0]], [[3, 0, 0], [3, 4, 0]], 3.0),  # a point
        ([[0, 0, 0], [1, 0, 0]], [[3, 4, 0], [3, 4, 0]], 2 * 5**0.5),
        ([[0, 0, 0], [0, 0, 0]], [[0, 3, 4], [0, 3, 4]], 5.0),
    ],
)
def test_line_segments_that_leave_their_nearest_points_open(first, second, apart):
    lines = np.array(first, dtype=float), np.array(second, dtype=float)
    assert lines_distance(*lines) == pytest.approx(apart, abs=1e-12)
    assert lines_distance(*lines[::-1]) == pytest.approx(apart, abs=1e-12)


@given(arms_among_obstacles, radii, st.data())
def test_bodies_in_regions_are_found_and_others_are_not(case, radius, data):
    arm, parts = case
    configuration = np.array([data.draw(st.integers(0, k - 1)) for k in arm.states])
    clearance = BodyClearance(arm, obstacles_of(parts), radius)
    lines, blocked = arm.body(configuration), bool(clearance.blocked([configuration])[0])
    dense = nearest(lines, parts)
    if dense < radius - EPSILON:
        assert blocked
    if blocked:
        assert dense <= clearance.margin + step(lines) + EPSILON
    # One module at a time comes to the same, and to the obstacle that is named.
    found = None
    for i, frame in enumerate(arm.chain(configuration)[:-1]):
        r, b = np.ascontiguousarray(frame[:3, :3]), np.ascontiguousarray(frame[:3, 3])
        body = clearance.bodies[i, configuration[i], : clearance.lines[i]]
        ball = clearance.balls[i, configuration[i]]
        obstacle = first_obstacle(r, b, body, ball, clearance.surroundings, clearance.margin)
        if obstacle >= 0:
            found = f"module {i + 1} is in {clearance.obstacles.names[obstacle]}"
            break
    assert (clearance.where(configuration), blocked) == (found, found is not None)


@settings(max_examples=60)
@given(short_arms(planar_modules, planar_frames, most=6) | short_arms(most=6), radii, st.data())
def test_modules_that_touch_are_found_but_for_neighbours(arm, radius, data):
    configuration = np.array([data.draw(st.integers(0, k - 1)) for k in arm.states])
    chain = arm.chain(configuration)
    bodies = [m.body[s] @ f[:3, :3].T + f[:3, 3] for m, s, f in zip(arm.modules, configuration, chain, strict=False)]
    trees = [cKDTree(along(body)) for body in bodies]
    pairs = [(i, j) for i in range(len(bodies)) for j in range(i + 2, len(bodies))]
    apart = {(i, j): trees[i].query(trees[j].data)[0].min() for i, j in pairs}
    clearance = BodyClearance(arm, NONE, radius, self_collision=True)
    where, blocked = clearance.where(configuration), bool(clearance.blocked([configuration])[0])
    assert blocked == (where is not None)
    if min(apart.values(), default=np.inf) < 2 * radius - EPSILON:
        assert blocked
    if where is not None:
        i, j = (int(word) - 1 for word in where.split() if word.isdigit())
        assert apart[i, j] <= 2 * radius + 1e-7 * arm.length + step(bodies[i]) + step(bodies[j]) + EPSILON
    assert not BodyClearance(arm, NONE, radius).blocked([configuration])[0]


def test_a_truss_that_lies_on_itself_is_found_though_its_bodies_are_thin():
    square = transforms([frames.planar(0, 1, np.pi / 2 + 0.1), frames.planar(0, 1)], planar=True)
    arm = Manipulator([square] * 5)
    clearance = BodyClearance(arm, NONE, self_collision=True)
    assert clearance.where(np.zeros(5, dtype=np.int64)) == "modules 1 and 4 touch"
    assert clearance.where(np.ones(5, dtype=np.int64)) is None


def test_what_is_in_the_way_is_named_from_the_base():
    arm = paper_arm(4)
    walls = together([sphere("disc 'pillar'", [0, 0.9], 0.05), half_space("half-plane 'floor'", [0, -0.1], [0, 1])])
    clearance = BodyClearance(arm, walls, 0.01)
    straight = np.full(4, 7)
    assert clearance.where(straight) == "module 4 is in disc 'pillar'"
    assert clearance.blocked([straight, np.zeros(4, dtype=int)]).tolist() == [True, False]
    assert not clearance.free


def test_inside_of_a_half_space_is_where_its_normal_points_away_from():
    arm = spatial_arm(3)
    upright = np.full(3, 4)
    assert BodyClearance(arm, half_space("ceiling", [0, 0, 0.7], [0, 0, -1])).blocked([upright])[0]
    assert not BodyClearance(arm, half_space("floor", [0, 0, -0.1], [0, 0, 1])).blocked([upright])[0]


def test_a_box_is_turned_with_its_frame():
    arm = Manipulator([transforms([frames.planar(0, 1), frames.planar(1, 0)], planar=True)])
    long = box("box", [0.5, 0.5], [2, 0.02], frames.planar(0, 0, np.pi / 4)[:3, :3])
    across = box("box", [0.5, 0.5], [0.9, 0.02], frames.planar(0, 0, -np.pi / 4)[:3, :3])
    assert BodyClearance(arm, long).blocked([[0], [1]]).tolist() == [True, True]
    assert BodyClearance(arm, across).blocked([[0], [1]]).tolist() == [False, False]


def test_without_regions_there_is_nothing_to_avoid():
    arm = paper_arm(2)
    clearance = BodyClearance(arm, NONE, 10.0)
    assert clearance.free
    assert not clearance.blocked(every_configuration(arm)).any()
    assert clearance.where(np.zeros(2, dtype=np.int64)) is None


def test_an_arm_with_held_actuators_is_blocked_where_the_whole_arm_is():
    arm, wall = paper_arm(3), sphere("disc", [0.2, 0.5], 0.1)
    held = np.full(9, -1, dtype=np.int8)
    held[4] = 1
    left = lock_actuators(arm, held)
    asked = every_configuration(left)
    whole = np.array([arm.configuration(left.actuator_states(c)) for c in asked])
    found = BodyClearance(left, wall).blocked(asked)
    assert found.any()
    assert not found.all()
    assert np.array_equal(found, BodyClearance(arm, wall).blocked(whole))
