"""What was sent is known again whenever it comes back."""

import threading
import time
from contextlib import suppress
from pathlib import Path

import can

from drivers import outstanding
from drivers.bus import CanBus
from drivers.faults import BusBusy, Fault
from drivers.outstanding import Outstanding
from drivers.wiring import BusSettings
from tests import emulated
from tests.daemon.waiting import eventually

HEARTBEAT = can.Message(arbitration_id=0x77F, data=[5], is_extended_id=False, is_rx=False)


def test_the_first_frame_is_ours_however_late_it_comes_back(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(outstanding.time, "monotonic", lambda: now[0])
    sent = Outstanding(longest=1.0)
    for _ in range(3):
        with sent.sending(HEARTBEAT):
            now[0] += 0.7
    assert [sent.came_back(HEARTBEAT) for _ in range(4)] == [True, True, True, False]


def test_a_bus_that_may_be_stuck_for_long_is_found_stuck(tmp_path: Path) -> None:
    """Where boards wait long for the master, the bus is given so much time, too."""
    interface, faults, left = emulated.Interface(tmp_path), list[Fault](), threading.Event()
    settings = BusSettings("can0", "emulated", interface.channel)
    bus = CanBus(settings, lambda message: False, faults.append, left.set, stuck_after=1.2)
    bus.open()
    bus.rearm()
    bus.send(HEARTBEAT)
    assert left.wait(30)
    interface.hold()
    begun = time.monotonic()

    def told() -> bool:
        with suppress(BusBusy):
            bus.send(HEARTBEAT)
        bus.tick(time.monotonic())
        interface._queue.clear()  # or the queue would be full before
        interface._state[1] = 0
        return bool(faults)

    eventually(told)
    assert faults[0].code == "bus-busy"
    assert time.monotonic() - begun > 1.2
    bus.close()
    interface.close()
