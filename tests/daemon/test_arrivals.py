"""Who came first: setpoints that wait to be read against requests."""

from typing import Any

import pytest

from controller.daemon.arrivals import Arrivals


class Ring(list[Any]):
    """The latest setpoint."""

    def receive(self) -> Any:
        return self.pop() if self else None


@pytest.fixture
def ring() -> Ring:
    return Ring()


@pytest.fixture
def arrivals(ring: Ring) -> Arrivals:
    return Arrivals(ring.receive)


def test_all_have_places_of_their_own_in_order(ring: Ring, arrivals: Arrivals) -> None:
    assert arrivals.request() == 1
    assert arrivals.setpoint() is None
    ring.append("a")
    assert arrivals.setpoint() == ("a", 2)
    assert arrivals.setpoint() is None
    assert arrivals.request() == 3


def test_a_setpoint_that_waits_came_before_the_request_that_comes(ring: Ring, arrivals: Arrivals) -> None:
    ring.append("a")
    assert arrivals.request() == 2
    assert arrivals.setpoint() == ("a", 1)


def test_the_latest_setpoint_wins_and_the_first_began_the_stream(ring: Ring, arrivals: Arrivals) -> None:
    ring.append("a")
    assert arrivals.request() == 2
    ring.append("b")
    assert arrivals.setpoint() == ("b", 1)
