"""The stages of one transition: which actuators switch together, and in what order, so that the tip strays least."""

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice, product, takewhile

import numpy as np
from numba import njit

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.motion.deviation import Array, Index, Transition
from controller.motion.transition import build_transition

EXACT = 11  # most switches of which every order is weighed: 9 ms, at 12 they would take 24
WINDOW = 8  # most of a window of stages that are put in the best order
ROUNDS = 20  # most changes made
TRIES = 100  # most changes tried for each
NEAR = 3  # stages on either side with which a stage swaps actuators
BEAM = 75_000  # width of the beam times the square of the number of actuators
PRESENT = 0.1  # weight of the deviation at the moment beside the greatest so far, in the beam
SKIPPED = -1.0  # deviation of actuator states that the module has no state for
SLACK = 1e-9  # of the greatest deviation; those no further apart count as equal
ROUNDING = 1e-15  # of an deviation


@dataclass(frozen=True)
class Stages:
    """What switches together, and how far the tip strays from the straight line between its two ends.

    The actuators of a stage finish in any order, so every subset of them may have switched for a while.

    Attributes:
        actuators: indices into the arm's actuators, ascending within a stage, stage by stage.
        deviation: greatest distance of the tip from the line.
        at_once: likewise if all actuators switched in one stage.
    """

    actuators: tuple[tuple[int, ...], ...]
    deviation: float
    at_once: float


def order_stages(
    manipulator: Manipulator, start: Configuration, end: Configuration, most: int, stages: int | None = None
) -> Stages:
    """Returns the stages that take the tip from `start` to `end` with the smallest deviation found, and so the fewest.

    For up to EXACT switches it is the smallest there is. For more, orders found by beam search, from base to tip and
    from tip to base are cut into stages as well as can be, the best is taken and its worst stages are improved: it may
    not be the smallest. Deviations of more actuators at once than deviation.COUNTED, in `at_once` or in a stage, are
    found by ascent and may be too low.

    Each stage ends in actuator states that every module has a state for. Others in between are avoided if the bounds
    allow it, whatever the deviation, and otherwise left out of it: where the tip then is, nobody knows.

    Args:
        manipulator: the arm.
        start: configuration, shape (B,).
        end: configuration, shape (B,).
        most: actuators that may switch at once, a bound on the inrush current.
        stages: for how many there is time, None: any number.

    Raises:
        ValueError: `most` is less than 1, `stages` too few, or no order ends each stage in states that modules have.
    """
    if most < 1:
        raise ValueError(f"most: {most} actuators at once, at least 1 is needed")
    transition = build_transition(manipulator, start, end)
    n = len(transition.actuators)
    limit = n if stages is None else min(stages, n)
    if limit * most < n:
        raise ValueError(
            f"stages: {stages} of at most {most} actuators for {n} switches, at least {-(-n // most)} needed"
        )
    if n == 0:
        return Stages((), 0.0, 0.0)
    everything, before = np.arange(n), transition.masks([])
    skipping = replace(transition, unknown=SKIPPED)
    for t in (transition, skipping):
        found = best_stages(t, before, everything, most, limit) if n <= EXACT else good_stages(t, most, limit)
        if found and (deviation := max(peaks(t, before, found))) < np.inf:
            at_once = max(deviation, skipping.greatest(before, everything))
            return Stages(tuple(tuple(sorted(t.actuators[k].tolist())) for k in found), deviation, at_once)
    raise ValueError(
        f"most: {most} actuators at once, in at most {limit} stages; no order was found in which every stage ends in"
        " actuator states that all modules have"
    )


def peaks(transition: Transition, masks: Index, stages: list[Index]) -> Iterator[float]:
    """Yields each stage's greatest deviation, the first on top of masks (m,)."""
    for stage in stages:
        yield transition.greatest(masks, stage)
        masks = masks + transition.masks([stage])


def least(levels: Array, split: Callable[[float], list[Index]], limit: int) -> list[Index]:
    """Returns what `split` gives for the least level at which these are at most `limit` stages; it fails with none."""
    levels = np.unique(levels[np.isfinite(levels)])
    slack = SLACK * levels.max(initial=0.0) + ROUNDING
    index = bisect_left(levels, True, key=lambda level: 0 < len(split(level + slack)) <= limit)
    return split(levels[index] + slack) if index < len(levels) else []


def best_stages(transition: Transition, masks: Index, actuators: Index, most: int, limit: int) -> list[Index]:
    """Returns the best stages for some of the actuators on top of masks (m,), none if there are none."""
    deviations = transition.deviations(masks, actuators)
    spans, bits = fill_spans(deviations), np.arange(len(actuators))

    def split(level: float) -> list[Index]:
        return [actuators[stage >> bits & 1 == 1] for stage in partition(deviations, spans, most, level)]

    return least(deviations, split, limit)


def good_stages(transition: Transition, most: int, limit: int) -> list[Index]:
    """Returns good stages for many actuators, none if none are found."""
    upwards = np.arange(len(transition.actuators))
    orders = [beam(transition), beam(transition.back())[::-1].copy(), upwards, upwards[::-1].copy()]
    cuts = [stages for order in orders if (stages := cut(transition, order, most, limit))]
    if not cuts:
        return []
    best = min(cuts, key=lambda stages: (max(peaks(transition, transition.masks([]), stages)), len(stages)))
    if max(map(len, best)) > WINDOW:
        return best
    return cut(transition, np.concatenate(improve(transition, best, most, limit)), most, limit)


def beam(transition: Transition) -> Index:
    """Returns the actuators one after the other (n,) so that the deviation is small; empty if none may follow."""
    n, m = len(transition.actuators), len(transition.end)
    width = min(max(BEAM // n**2, 4), 32)
    salts = np.random.default_rng(0).integers(0, 2**62, n)  # their sum stands for the set of those that have switched
    masks, orders = np.zeros((1, m), dtype=np.int64), np.zeros((1, 0), dtype=np.int64)
    keys, greatest = np.zeros(1, dtype=np.int64), np.zeros(1)
    for _ in range(n):
        away = transition.singles(masks)
        following = np.maximum(greatest[:, None], away)
        scores = (following + PRESENT * away).ravel()
        best = np.argsort(scores)[: np.count_nonzero(np.isfinite(scores))]
        _, first = np.unique((keys[:, None] + salts).ravel()[best], return_index=True)
        parents, chosen = np.divmod(best[np.sort(first)[:width]], n)
        masks, keys = masks[parents], keys[parents] + salts[chosen]
        masks[np.arange(len(masks)), transition.owners[chosen]] |= transition.flags[chosen]
        greatest, orders = following[parents, chosen], np.hstack([orders[parents], chosen[:, None]])
        if len(orders) == 0:
            return orders.ravel()
    return np.asarray(orders[0])


def cut(transition: Transition, order: Index, most: int, limit: int) -> list[Index]:
    """Returns the best stages of actuators that follow one another in `order`, none if there are none."""
    n, modules = len(order), np.arange(len(transition.end))
    wide = limit * min(most, WINDOW) < n  # stages of so many actuators are judged by their number alone
    reach = min(most, n if wide else WINDOW)
    masks = np.array([transition.masks([order[:i]]) for i in range(n + 1)])
    ends = np.all(transition.known[modules, masks[1:]], axis=1)
    spans = np.full((n, reach), np.inf)
    for i in range(n):
        sizes = np.arange(1, min(reach, n - i) + 1)
        heights = sizes.astype(float)
        if not wide:
            heights = np.maximum.accumulate(transition.deviations(masks[i], order[i : i + reach]))[(1 << sizes) - 1]
        spans[i, : len(sizes)] = np.where(ends[i : i + reach], heights, np.inf)

    def split(level: float) -> list[Index]:
        stages, i = list[Index](), 0
        while i < n:
            fitting = np.flatnonzero(spans[i] <= level)
            if len(fitting) == 0:
                return []
            stages.append(order[i : i + fitting[-1] + 1])
            i += len(stages[-1])
        return stages

    return least(spans, split, limit)


def improve(transition: Transition, stages: list[Index], most: int, limit: int) -> list[Index]:
    """Returns the stages after changes around the worst of them, as long as one betters it."""
    tops = list(peaks(transition, transition.masks([]), stages))
    for _ in range(ROUNDS):
        worst = int(np.argmax(tops))
        lower = tops[worst] * (1 - SLACK)
        for first, last, change in islice(changes(transition, stages, worst, most, limit), TRIES):
            heights = peaks(transition, transition.masks(stages[:first]), change)
            if change and len(fitting := list(takewhile(lower.__gt__, heights))) == len(change):
                stages, tops = stages[:first] + change + stages[last:], tops[:first] + fitting + tops[last:]
                break
        else:
            break
    return stages


def changes(
    transition: Transition, stages: list[Index], worst: int, most: int, limit: int
) -> Iterator[tuple[int, int, list[Index]]]:
    """Yields first, end and replacement of stages around one: each window in its best order, then swaps with others."""
    ends = np.cumsum([0, *map(len, stages)])
    for first in range(worst, -1, -1):
        last = int(np.searchsorted(ends, ends[first] + WINDOW, side="right")) - 1
        if last <= worst:
            break
        window, spare = np.concatenate(stages[first:last]), limit - len(stages) + last - first
        yield first, last, best_stages(transition, transition.masks(stages[:first]), window, most, spare)
    if transition.unknown == np.inf:  # else a swap might end a stage where a module has no state
        for other in sorted(range(len(stages)), key=lambda k: abs(k - worst))[1 : 2 * NEAR + 1]:
            first, last = min(worst, other), max(worst, other) + 1
            for j, k in product(range(len(stages[worst])), range(len(stages[other]))):
                change = [stage.copy() for stage in stages[first:last]]
                change[worst - first][j], change[other - first][k] = stages[other][k], stages[worst][j]
                yield first, last, change


def fill_spans(deviations: Array) -> Array:
    """Returns the greatest deviation of every possible stage, from those of all subsets (2^k,).

    Digit j of the index to base 3 is 0 if actuator j switches later, 1 if earlier, 2 if in this stage; shape (3^k,).
    """
    right, spans = len(deviations), deviations
    while right > 1:
        right //= 2
        either = spans.reshape(-1, 2, right)
        spans = np.concatenate([either, either.max(axis=1, keepdims=True)], axis=1)
    return spans.ravel()


@njit("i8[::1](f8[::1], f8[::1], i8, f8)", cache=True, nogil=True)
def partition(deviations: Array, spans: Array, most: int, level: float) -> Index:
    """Returns the fewest stages, as masks of actuators, whose deviations are at most the level; none if none are."""
    size = len(deviations)
    ternary, ones, counts = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.int64), np.full(size, size)
    last = np.zeros(size, dtype=np.int64)
    counts[0] = 0
    for whole in range(1, size):
        ternary[whole] = 3 * ternary[whole >> 1] + (whole & 1)
        ones[whole] = ones[whole >> 1] + (whole & 1)
        if not 0 <= deviations[whole] <= level:
            continue
        part = whole
        while part:
            rest = whole ^ part
            span = ternary[rest] + 2 * ternary[part]
            if counts[rest] + 1 < counts[whole] and ones[part] <= most and spans[span] <= level:
                counts[whole], last[whole] = counts[rest] + 1, part
            part = (part - 1) & whole
    result = np.empty(counts[-1] % size, dtype=np.int64)  # empty if the last count is still `size`
    whole = size - 1
    for stage in range(len(result) - 1, -1, -1):
        result[stage] = last[whole]
        whole ^= last[whole]
    return result
