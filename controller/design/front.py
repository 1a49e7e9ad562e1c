"""Fronts of designs: which no other design beats in all objectives, and the volume that they dominate."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.design.settings import StudySettings

Array = NDArray[np.float64]

GREATER = ("reached", "stuck")  # objectives of which more is better; of others less is


def losses(settings: StudySettings, figures: Sequence[Mapping[str, float]]) -> Array:
    """Returns what each design loses by each objective, shape (n, M); less is better, shares from 0 to 1."""
    rows = [[1 - one[name] if name in GREATER else one[name] for name in settings.objectives] for one in figures]
    return np.array(rows, dtype=float).reshape(len(rows), len(settings.objectives))


def lacking(settings: StudySettings, figures: Mapping[str, float]) -> dict[str, float]:
    """Returns by how much a design lacks each figure that the study requires; 0 or less: it does not."""
    wanted = settings.require.items()
    return {name: bound - figures[name] if name in GREATER else figures[name] - bound for name, bound in wanted}


def meets(settings: StudySettings, figures: Mapping[str, float]) -> bool:
    return all(lack <= 0 for lack in lacking(settings, figures).values())


def front_of(points: Array) -> list[int]:
    """Returns the rows of points (n, M) that no other row beats; of equal rows the first."""
    found = list[int]()
    for k, own in enumerate(points):
        no_worse = (points <= own).all(axis=1)
        beaten = no_worse & (points < own).any(axis=1)
        equal = no_worse[:k] & (points[:k] == own).all(axis=1)
        if not beaten.any() and not equal.any():
            found.append(k)
    return found


def volume(points: Array, reference: Array) -> float:
    """Returns the volume that points (n, M) dominate below a reference point (M,), for two or three objectives."""
    inside = points[(points < reference).all(axis=1)]
    inside = inside[np.argsort(inside[:, -1], kind="stable")]
    heights = np.diff(np.append(inside[:, -1], reference[-1]))
    if points.shape[1] == 2:
        return float(heights @ (reference[0] - np.minimum.accumulate(inside[:, 0]))) if len(inside) else 0.0
    layers = [volume(inside[: k + 1, :-1], reference[:-1]) for k in np.flatnonzero(heights)]
    return float(heights[heights > 0] @ np.array(layers))


def reference_of(points: Array) -> Array:
    """Returns a reference point (M,) a tenth of the extent beyond the worst of points (n, M)."""
    return np.asarray(points.max(axis=0) + 0.1 * np.maximum(np.ptp(points, axis=0), 1e-9))


def chosen(points: Array, most: int) -> list[int]:
    """Returns at most `most` rows of the front of points (n, M): greedily those that add the greatest volume."""
    left = front_of(points)
    if len(left) <= most:
        return left
    reference, found = reference_of(points[left]), list[int]()
    while len(found) < most:
        best = max(left, key=lambda k: (volume(points[[*found, k]], reference), -k))
        found.append(best)
        left.remove(best)
    return sorted(found)
