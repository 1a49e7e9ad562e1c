"""Deviations of all subsets of the switching actuators, compared with the arm's own kinematics."""

import numpy as np
import pytest

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.stages.transition import COUNTED, Transition, build_transition
from tests.arms import paper_arm, spatial_arm


def transition(manipulator: Manipulator, seed: int) -> tuple[np.ndarray, np.ndarray, Transition]:
    start, end = np.random.default_rng(seed).integers(0, manipulator.states, (2, len(manipulator.modules)))
    return start, end, build_transition(manipulator, start, end)


def away(point: np.ndarray, line: np.ndarray) -> float:
    parts = np.linspace(0, 1, 20_001)[:, None]
    return float(np.linalg.norm(point - line[0] - parts * (line[1] - line[0]), axis=1).min())


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("arm", [paper_arm(6), spatial_arm(5)], ids=["planar", "spatial"])
def test_subsets_are_as_far_away_as_the_tips_of_their_configurations(arm: Manipulator, seed: int) -> None:
    start, end, t = transition(arm, seed)
    order = np.random.default_rng(seed).permutation(len(t.actuators))
    earlier, stage = order[:3], order[3:8]
    found = t.deviations(t.masks([earlier]), stage)
    line = arm.tips([start, end])[:, :3, 3]
    for subset in range(len(found)):
        states = arm.actuator_states(start)
        switched = np.concatenate([earlier, stage[[j for j in range(len(stage)) if subset >> j & 1]]])
        states[t.actuators[switched]] ^= 1
        try:
            expected = away(arm.tip(arm.configuration(states))[:3, 3], line)
        except ValueError:
            expected = np.inf
        assert found[subset] == pytest.approx(expected, abs=2e-4)


def test_actuators_are_those_that_differ() -> None:
    start, end, t = transition(paper_arm(16), 0)
    differ = paper_arm(16).actuator_states(start) != paper_arm(16).actuator_states(end)
    assert t.actuators.tolist() == np.flatnonzero(differ).tolist()
    assert t.masks([np.arange(len(t.actuators))]).tolist() == t.end.tolist()


def test_the_tip_back_where_it_was_strays_from_a_point() -> None:
    arm = spatial_arm(1)
    t = build_transition(arm, np.array([5]), np.array([4]))
    t = Transition(**{**vars(t), "line": np.zeros((2, 3))})
    assert t.deviations(t.masks([]), np.array([0])) == pytest.approx([0.2, 0.25])


@pytest.mark.parametrize("seed", range(10))
def test_single_switches_are_the_subsets_of_one(seed: int) -> None:
    _, _, t = transition(spatial_arm(6), seed)
    n = len(t.actuators)
    switched = np.random.default_rng(seed).permutation(n)[: n // 2]
    masks = t.masks([switched])
    found = t.singles(masks[None])[0]
    assert np.isinf(found[switched]).all()
    for j in set(range(n)) - set(switched.tolist()):
        assert found[j] == pytest.approx(t.deviations(masks, np.array([j]))[1])


@pytest.mark.parametrize("seed", range(5))
def test_the_way_back_passes_the_same_states(seed: int) -> None:
    _, _, t = transition(spatial_arm(4), seed)
    everything = np.arange(len(t.actuators))
    there, back = t.deviations(t.masks([]), everything), t.back().deviations(t.masks([]), everything)
    assert there == pytest.approx(back[::-1])


@pytest.mark.parametrize("seed", range(20))
def test_ascent_finds_the_greatest_deviation_or_nearly(seed: int) -> None:
    _, _, t = transition(paper_arm(12), seed)
    stage, masks = np.random.default_rng(seed).permutation(len(t.actuators))[: COUNTED + 2], t.masks([])
    greatest = t.deviations(masks, stage).max()
    assert 0.98 * greatest <= t.greatest(masks, stage) <= greatest * (1 + 1e-9)
