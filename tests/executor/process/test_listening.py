"""The executor listens for another master before its first frame."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import can
import pytest

from hyperbit.controller.executor.process import buses
from hyperbit.controller.executor.process.buses import CanBuses
from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.wire.events import BusChanged
from hyperbit.drivers.canopen.wiring import BusWiring

CHANNEL = "test_listening"
BEAT = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)


@pytest.fixture
def other() -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        yield bus


@pytest.fixture
def listen(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[float], CanBuses]]:
    made = CanBuses([BusWiring("can0", "virtual", CHANNEL)])

    def run(seconds: float) -> CanBuses:
        monkeypatch.setattr(buses, "LISTEN", seconds)
        made.listen(0.0)
        return made

    yield run
    made.close()


def test_a_second_master_on_a_bus_is_refused(listen, other):
    over = threading.Event()

    def beat() -> None:
        while not over.wait(0.05):
            other.send(BEAT)

    thread = threading.Thread(target=beat)
    thread.start()
    try:
        with pytest.raises(BusError, match="can0: another executor is on this bus"):
            listen(60.0)
    finally:
        over.set()
        thread.join()
    assert other.recv(0) is None, "it has sent nothing"


def test_heartbeats_that_the_kernel_kept_of_a_dead_executor_come_at_once_and_do_not_count(listen, other, monkeypatch):
    monkeypatch.setattr(buses, "APART", 60.0)
    for _ in range(5):
        other.send(BEAT)
    assert isinstance(listen(0.05).poll(0.0)[0], BusChanged)
    assert other.recv(0) is None


def test_a_board_with_the_node_id_127_is_no_master(listen, other, monkeypatch):
    monkeypatch.setattr(buses, "APART", -1.0)
    other.send(can.Message(arbitration_id=0x77F, data=b"\x7f", is_extended_id=False))
    listen(0.05)
