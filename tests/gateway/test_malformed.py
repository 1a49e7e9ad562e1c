"""Malformed goals are refused in the callback; a flood of them is refused briefly, and slowed down."""

import pytest

from controller.gateway.malformed import BRIEFLY, MOST_EXPLAINED, PAUSE, PAUSE_EVERY, MalformedGoals
from controller.motion.goal import MOST_BYTES

NAN = b'{"waypoints": [{"position": [NaN, 1]}]}'
GOOD = b'{"waypoints": [{"position": [0.1, 1]}]}'


class Time:
    def __init__(self) -> None:
        self.now, self.pauses = 100.0, list[float]()

    def refusals(self) -> MalformedGoals:
        return MalformedGoals(lambda: self.now, self.pauses.append)


@pytest.mark.parametrize("payload", [b"{", b"\xff", NAN, b"[" * 100_000, b" " * (MOST_BYTES + 1), b'{"waypoints": 1}'])
def test_what_is_no_goal_is_refused_in_words(payload: bytes) -> None:
    answer = Time().refusals().refusal(payload)
    assert answer is not None
    assert (answer["accepted"], answer["code"]) == (False, -1)
    assert answer["message"] != BRIEFLY


def test_a_flood_is_refused_briefly_and_slowed_down_and_good_goals_pass() -> None:
    time = Time()
    refusals = time.refusals()
    answers = [refusals.refusal(NAN) for _ in range(MOST_EXPLAINED + 10 * PAUSE_EVERY)]
    words = [answer["message"] for answer in answers if answer is not None]
    assert words.count(BRIEFLY) == 10 * PAUSE_EVERY
    assert time.pauses == [PAUSE] * 10
    assert refusals.refusal(GOOD) is None
    assert refusals.refused == len(answers)
    time.now += 1.0
    again = refusals.refusal(NAN)
    assert again is not None
    assert "nan is not a finite number" in again["message"]
