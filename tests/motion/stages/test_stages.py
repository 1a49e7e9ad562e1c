"""Stages of a transition: they obey the bounds, and no other stages deviate less."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module, transforms
from hyperbit.controller.motion.stages.stages import SKIPPED, Stages, order_stages
from hyperbit.controller.motion.stages.transition import build_transition
from tests.arms import paper_arm, short_arms, spatial_arm

Plan = tuple[tuple[int, ...], ...]


def strays(manipulator: Manipulator, start: np.ndarray, end: np.ndarray, switched: tuple[int, ...]) -> float:
    """Distance of the tip from the line after these have switched; NaN where modules have no such state."""
    states = manipulator.actuator_states(start)
    states[list(switched)] ^= 1
    try:
        point = manipulator.tip(manipulator.configuration(states))[:3, 3]
    except ValueError:
        return np.nan
    a, b = manipulator.tip(start)[:3, 3], manipulator.tip(end)[:3, 3]
    part = np.clip((point - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
    return float(np.linalg.norm(point - a - part * (b - a)))


def at_once(manipulator: Manipulator, start: np.ndarray, end: np.ndarray) -> float:
    """Greatest distance of the tip from the line if all actuators switch in one stage."""
    transition = replace(build_transition(manipulator, start, end), unknown=SKIPPED)
    return float(transition.greatest(transition.masks([]), np.arange(len(transition.actuators))))


def subsets(stage: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    return (chosen for k in range(len(stage) + 1) for chosen in combinations(stage, k))


def between(manipulator: Manipulator, start: np.ndarray, end: np.ndarray, plan: Plan) -> np.ndarray:
    """Distances of the tip from the line in every state that the stages may pass."""
    earlier: tuple[int, ...] = ()
    result = []
    for stage in plan:
        result += [strays(manipulator, start, end, earlier + chosen) for chosen in subsets(stage)]
        earlier += stage
    return np.array(result)


def partitions(items: tuple[int, ...], most: int) -> Iterator[Plan]:
    """All ordered partitions into stages of at most `most`."""
    if not items:
        yield ()
    for size in range(1, min(most, len(items)) + 1):
        for stage in combinations(items, size):
            for others in partitions(tuple(i for i in items if i not in stage), most):
                yield (stage, *others)


def differing(manipulator: Manipulator, start: np.ndarray, end: np.ndarray) -> tuple[int, ...]:
    differ = manipulator.actuator_states(start) != manipulator.actuator_states(end)
    return tuple(np.flatnonzero(differ).tolist())


def flipped(manipulator: Manipulator, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A configuration of the truss arm, and one that is n switches away."""
    start = rng.integers(0, manipulator.states)
    states = manipulator.actuator_states(start)
    states[rng.choice(len(states), n, replace=False)] ^= 1
    return start, manipulator.configuration(states)


def check(
    manipulator: Manipulator, start: np.ndarray, end: np.ndarray, found: Stages, most: int, limit: int | None
) -> None:
    """Checks the bounds, that each actuator switches once, and the deviation."""
    assert sorted(sum(found.actuators, ())) == list(differing(manipulator, start, end))
    assert all(1 <= len(stage) <= most for stage in found.actuators)
    assert all(list(stage) == sorted(stage) for stage in found.actuators)
    assert limit is None or len(found.actuators) <= limit
    for k in range(len(found.actuators) + 1):
        assert not np.isnan(strays(manipulator, start, end, sum(found.actuators[:k], ())))
    if found.actuators and max(map(len, found.actuators)) <= 10:
        expected = np.nanmax(between(manipulator, start, end, found.actuators))
        assert found.deviation == pytest.approx(expected, abs=1e-9)


@st.composite
def transitions(draw: st.DrawFn, switches: int = 5) -> tuple[Manipulator, np.ndarray, np.ndarray]:
    manipulator = draw(short_arms())
    states = st.tuples(*(st.integers(0, int(k) - 1) for k in manipulator.states))
    start, aim = np.array(draw(states)), np.array(draw(states))
    end = start.copy()
    for i in range(len(end)):
        end[i] = aim[i]
        if manipulator.switches(start, end) > switches:
            end[i] = start[i]
    return manipulator, start, end


@settings(max_examples=150, deadline=None)
@given(transitions(), st.integers(1, 5), st.none() | st.integers(1, 5))
def test_no_other_stages_keep_the_tip_nearer(
    transition: tuple[Manipulator, np.ndarray, np.ndarray], most: int, limit: int | None
) -> None:
    manipulator, start, end = transition
    items = differing(manipulator, start, end)
    assume(limit is None or limit >= -(-len(items) // most))
    found = order_stages(manipulator, start, end, most, limit)
    check(manipulator, start, end, found, most, limit)
    if not items:
        return
    away = {frozenset(chosen): strays(manipulator, start, end, chosen) for chosen in subsets(items)}
    candidates = []
    for plan in partitions(items, most):
        ends = [frozenset(sum(plan[: k + 1], ())) for k in range(len(plan))]
        if (limit is None or len(plan) <= limit) and not any(np.isnan(away[e]) for e in ends):
            earlier = [frozenset(), *ends]
            passed = [away[earlier[k] | set(chosen)] for k in range(len(plan)) for chosen in subsets(plan[k])]
            candidates.append((bool(np.isnan(passed).any()), float(np.nanmax(passed)), len(plan)))
    unknown, least, _ = min(candidates)
    together = np.nanmax(list(away.values()))
    assert np.isnan(between(manipulator, start, end, found.actuators)).any() == unknown
    assert found.deviation == pytest.approx(least, abs=1e-9)
    slack = 1e-8 * together + 1e-13
    loose, strict = (min(n for u, top, n in candidates if u == unknown and top <= least + s) for s in (slack, 0.0))
    assert loose <= len(found.actuators) <= strict, "the fewest of equal deviations"


@pytest.mark.parametrize("most", [1, 2, 3])
def test_the_tip_of_the_truss_arm_strays_less_than_half_as_far(most: int) -> None:
    manipulator, rng, ratios = paper_arm(16), np.random.default_rng(1), []
    for _ in range(200):
        start, end = flipped(manipulator, int(rng.integers(3, 9)), rng)
        found = order_stages(manipulator, start, end, most)
        ratios.append(found.deviation / at_once(manipulator, start, end))
    assert np.median(ratios) <= 0.5


@pytest.mark.parametrize("most", [1, 2, 3, 6])
def test_more_time_and_more_at_once_never_harm(most: int) -> None:
    manipulator, rng = paper_arm(16), np.random.default_rng(2)
    start, end = flipped(manipulator, 9, rng)
    found = [order_stages(manipulator, start, end, most, stages) for stages in range(-(-9 // most), 10)]
    deviations = [f.deviation for f in found]
    assert all(later <= earlier + 1e-9 for earlier, later in pairwise(deviations))
    assert found[0].deviation >= order_stages(manipulator, start, end, most + 1, len(found[0].actuators)).deviation
    assert order_stages(manipulator, start, end, most).deviation == pytest.approx(deviations[-1])


@pytest.mark.parametrize(("most", "limit"), [(1, None), (3, None), (3, 12), (4, 10), (8, 6), (48, None), (48, 2)])
@pytest.mark.parametrize("n", [13, 20, 36])
def test_many_switches_keep_the_bounds_and_better_base_to_tip(n: int, most: int, limit: int | None) -> None:
    manipulator, rng = paper_arm(16), np.random.default_rng(n)
    start, end = flipped(manipulator, n, rng)
    if limit is not None and limit * most < n:
        limit = -(-n // most)
    found = order_stages(manipulator, start, end, most, limit)
    check(manipulator, start, end, found, most, limit)
    size = 1 if limit is None else -(-n // limit)
    if size <= 10:
        items = differing(manipulator, start, end)
        upwards = tuple(items[k : k + size] for k in range(0, n, size))
        assert found.deviation <= between(manipulator, start, end, upwards).max() + 1e-9


@pytest.mark.parametrize(("most", "limit"), [(1, None), (2, None), (3, 9), (5, 6), (30, 1)])
@pytest.mark.parametrize("seed", range(4))
def test_many_switches_of_modules_with_missing_states(most: int, limit: int | None, seed: int) -> None:
    manipulator = spatial_arm(13)
    start, end = np.random.default_rng(seed).integers(0, manipulator.states, (2, 13))
    n = manipulator.switches(start, end)
    assert n > 12
    limit = limit and max(limit, -(-n // most))
    check(manipulator, start, end, order_stages(manipulator, start, end, most, limit), most, limit)


def test_hundreds_of_switches_keep_the_bounds() -> None:
    manipulator, rng = paper_arm(80), np.random.default_rng(0)
    start, end = flipped(manipulator, 200, rng)
    found = order_stages(manipulator, start, end, 3, 100)
    check(manipulator, start, end, found, 3, 100)
    assert found.deviation < at_once(manipulator, start, end)


def test_missing_states_are_avoided_if_stages_allow_it() -> None:
    """From 011 to 100 a module of five states must contract before it extends, or pass through 7, 6 or 5."""
    module = transforms([frames.planar(0.1 * k, 1, 0.1 * k * k) for k in range(5)], planar=True)
    manipulator, start, end = Manipulator([module]), np.array([3]), np.array([4])
    for most in (1, 2, 3):
        assert order_stages(manipulator, start, end, most).actuators[-1] == (0,)
    assert order_stages(manipulator, start, end, 3, 2).actuators == ((1, 2), (0,))
    once = order_stages(manipulator, start, end, 3, 1)
    assert once.actuators == ((0, 1, 2),)
    assert once.deviation == max(strays(manipulator, start, end, c) for c in [(1,), (2,), (1, 2)])


poses = np.array([frames.planar(0.1 * k, 1, 0.2 * k) for k in range(3)])
one_hot = Module(poses, np.eye(3, dtype=np.uint8), ("a", "b", "c"), np.zeros((3, 1, 2, 3)), planar=True)


@pytest.mark.parametrize("count", [2, 8])
def test_actuators_that_no_state_parts_switch_together(count: int) -> None:
    manipulator = Manipulator([one_hot] * count)
    start, end = np.zeros(count, dtype=np.int64), np.ones(count, dtype=np.int64)
    found = order_stages(manipulator, start, end, 2)
    assert sorted(found.actuators) == [(3 * i, 3 * i + 1) for i in range(count)]
    check(manipulator, start, end, found, 2, None)
    with pytest.raises(ValueError, match=r"most: 1 actuators at once.*no order was found"):
        order_stages(manipulator, start, end, 1)


def test_nothing_switches() -> None:
    start = np.zeros(16, dtype=np.int64)
    for limit in (None, 0, 1):
        assert order_stages(paper_arm(16), start, start, 1, limit) == Stages((), 0.0)


def test_one_switch_is_one_stage_without_deviation() -> None:
    start, end = np.zeros(16, dtype=np.int64), np.eye(16, dtype=np.int64)[3]
    found = order_stages(paper_arm(16), start, end, 5)
    assert found.actuators == ((11,),)
    assert found.deviation == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(
    ("most", "limit", "sentence"),
    [
        (0, None, "most: 0 actuators at once, at least 1"),
        (-2, None, "most: -2"),
        (1, 3, "stages: 3 of at most 1 actuators for 4 switches, at least 4"),
        (3, 1, "stages: 1 of at most 3 actuators for 4 switches, at least 2"),
        (3, 0, "stages: 0 of"),
        (3, -1, "stages: -1 of"),
    ],
)
def test_bounds_that_cannot_be_kept_are_refused(most: int, limit: int | None, sentence: str) -> None:
    start, end = flipped(paper_arm(16), 4, np.random.default_rng(0))
    with pytest.raises(ValueError, match=sentence):
        order_stages(paper_arm(16), start, end, most, limit)
