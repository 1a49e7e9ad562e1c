"""All configurations near a position: against brute force, and in turns."""

from itertools import islice

import numpy as np

from hyperbit.controller.search.neighbours.chain import chain_of
from hyperbit.controller.search.neighbours.serving import serving, upper_tips, walks
from tests.arms import every_configuration, paper_arm


def test_all_that_are_near_are_listed_once():
    arm = paper_arm(4)
    chain = chain_of(arm, np.ones((4, 3)), 1.0, True)
    tips, near = upper_tips(chain, 64, 0.05), np.zeros((4, 8))
    every = every_configuration(arm)
    position = arm.tip(every[1234])[:3, 3].copy()
    listed = [
        found for walk in walks(chain, tips, near) for found in serving(chain, tips, walk, near, np.inf, position, 0.05)
    ]
    keys = np.concatenate(listed)
    distances = np.linalg.norm(arm.tips(every)[:, :3, 3] - position, axis=1)
    assert len(np.unique(keys)) == len(keys)
    assert np.count_nonzero(distances <= 0.05) <= len(keys) <= np.count_nonzero(distances <= 0.05 + 1e-3)


def test_a_caller_gets_turns_while_nothing_is_found():
    """A search looks at its deadline in each turn: lists of which nothing is cheap enough once took minutes."""
    arm = paper_arm(16)
    chain = chain_of(arm, np.ones((16, 3)), 1.0, True)
    near = np.zeros((16, 8))
    near[12:] = 1.0  # the upper modules are too dear, the lower ones are free
    tips = upper_tips(chain, 8**4, 1.0)
    [*turns] = islice(serving(chain, tips, walks(chain, tips, near)[0], near, 0.5, np.array([0.0, 3.0, 0.0]), 1.0), 3)
    assert [len(found) for found in turns] == [0, 0, 0]
