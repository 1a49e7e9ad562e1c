"""The age of commands, by the heartbeats that they name."""

from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.panel.arms.heartbeats import KEPT, LONGEST, Heartbeats
from tests.clock import Clock


@given(
    pauses=st.lists(st.floats(0.0, 3.0), min_size=1, max_size=30), waited=st.floats(0.0, 5.0), which=st.integers(0, 29)
)
def test_a_command_is_refused_if_its_heartbeat_is_older_than_allowed(
    pauses: list[float], waited: float, which: int
) -> None:
    clock = Clock()
    heartbeats, sent = Heartbeats(clock), list[tuple[int, float]]()
    for pause in pauses:
        clock.now += pause
        sent.append((heartbeats.next(), clock.now))
    clock.now += waited
    number, at = sent[which % len(sent)]
    assert (heartbeats.refusal(number) is None) == (clock.now - at <= LONGEST)


def test_the_refusal_tells_what_happened_and_what_to_do() -> None:
    clock = Clock()
    heartbeats = Heartbeats(clock)
    number = heartbeats.next()
    clock.now += 3.25
    told = heartbeats.refusal(number) or ""
    assert "3.2 s old, and may be 2 s old" in told
    assert "Nothing was sent to the arm: look at the arm, then press again" in told
    assert "reload the page" in (heartbeats.refusal(None) or "")


def test_numbers_of_other_pages_and_numbers_to_come_are_unknown() -> None:
    one, other = Heartbeats(), Heartbeats()
    number = one.next()
    assert one.refusal(number) is None
    for page, named in ((other, number), (one, number + 1), (one, 0)):
        assert "of unknown age" in (page.refusal(named) or "")


def test_old_heartbeats_take_no_memory() -> None:
    heartbeats = Heartbeats(Clock())
    numbers = [heartbeats.next() for _ in range(KEPT + 1)]
    assert heartbeats.refusal(numbers[0]) is not None
    assert [heartbeats.refusal(number) for number in numbers[1:]] == [None] * KEPT
