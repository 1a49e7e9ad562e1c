"""Malformed goals are refused in the callback; a flood of refused requests is slowed down."""

import pytest

from controller.gateway.floods import BRIEFLY, MOST_AT_ONCE, PAUSE, PAUSE_EVERY, FloodBrake
from controller.motion.goal import MOST_BYTES

NAN = b'{"waypoints": [{"position": [NaN, 1]}]}'
GOOD = b'{"waypoints": [{"position": [0.1, 1]}]}'


class Time:
    def __init__(self) -> None:
        self.now, self.pauses = 100.0, list[float]()

    def brake(self) -> FloodBrake:
        return FloodBrake(lambda: self.now, self.pauses.append)


@pytest.mark.parametrize("payload", [b"{", b"\xff", NAN, b"[" * 100_000, b" " * (MOST_BYTES + 1), b'{"waypoints": 1}'])
def test_what_is_no_goal_is_refused_in_words(payload: bytes) -> None:
    answer = Time().brake().refusal(payload)
    assert answer is not None
    assert (answer["accepted"], answer["code"]) == (False, -1)
    assert answer["message"] != BRIEFLY


def test_a_flood_is_refused_briefly_and_slowed_down_and_good_goals_pass() -> None:
    time = Time()
    brake, answers = time.brake(), []
    for _ in range(MOST_AT_ONCE + 10 * PAUSE_EVERY):
        answers.append(brake.refusal(NAN))
        brake.slow_down()
    words = [answer["message"] for answer in answers if answer is not None]
    assert words.count(BRIEFLY) == 10 * PAUSE_EVERY
    assert time.pauses == [PAUSE] * 10
    assert brake.refusal(GOOD) is None
    time.now += 1.0
    again = brake.refusal(NAN)
    assert again is not None
    assert "nan is not a finite number" in again["message"]


def test_refusals_of_every_kind_count() -> None:
    time = Time()
    brake = time.brake()
    for _ in range(MOST_AT_ONCE):
        brake.slow_down()
    assert time.pauses == []
    answer = brake.refusal(NAN)
    assert answer is not None
    assert answer["message"] == BRIEFLY
