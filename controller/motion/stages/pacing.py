"""The pace of transitions: as many stages as the time allows, within the inrush bound."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.actuators import longest_travel
from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.motion.stages.stages import SKIPPED, order_stages, peaks
from hyperbit.controller.motion.stages.transition import Index, Transition, build_transition
from hyperbit.controller.obstacles.sweep import Collision, States, Sweep
from hyperbit.controller.program import TICK

MOST_STAGES = 8  # of a transition, unless the inrush bound needs more; further stages lower the deviation little


class Infeasible(ValueError):
    """The time is too short for a transition."""


class Blocked(Infeasible):
    """No collision-free sequence of stages was found."""


@dataclass(frozen=True, eq=False)
class Staged:
    """A transition as a sequence of stages."""

    stages: NDArray[np.uint8]  # actuator states after each stage, shape (k, A); k >= 1, also if nothing switches
    # the deviation, or a function that computes it. Computing it would delay the start of a goal.
    deviation_source: float | Callable[[], float] | None
    # the stages are collision-free one after the other; none may be skipped or merged with the next
    strict: bool = False

    @cached_property
    def deviation(self) -> float | None:
        """Greatest distance of the tip from the straight line; None if it is not known."""
        return self.deviation_source() if callable(self.deviation_source) else self.deviation_source

    def switches_from(self, states: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Returns how often each actuator switches, shape (A,), from the actuator states (A,) before."""
        return np.asarray(np.count_nonzero(np.diff(np.vstack([states, self.stages]), axis=0), axis=0))


@dataclass(frozen=True)
class Pace:
    """The limits on an arm's transitions."""

    lead: float  # time of one stage, from the tick before it to its end [s]
    # most actuators that may switch at once. None: no limit; a transition is one stage, unless obstacles need more.
    inrush: int | None = None
    rest: float = 0.0  # time that an actuator rests between two travels [s]

    @property
    def shortest(self) -> float:
        """Least time between two waypoints [s]."""
        return self.lead + self.rest

    @property
    def unhurried(self) -> float:
        """Time between two waypoints that suffices for any number of switches [s]; more time changes nothing."""
        return self.rest + self.lead * (1 if self.inrush is None else MOST_STAGES)

    def ample(self, actuators: int) -> float:
        """Returns a time between two waypoints that suffices for each switch of an arm without obstacles [s]."""
        return max(self.unhurried, self.needed(actuators))

    def needed(self, switches: int) -> float:
        """Returns the least time between two waypoints for a number of switches [s]."""
        return self.rest + self.lead * max(self.fewest(switches), 1)

    def longest(self, available: NDArray[np.float64], actuators: int, strict: bool) -> NDArray[np.float64]:
        """Returns the longest duration of transitions (n,) [s], from the time that is available to each (n,) [s]."""
        if strict:
            return np.minimum(available - self.rest, self.lead * actuators)
        if self.inrush is None:
            return np.full_like(available, self.lead)
        return np.minimum(available - self.rest, self.lead * max(MOST_STAGES, self.fewest(actuators)))

    def fewest(self, switches: int) -> int:
        return -(-switches // (self.inrush or max(switches, 1)))


class StageSequencer:
    """Finds collision-free stages from actuator states (A,). A stage lists the actuators (k,) that switch.

    The order and the strokes of a stage's actuators are free. An order of single actuators in which each switch is
    clear is cut into the fewest stages that are clear as a whole. At most `most` actuators switch at once.
    """

    def __init__(self, sweep: Sweep, states: States, most: int) -> None:
        self._sweep, self._states, self._most = sweep, states, most
        self._obstruction: Collision | None = None
        self._checked: dict[tuple[bytes, bytes], bool] = {}

    @property
    def obstruction(self) -> str:
        """What the last rejected stage collides with, or may collide with, in words."""
        return "nothing" if self._obstruction is None else self._sweep.describe(self._obstruction)

    def clear(self, stages: Sequence[Index]) -> bool:
        states = self._states
        for stage in stages:
            if not self._clear(states, stage):
                return False
            states = flipped(states, stage)
        return True

    def cut(self, order: Index) -> list[Index]:
        """Returns the fewest clear stages of actuators in an order; an empty list if one actuator alone collides."""
        stages, states, first = list[Index](), self._states, 0
        while first < len(order):
            rest = order[first : first + self._most]
            low, high = 0, next((k for k in range(1, len(rest)) if rest[k] in rest[:k]), len(rest))
            size = high
            while low < high:  # a part of a clear stage is clear
                if self._clear(states, rest[:size]):
                    low = size
                else:
                    high = size - 1
                size = (low + high + 1) // 2
            if low == 0:
                return []
            stages.append(rest[:low])
            states = flipped(states, rest[:low])
            first += low
        return stages

    def _clear(self, states: States, stage: Index) -> bool:
        key = states.tobytes(), np.sort(stage).tobytes()
        if key not in self._checked:
            collision = self._sweep.first_collision(states, stage)
            self._checked[key] = collision is None
            self._obstruction = collision or self._obstruction
        return self._checked[key]


def flipped(states: States, stage: Index) -> States:
    """Returns the states (A,) after a stage (k,)."""
    result = states.copy()
    result[stage] ^= 1
    return result


class Stager:
    """Cuts the transitions of one arm into stages that fit into their time, and that pass the checks of a sweep."""

    def __init__(self, manipulator: Manipulator, pace: Pace, sweep: Sweep | None = None) -> None:
        self._m, self._pace, self._sweep = manipulator, pace, sweep

    def staged(
        self,
        before: Configuration,
        after: Configuration,
        available: float | None = None,
        with_deviation: bool = True,
        detour: Index | None = None,
    ) -> Staged:
        """Returns the stages of a transition between configurations (B,); those without obstacles if they are clear.

        Args:
            before: at the waypoint before.
            after: at the waypoint after.
            available: time between these waypoints [s]; None: unlimited.
            with_deviation: compute the deviation, also without an inrush bound.
            detour: actuators (n,) that may switch one after the other, see Detours; used if no other order is clear.

        Raises:
            Infeasible: the time is too short; the message says what is needed.
            Blocked: no collision-free stages were found; the message names the obstacle.
        """
        usual = self._without_obstacles(before, after, available, with_deviation)
        if self._sweep is None:
            return usual
        start = self._m.actuator_states(before)
        sequencer = StageSequencer(self._sweep, start, self._pace.inrush or len(start))
        stages = numbered(start, usual.stages)
        if sequencer.clear(stages):
            return replace(usual, strict=True)
        if (touch := self._sweep.first_collision(start, np.arange(0))) is not None:  # also without time for a search
            raise Blocked(f"the arm collides where it stands: {self._sweep.describe(touch)}")
        room = np.inf if available is None or self._pace.lead == 0 else self._room(available)
        transition = build_transition(self._m, before, after)
        upwards, own = transition.actuators, np.concatenate(stages)
        cuts = [cut for order in (own, upwards, upwards[::-1]) if (cut := sequencer.cut(order))]
        if not any(len(cut) <= room for cut in cuts) and detour is not None:
            cuts += [cut for cut in [sequencer.cut(detour)] if cut]
        if not cuts:
            raise Blocked(sequencer.obstruction)
        best = min(cuts, key=len)
        if len(best) > room:
            detail = f"takes {len(best)} stages, there is time for {room}: {sequencer.obstruction}"
            raise Blocked(f"a collision-free transition {detail}")
        direct = sum(map(len, best)) == len(upwards)
        deviation = deviation_in_stages(transition, best) if with_deviation and direct else None
        return Staged(rows(start, tuple(tuple(stage.tolist()) for stage in best)), deviation, strict=True)

    def _without_obstacles(
        self, before: Configuration, after: Configuration, available: float | None, with_deviation: bool
    ) -> Staged:
        m, inrush = self._m, self._pace.inrush
        n = m.switches(before, after)
        if n == 0:
            return Staged(m.actuator_states(after)[None], 0.0)
        if inrush is None and not with_deviation:
            return Staged(m.actuator_states(after)[None], None)
        if inrush is None or n <= 1:
            return at_once(m, before, after)
        fewest = self._pace.fewest(n)
        room = n if available is None else min(n, self._room(available))
        if room < fewest:
            raise Infeasible(f"{n} switches, at most {inrush} at once, need {self._pace.needed(n):.3g} s")
        if room == 1:
            return at_once(m, before, after)
        for limit in sorted({max(min(room, MOST_STAGES), fewest), room}):
            try:
                found = order_stages(m, before, after, inrush, limit)
            except ValueError:  # with so few stages, each order ends a stage in a module's unknown state
                continue
            return Staged(rows(m.actuator_states(before), found.actuators), found.deviation)
        raise Infeasible(f"{n} switches, at most {inrush} at once, need more than {room} stages")

    def _room(self, available: float) -> int:
        return int((available - self._pace.rest) / self._pace.lead + 1e-9)


def pace_of(settings: ArmSettings) -> Pace:
    return Pace(longest_travel(settings) + TICK, settings.inrush, settings.rest_time)


def at_once(manipulator: Manipulator, before: Configuration, after: Configuration) -> Staged:
    return Staged(manipulator.actuator_states(after)[None], lambda: deviation_at_once(manipulator, before, after))


def deviation_at_once(manipulator: Manipulator, before: Configuration, after: Configuration) -> float:
    transition = build_transition(manipulator, before, after)
    if not len(transition.actuators):
        return 0.0
    known = replace(transition, unknown=SKIPPED)
    return max(known.greatest(known.masks([]), np.arange(len(transition.actuators))), 0.0)


def deviation_in_stages(transition: Transition, stages: list[Index]) -> float:
    """Returns the deviation of a transition in stages, each of indices of the arm's actuators."""
    known = replace(transition, unknown=SKIPPED)
    places = [np.searchsorted(transition.actuators, stage) for stage in stages]
    return max(peaks(known, known.masks([]), places))


def rows(states: NDArray[np.uint8], stages: tuple[tuple[int, ...], ...]) -> NDArray[np.uint8]:
    """Returns the actuator states (k, A) after each stage, from states (A,); a stage lists actuators that switch."""
    result = np.tile(states, (len(stages), 1))
    for k, stage in enumerate(stages):
        result[k:, list(stage)] ^= 1
    return result


def numbered(states: NDArray[np.uint8], stages: NDArray[np.uint8]) -> list[NDArray[np.int64]]:
    """Returns the actuators that switch in each stage (k, A), from states (A,)."""
    return [np.flatnonzero(change) for change in np.diff(np.vstack([states, stages]).astype(int), axis=0)]
