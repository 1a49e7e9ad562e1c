"""Programs that are sent in parts, and improved meanwhile."""

from itertools import pairwise

import numpy as np
import pytest

from controller.motion.pacing import Pace, Staged
from controller.motion.plan import Plan
from controller.motion.program import pack_states, unpack_states
from controller.motion.trajectory import through
from controller.planning import program_feed
from controller.planning.program_feed import ProgramFeed
from controller.program import Replacement
from controller.search.solution import Solution
from tests.arms import paper_arm

ARM = paper_arm(2)
HOME, A, B, C, D = (0, 0), (1, 2), (3, 4), (7, 0), (5, 5)
PACE = Pace(0.06)


def row(configuration: tuple[int, int]) -> np.ndarray:
    return ARM.actuator_states(np.array(configuration))


def packed(*configurations: tuple[int, int]) -> list[bytes]:
    return pack_states(np.array([row(c) for c in configurations]))


def planned(*configurations: tuple[int, int], step: float = 1.0) -> Plan:
    chosen = [np.array(c, dtype=np.int64) for c in configurations]
    tips = [ARM.tip(c) for c in chosen]
    positions = np.array([tip[:2, 3] for tip in tips])
    solutions = tuple(Solution(c, tip, 0.0, 1, True, 0.0, 1.0) for c, tip in zip(chosen, tips, strict=True))
    transitions = tuple(Staged(row(c)[None], k / 10) for k, c in enumerate(configurations))  # type: ignore[arg-type]
    return Plan(through(step * np.arange(len(chosen)), positions, 0.01), solutions, transitions)


def better(plan: Plan, first: int, *configurations: tuple[int, int]) -> Plan:
    """The plan with other configurations from a point on; earlier transitions stay the same objects."""
    other = planned(*[(0, 0)] * first, *configurations)
    transitions = (*plan.transitions[:first], *other.transitions[first:], *plan.transitions[len(other.transitions) :])
    return Plan(plan.trajectory, plan.solutions, transitions)


def feed_of(plan: Plan, strict: bool = False, pace: Pace = PACE) -> ProgramFeed:
    return ProgramFeed(ARM, plan, pace, 0.0, pack_states, 7, strict)


def ends(message: Replacement | None) -> list[bytes]:
    assert message is not None
    return [stage.states for stage in message.stages]


def test_a_short_program_goes_as_a_whole() -> None:
    feed = feed_of(planned(A, B, C))
    assert [stage.states for stage in feed.stages] == packed(A, B, C)
    assert [stage.at for stage in feed.stages] == pytest.approx([-0.06, 0.94, 1.94])
    assert (feed.final, feed.message()) == (True, None)


def test_a_long_program_goes_in_parts_ahead_of_what_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program_feed, "PART", 2)
    feed = feed_of(planned(A, B, C, D, A))
    assert (len(feed.stages), feed.final, feed.message()) == (2, False, None)
    feed.begin(0)
    message = feed.message()
    assert ends(message) == packed(C, D)
    assert message is not None
    assert (message.first, message.start, message.final, message.program) == (2, packed(B)[0], False, 7)
    assert feed.message() is None, "one at a time"
    feed.answered(message.generation, True)
    assert feed.message() is None, "that is ahead enough"
    assert feed.begin(1) == 1
    assert feed.message() is None
    assert feed.begin(2) == 2
    last = feed.message()
    assert ends(last) == packed(A)
    assert last is not None
    assert (last.first, last.final) == (4, True)
    assert [stage.states for stage in feed.remaining()] == packed(D, A)


def test_a_better_plan_replaces_what_differs_and_has_not_begun() -> None:
    plan = planned(A, B, C, D)
    feed = feed_of(plan)
    feed.begin(0)
    feed.improve(better(plan, 2, B, D))
    message = feed.message()
    assert message is not None
    assert (message.first, message.start, ends(message)) == (2, packed(B)[0], packed(B, D))
    feed.answered(message.generation, True)
    assert [stage.states for stage in feed.stages] == packed(A, B, B, D)
    assert feed.deviation(3) == pytest.approx(0.3)
    assert feed.message() is None


def test_a_better_plan_that_comes_late_is_joined_where_the_arm_is() -> None:
    plan = planned(A, B, C, D)
    feed = feed_of(plan, pace=Pace(0.06, inrush=2))
    feed.begin(1)
    feed.improve(better(plan, 1, D, A, HOME))
    message = feed.message()
    assert message is not None
    assert (message.first, message.start) == (2, packed(B)[0])
    rows = [row(B), *(unpack_states(stage.states, 6) for stage in message.stages)]
    assert max(int((a != b).sum()) for a, b in pairwise(rows)) <= 2
    assert ends(message)[-1] == packed(HOME)[0]
    assert [stage.mark for stage in message.stages if stage.mark >= 0] == [2, 3]
    at = [stage.at for stage in message.stages]
    assert at == sorted(at)
    assert at[0] >= 0.94


def test_a_strict_program_takes_no_better_plan_that_comes_late() -> None:
    plan = planned(A, B, C, D)
    feed = feed_of(plan, strict=True)
    feed.begin(1)
    feed.improve(better(plan, 1, D, A, HOME))
    assert feed.message() is None


def test_a_refused_replacement_is_tried_again_after_the_next_stage() -> None:
    plan = planned(A, B, C, D)
    feed = feed_of(plan)
    feed.improve(better(plan, 1, D, A, HOME))
    message = feed.message()
    assert message is not None
    feed.answered(message.generation, False)
    assert feed.message() is None
    feed.begin(1)
    again = feed.message()
    assert again is not None
    assert (again.first, again.generation > message.generation, again.start) == (2, True, packed(B)[0])


def test_a_running_program_becomes_strict() -> None:
    feed = feed_of(planned(A, B))
    feed.make_strict()
    message = feed.message()
    assert message is not None
    assert (message.strict, message.stages, message.first, message.final) == (True, (), 2, True)
    feed.answered(message.generation, True)
    assert feed.message() is None


def test_as_many_stages_go_into_a_message_as_it_holds() -> None:
    assert program_feed.most_stages(48) == 1_000
    assert program_feed.most_stages(10_000) * 1_250 < 65_536 - 8_192
