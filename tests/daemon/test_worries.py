"""What stops no arm and is told all the same."""

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from controller.daemon.ledger import Ledger
from controller.daemon.worries import REMEMBERED, Worries
from drivers.faults import Fault


class World:
    """Boards, clocks and a network that the test sets."""

    def __init__(self) -> None:
        self.now, self.offset, self.reachable = 100.0, 1.7e9, True
        self.buses: tuple[Fault, ...] = ()

    def passive(self) -> tuple[Fault, ...]:
        return self.buses


@pytest.fixture
def world() -> World:
    return World()


@pytest.fixture
def worries(world: World, tmp_path: Path) -> Iterator[Worries]:
    ledger = Ledger(tmp_path / "ledger.sqlite", ["a"])
    yield Worries(
        world,  # type: ignore[arg-type]
        ledger,
        lambda: world.reachable,
        lambda: world.offset + world.now,
        lambda: world.now,
    )
    ledger.close()


def codes(worries: Worries) -> list[str]:
    return [fault.code for fault in worries.look()]


def test_nothing_is_wrong_at_first_nor_by_a_clock_that_is_slewed(world: World, worries: Worries) -> None:
    for _ in range(1000):
        world.now, world.offset = world.now + 0.05, world.offset + 0.01
        assert codes(worries) == []


@pytest.mark.parametrize("by", [3600.0, -3600.0, 0.6])
def test_a_clock_that_is_set_is_told_for_a_while_and_once_in_the_journal(
    world: World, worries: Worries, by: float, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        world.offset += by
        (fault,) = worries.look()
        assert f"{by:+.1f} s" in fault.message
        for _ in range(5):
            world.now += REMEMBERED / 5.1
            assert codes(worries) == ["clock-set"]
        world.now += REMEMBERED
        assert codes(worries) == []
    assert caplog.text.count("clock-set") == 1


def test_a_clock_that_is_set_twice_is_told_twice(
    world: World, worries: Worries, caplog: pytest.LogCaptureFixture
) -> None:
    for by in (3600.0, -3600.0):
        world.offset += by
        assert codes(worries) == ["clock-set"]
    assert caplog.text.count("clock-set") == 2


def test_a_network_that_was_lost_is_told_when_it_is_back_with_its_time(
    world: World, worries: Worries, caplog: pytest.LogCaptureFixture
) -> None:
    world.reachable = False
    for _ in range(20):
        assert codes(worries) == ["network-lost"]
        world.now += 1.0
    worries.look()
    world.reachable = True
    world.now += 0.1
    (fault,) = worries.look()
    assert "20.0 s" in fault.message
    world.now += REMEMBERED
    assert codes(worries) == []
    assert caplog.text.count("network-lost") == 1


def test_a_passive_bus_is_told_as_long_as_it_is(
    world: World, worries: Worries, caplog: pytest.LogCaptureFixture
) -> None:
    world.buses = (Fault("bus-passive", "can0", "can0 is error-passive"),)
    assert codes(worries) == codes(worries) == ["bus-passive"]
    world.buses = ()
    assert codes(worries) == []
    assert caplog.text.count("bus-passive") == 1
