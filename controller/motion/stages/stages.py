"""The stages of one transition: which actuators switch together and in which order, so that the tip deviates least."""

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice, product, takewhile

import numpy as np

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.motion.stages.transition import Array, Index, Transition, build_transition

EXACT = 11  # most switches for which all orders are compared: 9 ms; 12 would take 24 ms
WINDOW = 8  # most actuators of consecutive stages that are reordered exactly
ROUNDS = 20  # most improvements
TRIES = 100  # most changes tried for one improvement
NEAR = 3  # stages on either side with which a stage swaps actuators
BEAM = 75_000  # beam width times the square of the number of actuators
PRESENT = 0.1  # weight of the present deviation beside the greatest so far, in the beam's score
SKIPPED = -1.0  # deviation that is assumed for actuator states that a module has no state for
SLACK = 1e-9  # deviations that differ by this share of the greatest count as equal
ROUNDING = 1e-15  # rounding error of a deviation


@dataclass(frozen=True)
class Stages:
    """An ordered partition of the actuators that switch, and its deviation from the straight line.

    The actuators of a stage finish in any order, so every subset of them may have switched for a while.
    """

    actuators: tuple[tuple[int, ...], ...]  # indices into the arm's actuators, for each stage, ascending within a stage
    deviation: float  # greatest distance of the tip from the line


def order_stages(
    manipulator: Manipulator, start: Configuration, end: Configuration, most: int, stages: int | None = None
) -> Stages:
    """Returns the stages between configurations (B,) with the smallest deviation found, and the fewest of these.

    Up to EXACT switches the deviation is the minimum. Above, several orders (by beam search in both directions, base to
    tip, and tip to base) are cut into stages optimally; the best is then improved around its worst stages. The result
    may not be the minimum. Deviations of more than deviation.COUNTED actuators at once are found by ascent and may be
    too low.

    Each stage ends in actuator states that every module has a state for. Unknown states within a stage are avoided if
    the bounds allow it. Otherwise their deviation is not counted, because the tip's position is not known in them.
    At most `most` actuators switch at once (inrush bound), in as many `stages` as the time allows; None: any number.

    Raises:
        ValueError: `most` is less than 1, `stages` is too small, or each order found ends a stage in an unknown state.
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
        return Stages((), 0.0)
    everything, before = np.arange(n), transition.masks([])
    for t in (transition, replace(transition, unknown=SKIPPED)):
        found = best_stages(t, before, everything, most, limit) if n <= EXACT else good_stages(t, most, limit)
        if found and (deviation := max(peaks(t, before, found))) < np.inf:
            return Stages(tuple(tuple(sorted(t.actuators[k].tolist())) for k in found), deviation)
    raise ValueError(
        f"most: {most} actuators at once, in at most {limit} stages; no order was found in which every stage ends in"
        " actuator states that all modules have"
    )


def peaks(transition: Transition, masks: Index, stages: list[Index]) -> Iterator[float]:
    """Yields the greatest deviation of each stage, from masks (m,)."""
    for stage in stages:
        yield transition.greatest(masks, stage)
        masks = masks + transition.masks([stage])


def least(levels: Array, split: Callable[[float], list[Index]], limit: int) -> list[Index]:
    """Returns split(level) for the least level that needs at most `limit` stages; an empty list if there is none."""
    levels = np.unique(levels[np.isfinite(levels)])
    slack = SLACK * levels.max(initial=0.0) + ROUNDING
    index = bisect_left(levels, True, key=lambda level: 0 < len(split(level + slack)) <= limit)
    return split(levels[index] + slack) if index < len(levels) else []


def best_stages(transition: Transition, masks: Index, actuators: Index, most: int, limit: int) -> list[Index]:
    """Returns the best stages of some actuators from masks (m,); an empty list if there are none."""
    deviations = transition.deviations(masks, actuators)
    spans, bits = fill_spans(deviations), np.arange(len(actuators))

    def split(level: float) -> list[Index]:
        return [actuators[stage >> bits & 1 == 1] for stage in partition(deviations, spans, most, level)]

    return least(deviations, split, limit)


def good_stages(transition: Transition, most: int, limit: int) -> list[Index]:
    """Returns good stages for more than EXACT actuators; an empty list if none are found."""
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
    """Returns an order of all actuators (n,) with a small deviation, by beam search; empty if each order is blocked."""
    n, m = len(transition.actuators), len(transition.end)
    width = min(max(BEAM // n**2, 4), 32)
    salts = np.random.default_rng(0).integers(0, 2**62, n)  # their sum identifies the set of switched actuators
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
    """Returns the best cut of an order into stages; an empty list if there is none."""
    n, modules = len(order), np.arange(len(transition.end))
    wide = limit * min(most, WINDOW) < n  # stages must be too large for their deviations: minimize their number only
    longest = min(most, n if wide else WINDOW)
    masks = np.array([transition.masks([order[:i]]) for i in range(n + 1)])
    ends = np.all(transition.modules.known[modules, masks[1:]], axis=1)
    spans = np.full((n, longest), np.inf)
    for i in range(n):
        sizes = np.arange(1, min(longest, n - i) + 1)
        heights = sizes.astype(float)
        if not wide:
            heights = np.maximum.accumulate(transition.deviations(masks[i], order[i : i + longest]))[(1 << sizes) - 1]
        spans[i, : len(sizes)] = np.where(ends[i : i + longest], heights, np.inf)

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
    """Returns the stages after changes around the worst stage, repeated as long as one lowers its deviation."""
    tops = list(peaks(transition, transition.masks([]), stages))
    for _ in range(ROUNDS):
        worst = int(np.argmax(tops))
        threshold = tops[worst] * (1 - SLACK)
        for first, last, change in islice(changes(transition, stages, worst, most, limit), TRIES):
            heights = peaks(transition, transition.masks(stages[:first]), change)
            if change and len(fitting := list(takewhile(threshold.__gt__, heights))) == len(change):
                stages, tops = stages[:first] + change + stages[last:], tops[:first] + fitting + tops[last:]
                break
        else:
            break
    return stages


def changes(
    transition: Transition, stages: list[Index], worst: int, most: int, limit: int
) -> Iterator[tuple[int, int, list[Index]]]:
    """Yields changes as (first, last, replacement of stages first:last): reordered windows, then swaps of actuators."""
    ends = np.cumsum([0, *map(len, stages)])
    for first in range(worst, -1, -1):
        last = int(np.searchsorted(ends, ends[first] + WINDOW, side="right")) - 1
        if last <= worst:
            break
        window, spare = np.concatenate(stages[first:last]), limit - len(stages) + last - first
        yield first, last, best_stages(transition, transition.masks(stages[:first]), window, most, spare)
    if transition.unknown == np.inf:  # otherwise a swap might end a stage in an unknown state
        for other in sorted(range(len(stages)), key=lambda k: abs(k - worst))[1 : 2 * NEAR + 1]:
            first, last = min(worst, other), max(worst, other) + 1
            for j, k in product(range(len(stages[worst])), range(len(stages[other]))):
                change = [stage.copy() for stage in stages[first:last]]
                change[worst - first][j], change[other - first][k] = stages[other][k], stages[worst][j]
                yield first, last, change


def fill_spans(deviations: Array) -> Array:
    """Returns the greatest deviation within every possible stage, from the deviations of all subsets (2^k,).

    Digit j of the base-3 index is 0 if actuator j switches later, 1 if earlier, 2 if in this stage; shape (3^k,).
    """
    right, spans = len(deviations), deviations
    while right > 1:
        right //= 2
        either = spans.reshape(-1, 2, right)
        spans = np.concatenate([either, either.max(axis=1, keepdims=True)], axis=1)
    return spans.ravel()


@kernel("i8[::1](f8[::1], f8[::1], i8, f8)")
def partition(deviations: Array, spans: Array, most: int, level: float) -> Index:
    """Returns the fewest stages, as masks of actuators, with deviations of at most `level`; empty if there are none."""
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
    result = np.empty(counts[-1] % size, dtype=np.int64)  # empty if counts[-1] is still `size`
    whole = size - 1
    for stage in range(len(result) - 1, -1, -1):
        result[stage] = last[whole]
        whole ^= last[whole]
    return result
