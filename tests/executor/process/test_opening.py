"""Interfaces that cannot be opened: each new reason is told once."""

from __future__ import annotations

import logging

import pytest

from hyperbit.controller.executor.process.buses import OPEN_EVERY, CanBuses
from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.wire.bus import CanBus, InterfaceInUse
from hyperbit.drivers.canopen.wiring import BusWiring


class Opening:
    """What opening an interface ends with."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.error: BusError = BusError("can0: no such interface")
        self.buses = CanBuses([BusWiring("can0", "virtual", "none")])
        self._now = 1.0
        monkeypatch.setattr(CanBus, "open", lambda _: self._open())

    def _open(self) -> None:
        raise self.error

    def wait(self) -> None:
        self._now += OPEN_EVERY
        self.buses.poll(self._now)


@pytest.fixture
def opening(monkeypatch: pytest.MonkeyPatch) -> Opening:
    return Opening(monkeypatch)


def test_a_reason_is_told_when_it_is_new(opening: Opening, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR):
        for _ in range(3):
            opening.wait()
        opening.error = InterfaceInUse("process 7 of hyperbit uses can0: stop it first")
        for _ in range(3):
            opening.wait()
    assert [record.getMessage() for record in caplog.records] == [
        "can0: no such interface; tried again every 1 s",
        "process 7 of hyperbit uses can0: stop it first; tried again every 1 s",
    ]


def test_an_interface_that_is_in_use_ends_the_start(opening: Opening) -> None:
    opening.error = InterfaceInUse("process 7 of hyperbit uses can0: stop it first")
    with pytest.raises(InterfaceInUse):
        opening.wait()
