"""Detours: ways to any of several ends, and proofs that there is none."""

import gc
import itertools
import weakref

import numpy as np
import pytest

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.stages.detours import Detour, Detours, NoWay
from hyperbit.controller.motion.stages.state_trees import add, find, packed, plant, root_of, route, state_tree
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import sphere, together
from hyperbit.controller.obstacles.sweep import Sweep
from tests.obstacles.moving import arm, hinge

POST = (0.29, 1.675)


def never() -> bool:
    return False


def followed(manipulator: Manipulator, clearance: BodyClearance, start: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Returns the actuator states at the end of a way, each of whose switches is clear by the swept check."""
    sweep, states = Sweep(clearance), manipulator.actuator_states(start)
    for actuator in order:
        assert sweep.first_collision(states, np.array([actuator])) is None
        states[actuator] ^= 1
    return states


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(("hinges", "post"), [(10, (0.97, 0.0)), (70, (0.97, 0.3))])
def test_a_way_around_a_post_is_found_with_one_word_of_states_and_with_two(hinges, post, threads):
    manipulator = arm([hinge(-2.0 / hinges, 2.0 / hinges, 1.0 / hinges)] * hinges)
    clearance = BodyClearance(manipulator, sphere("post", post, 0.05))
    down, up = np.zeros(hinges, dtype=np.int64), np.ones(hinges, dtype=np.int64)
    found = Detours(clearance, down, np.array([up]), threads=threads).search(never)
    assert isinstance(found, Detour)
    assert found.end.tolist() == up.tolist()
    assert followed(manipulator, clearance, down, found.order).tolist() == up.tolist()


def test_a_way_is_found_that_needs_many_hinges_in_a_row_bent_to_the_same_side():
    manipulator = arm([hinge(-0.2, 0.2, 0.1)] * 24)
    clearance = BodyClearance(manipulator, sphere("post", (1.5, 0.0), 0.1))
    above = np.arange(24) % 2
    below = above.copy()
    above[:6], below[:6] = 1, 0
    looks = itertools.count()
    found = Detours(clearance, above, below[None], complete=False).search(lambda: next(looks) > 200)
    assert isinstance(found, Detour)
    assert followed(manipulator, clearance, above, found.order).tolist() == below.tolist()


def test_an_end_that_cannot_be_reached_is_proven_so_and_all_that_can_is_listed():
    manipulator = arm([hinge(0.0, np.pi / 2, 1.0), hinge(0.0, -np.pi / 2, 1.0)])
    discs = [sphere("shelf", (0.0, 2.0), 0.4), sphere("table", (1.0, -0.9), 0.4)]
    clearance = BodyClearance(manipulator, together(discs))
    found = Detours(clearance, np.array([0, 0]), np.array([[1, 1]])).search(never)
    assert isinstance(found, NoWay)
    if found.reached is not None:
        assert [0, 0] in found.reached.tolist()
        assert [1, 1] not in found.reached.tolist()


def test_the_memory_of_a_search_is_free_when_it_is_forgotten():
    """The collector knows nothing of the size of arrays: tables that wait for it filled the memory of a planner."""
    manipulator = arm([hinge(-0.5, 0.5, 0.5)] * 4)
    clearance = BodyClearance(manipulator, sphere("post", (0.97, 0.0), 0.05))
    gc.disable()
    try:
        detours = Detours(clearance, np.zeros(4, dtype=np.int64), np.ones((1, 4), dtype=np.int64))
        assert detours.search(never) is not None
        forgotten = weakref.ref(detours)
        del detours
        assert forgotten() is None
    finally:
        gc.enable()


def test_without_all_ends_only_what_can_be_reached_is_a_proof():
    manipulator = arm([hinge(0.0, np.pi / 2, 1.0), hinge(0.0, -np.pi / 2, 1.0)])
    discs = [sphere("shelf", (0.0, 2.0), 0.4), sphere("table", (1.0, -0.9), 0.4)]
    detours = Detours(BodyClearance(manipulator, together(discs)), np.array([0, 0]), np.array([[1, 1]]), complete=False)
    found = detours.search(never)
    assert isinstance(found, NoWay)
    assert found.reached is not None
    assert detours.order_to(np.array([0, 0])).tolist() == []


def test_no_actuator_switches_twice_if_it_may_not():
    manipulator = arm([hinge(0.0, 2.4, 1.0)] * 2)  # the second must fold back while the first passes the post
    clearance = BodyClearance(manipulator, sphere("post", POST, 0.1))
    start, ends = np.array([0, 0]), np.array([[1, 0]])
    assert isinstance(Detours(clearance, start, ends, complete=False, once=True).search(never), NoWay)
    found = Detours(clearance, start, ends).search(never)
    assert isinstance(found, Detour)
    assert found.order.tolist() == [1, 0, 1]


def test_a_late_search_finds_nothing_and_goes_on_when_called_again():
    manipulator = arm([hinge(0.0, 2.4, 1.0)] * 2)
    clearance = BodyClearance(manipulator, sphere("post", POST, 0.1))
    detours = Detours(clearance, np.array([0, 0]), np.array([[1, 0]]))
    assert detours.search(lambda: True) is None
    assert isinstance(detours.search(never), Detour)
    assert isinstance(detours.search(never), Detour | NoWay)


@pytest.mark.parametrize("hinges", [5, 64, 65, 130])
def test_a_tree_finds_what_was_added_by_its_states(hinges):
    manipulator, rng = arm([hinge(-0.3, 0.3, 0.1)] * hinges), np.random.default_rng(hinges)
    some = np.unique(rng.integers(0, 2, (20, hinges)), axis=0)
    root, *others = some
    tree = state_tree(manipulator, hinges, len(some))
    plant(tree, manipulator, root[None])
    bits = packed(manipulator.actuator_states(np.array(others)))
    for number, (configuration, own) in enumerate(zip(others, bits, strict=True)):
        missing = find(tree, own)
        assert missing < 0
        assert add(tree, configuration, own, missing, number, number) == number + 1
    assert [find(tree, own) for own in bits] == list(range(1, len(some)))
    assert root_of(tree, len(some) - 1) == 0
    assert route(tree, len(some) - 1) == list(range(len(some) - 1))[::-1]
