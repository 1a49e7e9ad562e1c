"""Never more actuators at once than may be, whatever happens; and all stages in time when nothing does."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.daemon.events import Cancel, Improved, Planned, Reset, Stop
from controller.daemon.loop import PERIOD
from controller.motion.pacing import Pace
from drivers.faults import Fault
from tests.daemon.rig import ARM, TRAVEL, Rig, leaving_late, planned

LEAD = TRAVEL + PERIOD
configurations = st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), min_size=1, max_size=4)


def staged(rig: Rig, pace: Pace, *points: tuple[int, int], start: object = None, **fields: object) -> Planned:
    """A goal through configurations, in the stages that its times and the pace allow."""
    goal = rig.goal(f"goal {len(rig.replies)}-{rig.arrival()}", *points, **fields)
    before, times, transitions = start, goal.plan.trajectory.times, []
    before = rig.loop.commanded if before is None else before
    for k, solution in enumerate(goal.plan.solutions):
        available = float(times[k] - times[k - 1]) if k else None
        transitions.append(pace.staged(ARM, before, solution.configuration, available))
        before = solution.configuration
    return replace(goal, plan=replace(goal.plan, transitions=tuple(transitions)))


def check(rig: Rig, began: np.ndarray, times: list[float], inrush: int, rest: float) -> None:
    """Bounds of all that was committed so far."""
    every = np.vstack([began, *rig.boards.commits]).astype(int)
    switched = np.abs(np.diff(every, axis=0))
    assert switched.sum(axis=1).max(initial=0) <= inrush
    moments = np.array(times)[switched.any(axis=1)]
    assert np.diff(moments).min(initial=np.inf) >= TRAVEL - 1e-9, "a stage began before the last one's end"
    if rest:
        for own in switched.T:
            assert np.diff(np.array(times)[own > 0]).min(initial=np.inf) >= TRAVEL + rest - 1e-9
    assert rig.ledger.counts.tolist() == switched.sum(axis=0).tolist(), "every switch is counted, once"


acts = st.one_of(
    st.tuples(st.just("goal"), configurations),
    st.tuples(st.just("stale goal"), configurations),
    st.tuples(st.just("better"), st.tuples(st.integers(0, 7), st.integers(0, 7))),
    st.tuples(st.sampled_from(["cancel", "stop", "reset", "fault", "busy"]), st.none()),
    st.tuples(st.just("go"), st.integers(1, 30)),
    st.tuples(st.just("late"), st.floats(0.01, 0.5)),
)


@given(st.lists(acts, max_size=30), st.integers(1, 4), st.sampled_from([0.0, 0.13]))
def test_never_more_at_once_whatever_happens(sequence: list[tuple[str, object]], inrush: int, rest: float) -> None:
    rig, pace, times = Rig(inrush, rest), Pace(LEAD, inrush, rest), list[float]()
    rig.go()
    began, running = rig.boards.states.copy(), None
    commit = rig.boards.commit

    def noted(states: np.ndarray, now: float) -> None:
        commit(states, now)
        times.append(now)

    rig.boards.commit = noted  # type: ignore[method-assign]
    for act, argument in [*sequence, ("steady", None), ("goal", [(5, 2), (2, 5)]), ("go", 250)]:
        match act:
            case "steady":
                rig.boards.busy = False
                rig.go(1)
                rig.request(Reset)
                rig.go(3 * PERIOD)
            case "goal" | "stale goal" if rig.loop.commanded is not None:
                start = np.array([3, 4]) if act == "stale goal" else None  # it was planned before the arm went on
                running = staged(rig, pace, *argument, start=start, step=6 * LEAD + rest)  # type: ignore[misc]
                rig.loop.inbox.hand_over(running)
            case "better" if running is not None:
                others = planned(*[argument] * len(running.plan.solutions))
                rig.loop.inbox.put(Improved(running.arrival, replace(running.plan, transitions=others.transitions)))
            case "cancel" | "stop" | "reset":
                rig.request({"cancel": Cancel, "stop": Stop, "reset": Reset}[act])
            case "fault":
                rig.boards.fail(Fault("board-lost", "can0/1", "lost"))
            case "busy":
                rig.boards.busy = not rig.boards.busy
            case "late":
                rig.now += argument  # type: ignore[operator]
            case "go":
                rig.go(argument * PERIOD)  # type: ignore[operator]
        if rig.loop.commanded is not None:
            assert rig.loop.commanded.tolist() == ARM.configuration(rig.loop._runner.switching.states).tolist()
    if not {"reset", "stop", "fault"} & {act for act, _ in sequence}:  # after those, what counts is measured
        check(rig, began, times, inrush, rest)
    assert all(
        np.count_nonzero(np.not_equal(a, b)) <= inrush for a, b in pairwise([began.tolist(), *rig.boards.commits])
    )
    assert rig.results[-1][1] == "succeeded"
    assert rig.boards.commits[-1] == ARM.actuator_states((2, 5)).tolist()


@given(configurations, st.integers(1, 6), st.integers(6, 12))
def test_undisturbed_every_waypoint_is_settled_at_its_time(
    points: list[tuple[int, int]], inrush: int, steps: int
) -> None:
    rig = Rig(inrush)
    rig.go()
    goal = staged(rig, Pace(LEAD, inrush), *points, step=steps * LEAD)
    rig.loop.inbox.hand_over(goal)
    rig.go()
    start, finals = rig.loop._runner.execution.start, {}
    while rig.loop.mode == "executing":
        rig.go()
        for key, payload in rig.published:
            if key == "feedback":
                finals.setdefault(payload["waypoint"], (rig.now, rig.boards.states.tolist(), payload))
    assert list(finals) == list(range(len(points)))
    for k, (now, states, payload) in finals.items():
        at = start + float(goal.plan.trajectory.times[k])
        assert at - 1e-9 <= now <= at + 2 * PERIOD
        assert states == ARM.actuator_states(points[k]).tolist()
        transition = goal.plan.transitions[k]
        assert payload["excursion"] == transition.excursion
        assert payload["stages"] in (0, len(transition.stages))


def test_a_stamped_transition_ends_in_time_and_begins_as_early_as_its_stages_need(rig: Rig) -> None:
    rig = Rig(inrush=2)
    rig.go()
    rig.loop.inbox.hand_over(staged(rig, Pace(LEAD, 2), (0, 0), (7, 7), step=10 * LEAD))
    rig.go()
    start, moments = rig.loop._runner.execution.start, []
    while rig.loop.mode == "executing":
        count = len(rig.boards.commits)
        rig.go()
        moments += [rig.now] * (len(rig.boards.commits) - count)
    due = start + 10 * LEAD
    stages = len(moments) - 1  # the first waypoint switches nothing
    assert 3 <= stages <= 6
    assert moments[1:] == pytest.approx([due - LEAD * (stages - k) for k in range(stages)], abs=PERIOD)


def test_a_goal_that_replaces_one_between_stages_begins_where_the_arm_is() -> None:
    rig = Rig(inrush=1)
    rig.go()
    pace = Pace(LEAD, 1)
    late = staged(rig, pace, (0, 7))  # planned before the arm moved
    rig.loop.inbox.hand_over(staged(rig, pace, (7, 7)))
    rig.go(3 * LEAD)
    assert 0 < len(rig.boards.commits) < 6
    held = rig.loop.commanded.tolist()
    assert ARM.actuator_states(held).tolist() == rig.boards.commits[-1]
    rig.loop.inbox.hand_over(late)
    rig.go(1)
    assert [status for _, status in rig.results] == ["replaced", "succeeded"]
    switches = ARM.switches((0, 0), held) + ARM.switches(held, (0, 7))
    assert rig.ledger.counts.sum() == switches, "nothing switched to and fro"


@pytest.mark.parametrize("kind", [Cancel, Stop])
def test_between_stages_the_arm_holds_what_was_committed(kind: type[Cancel | Stop]) -> None:
    rig = Rig(inrush=1)
    rig.go()
    rig.loop.inbox.hand_over(staged(rig, Pace(LEAD, 1), (7, 7)))
    rig.go(3 * LEAD)
    rig.request(kind)
    rig.go(1)
    assert 0 < len(rig.boards.commits) < 6
    assert ARM.actuator_states(rig.loop.commanded).tolist() == rig.boards.commits[-1]


def test_a_stage_whose_sync_leaves_late_is_told_as_one_of_its_own() -> None:
    rig = Rig(inrush=1)
    rig.go()
    leaving_late(rig, 1.5 * LEAD)  # the next stage is due by then
    rig.loop.inbox.hand_over(staged(rig, Pace(LEAD, 1), (3, 4), step=1.0))
    rig.go(2.0)
    assert rig.results[-1][1] == "succeeded"
    (told,) = [payload for key, payload in rig.published if key == "feedback"]
    assert told["stages"] == told["switches"] == 3
