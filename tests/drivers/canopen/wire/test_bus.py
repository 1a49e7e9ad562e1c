"""CanBus over interfaces that work and fail like those of SocketCAN."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest

from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.wire.bus import CanBus
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, BusOverrun, Event, FrameEchoed, FrameIgnored, FrameReceived
from hyperbit.drivers.canopen.wiring import BusWiring
from tests import emulated
from tests.clock import Clock

FRAME = Frame(0x77F, b"\x05")


def wait(bus: CanBus, condition: Callable[[list[Event]], object]) -> list[Event]:
    events: list[Event] = []
    for _ in range(20_000):
        events += [e._replace(at=None) if isinstance(e, FrameEchoed | FrameReceived) else e for e in bus.poll()]
        if condition(events):
            return events
        time.sleep(0.001)
    raise AssertionError(f"waited in vain, after {events}")


@pytest.fixture(params=["virtual", "emulated"])
def buses(request, tmp_path: Path) -> Iterator[tuple[CanBus, can.BusABC]]:
    interface = emulated.Interface(tmp_path) if request.param == "emulated" else None
    channel = interface.channel if interface else f"test_bus {request.node.name}"
    other = can.Bus(interface=request.param, channel=channel, ignore_config=True)
    bus = CanBus(BusWiring("can0", request.param, channel))
    bus.open()
    yield bus, other
    bus.close()
    other.shutdown()
    if interface:
        interface.close()


def test_frames_come_in_go_out_and_come_back(buses):
    bus, other = buses
    assert bus.poll() == [BusChanged("can0", "active", "", None)]
    assert (bus.fileno() is None) == (bus.wiring.interface == "virtual")
    assert bus.send_frame(FRAME) is None
    assert wait(bus, len) == [FrameEchoed("can0", FRAME)]
    message = other.recv(20)
    assert (message.arbitration_id, bytes(message.data), message.is_extended_id) == (0x77F, b"\x05", False)
    other.send(can.Message(arbitration_id=0x705, data=b"\x7f", is_extended_id=False))
    other.send(can.Message(arbitration_id=0x705, data=b"\x7f", is_extended_id=True))
    other.send(can.Message(arbitration_id=0x705, is_extended_id=False, is_remote_frame=True, dlc=1))
    assert wait(bus, lambda events: len(events) == 3) == [
        FrameReceived("can0", Frame(0x705, b"\x7f")),
        FrameIgnored("can0", 90),
        FrameIgnored("can0", 55),
    ]


def test_frames_tell_when_they_were_on_the_bus(buses):
    bus, other = buses
    bus.poll()
    times = [time.monotonic()]
    for send in (
        lambda: bus.send_frame(FRAME),
        lambda: other.send(can.Message(arbitration_id=0x185, is_extended_id=False)),
    ):
        send()
        while not (events := bus.poll()):
            time.sleep(0.001)
        times += [events[0].at, time.monotonic()]
    assert [round(t, 2) for t in times] == sorted(round(t, 2) for t in times)


def test_a_clock_of_its_own_tells_no_time(buses):
    bus, _ = buses
    assert bus._read(can.Message(timestamp=12.5, arbitration_id=0x185, is_extended_id=False))[0].at is None


def test_error_frames_change_the_state(buses):
    bus, other = buses
    bus.poll()
    for kind, data in ((0x204, "00 20 00 00 00 00 82 07"), (0x40, "00"), (0x04, "00 01 00 00 00 00 02 03")):
        other.send(
            can.Message(arbitration_id=kind, data=bytes.fromhex(data), is_error_frame=True, is_extended_id=False)
        )
    assert wait(bus, lambda events: len(events) == 4) == [
        BusChanged("can0", "passive", "", (130, 7)),
        BusChanged("can0", "bus-off", "", None),
        BusChanged("can0", None, "", (2, 3)),
        BusOverrun("can0"),
    ]


def test_a_poll_returns_no_more_than_256_frames(buses):
    bus, other = buses
    bus.poll()
    for k in range(300):
        other.send(can.Message(arbitration_id=k, is_extended_id=False))
    time.sleep(0.2)
    assert len(bus.poll()) <= 256
    wait(bus, lambda events: events and events[-1] == FrameReceived("can0", Frame(299, b"")))


def test_a_full_queue_is_told_and_keeps_the_bus_open(tmp_path):
    interface = emulated.Interface(tmp_path)
    bus = CanBus(BusWiring("can0", "emulated", interface.channel))
    bus.open()
    interface.hold()
    why = None
    for _ in range(1000):
        why = why or bus.send_frame(FRAME)
        time.sleep(0.001)
    assert "No buffer space" in why
    interface.release()
    assert all(event == FrameEchoed("can0", FRAME) for event in wait(bus, lambda events: len(events) > 10)[1:])
    bus.close()
    interface.close()


@pytest.mark.parametrize("how", ["down", "deleted"])
def test_a_bus_that_goes_down_is_opened_again(tmp_path, how):
    interface, clock = emulated.Interface(tmp_path), Clock(0.0)
    bus = CanBus(BusWiring("can0", "emulated", interface.channel), clock)
    bus.open()
    bus.poll()
    interface.down() if how == "down" else interface.delete()
    [event] = wait(bus, len)
    assert (event.state, "failed" in event.why) == ("down", True)
    assert bus.send_frame(FRAME) is not None
    assert bus.poll() == []  # it waits between attempts
    for pause in (0.1, 0.2, 0.4, 0.8, 1.0, 1.0):
        clock.now += pause + 1e-6
        assert [event.state for event in bus.poll()] == ["down"]
    interface.up() if how == "down" else interface.make()
    clock.now += 1.1
    assert [event.state for event in wait(bus, len)] == ["active"]
    assert bus.send_frame(FRAME) is None
    wait(bus, lambda events: FrameEchoed("can0", FRAME) in events)
    bus.close()
    interface.close()


def test_sending_on_a_bus_that_is_down_shows_it(tmp_path):
    interface = emulated.Interface(tmp_path)
    bus = CanBus(BusWiring("can0", "emulated", interface.channel))
    bus.open()
    bus.poll()
    interface.down()
    assert "Network is down" in bus.send_frame(FRAME)
    assert [event.state for event in bus.poll()] == ["down"]
    bus.close()
    interface.close()


@pytest.mark.parametrize("interface", ["nonsense", "socketcan"])
def test_a_bus_that_cannot_be_opened_is_named(interface):
    bus = CanBus(BusWiring("can7", interface, "nowhere0"))
    with pytest.raises(BusError, match=rf"can7.*nowhere0.*{interface}"):
        bus.open()
    assert bus.send_frame(FRAME) == "the bus is closed"
    assert bus.poll() == []
    assert bus.fileno() is None


def test_a_closed_bus_says_so():
    bus = CanBus(BusWiring("can0", "virtual", "test_bus closed"))
    bus.open()
    bus.close()
    assert [event.state for event in bus.poll()] == ["closed"]
    assert bus.send_frame(FRAME) is not None


def test_an_interface_that_is_gone_is_told_by_events_alone(caplog):
    bus = CanBus(BusWiring("can0", "socketcan", "none9"))
    bus._closed = False
    with caplog.at_level("DEBUG"):
        assert [event.state for event in bus.poll()] == ["down"]
    assert [record for record in caplog.records if record.name.startswith("can")] == []
