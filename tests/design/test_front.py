"""Fronts and their volumes, against definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.design.front import chosen, front_of, reference_of, volume

SIDE = 5
dimensions = st.integers(2, 3)


def points(dimension: int) -> st.SearchStrategy[np.ndarray]:
    row = st.lists(st.integers(0, SIDE), min_size=dimension, max_size=dimension)
    return st.lists(row, min_size=1, max_size=12).map(lambda rows: np.array(rows, dtype=float))


several = dimensions.flatmap(points)


@given(several)
def test_the_volume_is_the_number_of_dominated_cells(rows):
    cells = np.stack(np.meshgrid(*[np.arange(SIDE) + 0.5] * rows.shape[1]), axis=-1).reshape(-1, rows.shape[1])
    dominated = (rows[None] <= cells[:, None]).all(axis=2).any(axis=1).sum()
    assert volume(rows, np.full(rows.shape[1], float(SIDE))) == pytest.approx(dominated)


@given(several)
def test_the_front_has_each_best_point_once(rows):
    front = rows[front_of(rows)]
    assert len(np.unique(front, axis=0)) == len(front)
    for row in rows:
        assert (front <= row).all(axis=1).any()
    for k, row in enumerate(front):
        others = np.delete(front, k, axis=0)
        assert not ((others <= row).all(axis=1)).any()


@given(several, st.integers(1, 4))
def test_chosen_points_are_of_the_front_and_the_first_adds_most(rows, most):
    front, own = front_of(rows), chosen(rows, most)
    assert set(own) <= set(front)
    assert len(own) == min(most, len(front))
    if len(own) < len(front):
        reference = reference_of(rows[front])
        best = max(volume(rows[[k]], reference) for k in front)
        assert max(volume(rows[[k]], reference) for k in own) == pytest.approx(best)
