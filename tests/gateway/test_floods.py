"""A flood of refused requests is refused briefly and slowed down."""

from hyperbit.controller.gateway.arrivals import MOST_AT_ONCE, PAUSE, PAUSE_EVERY, Clocks, FloodBrake, Rate
from tests.gateway.conftest import ARM, Gateway
from tests.gateway.test_server import asked


class Time:
    def __init__(self) -> None:
        self.now, self.pauses = 100.0, list[float]()

    def brake(self) -> FloodBrake:
        return FloodBrake(lambda: self.now, self.pauses.append)


def test_a_flood_is_refused_briefly_and_slowed_down() -> None:
    time = Time()
    brake, explained = time.brake(), 0
    for _ in range(MOST_AT_ONCE + 10 * PAUSE_EVERY):
        explained += brake.explained.admits()
        brake.refused.add()
        brake.slow_down()
    assert explained == MOST_AT_ONCE
    assert time.pauses == [PAUSE] * 10
    time.now += 1.0
    assert brake.explained.admits()
    brake.slow_down()
    assert len(time.pauses) == 10


def test_requests_that_are_accepted_are_not_slowed_down() -> None:
    time = Time()
    brake = time.brake()
    for _ in range(MOST_AT_ONCE - 1):
        brake.refused.add()
    for _ in range(10 * PAUSE_EVERY):
        brake.slow_down()
    assert time.pauses == []


def test_a_rate_is_of_any_second() -> None:
    time = Time()
    rate, admitted = Rate(2, lambda: time.now), list[bool]()
    for _ in range(8):
        admitted.append(rate.admits())
        time.now += 0.3
    assert admitted == [True, True, False, False, True, True, False, False]


def test_in_a_flood_a_refusal_says_that_it_gives_no_reason(gateway: Gateway) -> None:
    gateway.server.close()
    gateway.server = gateway.serve(Clocks(monotonic=lambda: 100.0, pause=lambda seconds: None))
    session = gateway.other()
    reasons = [asked(session, f"hyperbit/{ARM}/goal", b"\xff")[0]["reason"] for _ in range(MOST_AT_ONCE + 1)]
    assert reasons == ["not-utf8"] * MOST_AT_ONCE + ["not-explained"]
    assert not gateway.planner.heard
