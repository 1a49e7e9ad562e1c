"""The chain: kinematics, actuator states, and padding for mixed modules."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.manipulator.vgt import vgt
from tests.arms import any_frames, paper_arm, planar_frames, short_arms, spatial_arm


@st.composite
def posed(draw, count=1, **arm):
    manipulator = draw(short_arms(**arm))
    chosen = [[draw(st.integers(0, k - 1)) for k in manipulator.states] for _ in range(count)]
    return manipulator, np.array(chosen)


@given(posed(count=3, bases=any_frames))
def test_a_batch_gives_what_each_configuration_gives(case):
    manipulator, configurations = case
    singles = [manipulator.tip(c) for c in configurations]
    assert_allclose(manipulator.tips(configurations), singles, atol=1e-12)


@given(posed(bases=any_frames))
def test_the_tip_is_the_product_of_base_and_modules(case):
    manipulator, (configuration,) = case
    product = manipulator.base
    for module, state in zip(manipulator.modules, configuration, strict=True):
        product = product @ module.frames[state]
    assert_allclose(manipulator.tip(configuration), product, atol=1e-12)
    chain = manipulator.chain(configuration)
    assert_allclose(chain[0], manipulator.base, atol=0)
    assert_allclose(chain[-1], product, atol=1e-12)
    steps = frames.inverse(chain[:-1]) @ chain[1:]
    expected = [m.frames[s] for m, s in zip(manipulator.modules, configuration, strict=True)]
    assert_allclose(steps, expected, atol=1e-12)


@given(posed(), any_frames)
def test_moving_the_base_moves_the_tip(case, base):
    manipulator, (configuration,) = case
    moved = Manipulator(manipulator.modules, base)
    assert_allclose(moved.tip(configuration), base @ manipulator.tip(configuration), atol=1e-12)


@given(posed())
def test_the_tip_is_no_farther_than_the_length(case):
    manipulator, (configuration,) = case
    assert np.linalg.norm(manipulator.tip(configuration)[:3, 3]) <= manipulator.length + 1e-12


@given(posed(bases=any_frames))
def test_the_body_is_there_and_joins_module_to_module(case):
    manipulator, (configuration,) = case
    chain, body = manipulator.chain(configuration), manipulator.body(configuration)
    assert len(body) == sum(m.body.shape[1] for m in manipulator.modules)
    start = 0
    for i, module in enumerate(manipulator.modules):
        own = body[start : start + module.body.shape[1]]
        start += module.body.shape[1]
        # A listed module is one line from frame to frame; a truss ends in its top, whose middle is the frame.
        assert_allclose(own[-1, 1] if len(own) == 1 else own[-1].mean(axis=0), chain[i + 1, :3, 3], atol=1e-12)


@given(posed())
def test_actuator_states_read_back_as_the_configuration(case):
    manipulator, (configuration,) = case
    states = manipulator.actuator_states(configuration)
    assert len(states) == len(manipulator.actuators)
    assert manipulator.configuration(states).tolist() == configuration.tolist()


@given(posed(count=2))
def test_switches_are_the_actuators_that_differ(case):
    manipulator, (first, second) = case
    differing = manipulator.actuator_states(first) != manipulator.actuator_states(second)
    assert manipulator.switches(first, second) == differing.sum()


def test_a_code_without_a_configuration_is_refused():
    three = transforms([frames.planar(x, 1) for x in range(3)], planar=True)
    manipulator = Manipulator([three, three])
    assert manipulator.configuration([0, 1, 1, 0]).tolist() == [1, 2]
    with pytest.raises(ValueError, match=r"module 2 has no state in which 1 is extended and 2 is extended"):
        manipulator.configuration([0, 1, 1, 1])


@pytest.mark.parametrize("count", [0, 1, 3, 47, 49])
def test_the_wrong_number_of_actuator_states_is_refused(manipulator, count):
    with pytest.raises(ValueError, match=r"48 actuator states, got an array of shape"):
        manipulator.configuration(np.zeros(count, dtype=np.uint8))


def test_actuators_are_named_from_the_base(manipulator):
    assert manipulator.actuators[:4] == ("1.left", "1.diagonal", "1.right", "2.left")
    assert len(manipulator.actuators) == 48


def test_a_chain_of_unlike_modules():
    truss = vgt("BC", 0.2, (0.2, 0.25), (0.2, 0.25), (0.2, 0.25))
    gripper = transforms([frames.spatial((0, 0, 0.1)), frames.spatial((0, 0, 0.2), (0, 1, 0, 1))], planar=False)
    five = transforms([frames.planar(0.1 * k, 0.3) for k in range(5)], planar=True)
    manipulator = Manipulator([truss, gripper, five])
    assert (manipulator.dimension, manipulator.states.tolist()) == (3, [8, 2, 5])
    assert manipulator.bits.shape == (3, 8, 3)
    assert manipulator.actuators == ("1.left", "1.diagonal", "1.right", "2.1", "3.1", "3.2", "3.3")
    expected = truss.frames[7] @ gripper.frames[1] @ five.frames[4]
    assert_allclose(manipulator.tip([7, 1, 4]), expected, atol=1e-12)
    assert Manipulator([truss, five]).dimension == 2


@given(planar_frames, any_frames)
def test_a_planar_arm_on_a_tilted_base_is_spatial(flat, tilted):
    assert Manipulator(paper_arm(2).modules, flat).planar
    assert Manipulator(paper_arm(2).modules, tilted).planar == np.allclose(tilted[2], [0, 0, 1, 0])


def test_a_spatial_chain_by_hand():
    manipulator = spatial_arm(3)
    assert manipulator.dimension == 3
    assert_allclose(manipulator.tip([4, 5, 4])[:3, 3], [0, 0, 0.7], atol=1e-12)
    # A bend about x, counter-clockwise, brings what is above towards -y.
    assert manipulator.tip([0, 5, 5])[1, 3] < -0.1


def test_an_arm_needs_modules():
    with pytest.raises(ValueError, match="at least one module, got none"):
        Manipulator([])
