"""CanBus over interfaces that work and fail like those of SocketCAN; error frames by linux/can/error.h; locks."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest

from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.wire.bus import CanBus, InterfaceInUse, lock_interface, read_error
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, BusOverrun, Event, FrameEchoed, FrameIgnored, FrameReceived
from hyperbit.drivers.canopen.wiring import BusWiring
from tests import emulated
from tests.clock import Clock
from tests.waiting import eventually

ROOT = Path(__file__).parents[4]
FRAME = Frame(0x77F, b"\x05")


def wait(bus: CanBus, condition: Callable[[list[Event]], object]) -> list[Event]:
    events: list[Event] = []

    def come() -> bool:
        events.extend(e._replace(at=None) if isinstance(e, FrameEchoed | FrameReceived) else e for e in bus.poll())
        return bool(condition(events))

    eventually(come, told=lambda: f"after {events}")
    return events


def message(cob_id: int, data: bytes = b"", **kind: bool) -> can.Message:
    return can.Message(arbitration_id=cob_id, data=data, **{"is_extended_id": False, **kind})


@pytest.fixture
def interface(tmp_path: Path) -> Iterator[emulated.Interface]:
    interface = emulated.Interface(tmp_path)
    yield interface
    interface.close()


@pytest.fixture
def clock() -> Clock:
    return Clock(0.0)


@pytest.fixture
def opened(interface: emulated.Interface, clock: Clock) -> Iterator[CanBus]:
    """An open bus on an emulated interface; the clock is that of its attempts to open it again."""
    bus = CanBus(BusWiring("can0", "emulated", interface.channel), clock)
    bus.open()
    assert bus.poll() == [BusChanged("can0", "active", "", None)]
    yield bus
    bus.close()


@pytest.fixture(params=["virtual", "emulated"])
def pair(request: pytest.FixtureRequest, interface: emulated.Interface) -> Iterator[tuple[CanBus, can.BusABC]]:
    """An open bus, and another node on it."""
    channel = interface.channel if request.param == "emulated" else f"test_bus {request.node.name}"
    bus = CanBus(BusWiring("can0", request.param, channel))
    with can.Bus(interface=request.param, channel=channel, ignore_config=True) as other:
        bus.open()
        bus.poll()
        yield bus, other
        bus.close()


def test_frames_come_in_go_out_and_come_back(pair: tuple[CanBus, can.BusABC]) -> None:
    bus, other = pair
    assert (bus.fileno() is None) == (bus.wiring.interface == "virtual")
    assert bus.send_frame(FRAME) is None
    assert wait(bus, len) == [FrameEchoed("can0", FRAME)]
    heard = other.recv(20)
    assert heard is not None
    assert (heard.arbitration_id, bytes(heard.data), heard.is_extended_id) == (0x77F, b"\x05", False)
    other.send(message(0x705, b"\x7f"))
    other.send(message(0x705, b"\x7f", is_extended_id=True))
    other.send(can.Message(arbitration_id=0x705, is_extended_id=False, is_remote_frame=True, dlc=1))
    assert wait(bus, lambda events: len(events) == 3) == [
        FrameReceived("can0", Frame(0x705, b"\x7f")),
        FrameIgnored("can0", 90),
        FrameIgnored("can0", 55),
    ]


def test_frames_tell_when_they_were_on_the_bus(pair: tuple[CanBus, can.BusABC]) -> None:
    bus, other = pair
    times = [time.monotonic()]
    for send in (lambda: bus.send_frame(FRAME), lambda: other.send(message(0x185))):
        send()
        events = eventually(bus.poll)
        times += [events[0].at, time.monotonic()]
    assert [round(t, 2) for t in times] == sorted(round(t, 2) for t in times)


def test_a_poll_returns_no_more_than_256_frames(pair: tuple[CanBus, can.BusABC]) -> None:
    bus, other = pair
    for k in range(300):
        other.send(message(k))
    sizes: list[int] = []
    heard: list[Event] = []

    def last() -> bool:
        events = bus.poll()
        heard.extend(events)
        sizes.append(len(events))
        return bool(heard) and heard[-1]._replace(at=None) == FrameReceived("can0", Frame(299, b""))

    eventually(last)
    assert (max(sizes) <= 256, sum(sizes)) == (True, 300)


def test_error_frames_change_the_state(pair: tuple[CanBus, can.BusABC]) -> None:
    bus, other = pair
    for kind, data in ((0x204, "00 20 00 00 00 00 82 07"), (0x40, "00"), (0x04, "00 01 00 00 00 00 02 03")):
        other.send(message(kind, bytes.fromhex(data), is_error_frame=True))
    assert wait(bus, lambda events: len(events) == 4) == [
        BusChanged("can0", "passive", "", (130, 7)),
        BusChanged("can0", "bus-off", "", None),
        BusChanged("can0", None, "", (2, 3)),
        BusOverrun("can0"),
    ]


class OwnClock(can.BusABC):
    """An interface whose frames have times of its own clock."""

    def __init__(self, **_: object) -> None:
        self.frames = [can.Message(timestamp=12.5, arbitration_id=0x185, is_extended_id=False)]

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self.frames.pop() if self.frames else None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError

    def shutdown(self) -> None:
        pass

    def __del__(self) -> None:
        pass


def test_a_clock_of_the_interfaces_own_tells_no_time() -> None:
    bus = CanBus(BusWiring("can0", "virtual", "own clock"), make=OwnClock)
    bus.open()
    assert bus.poll()[1:] == [FrameReceived("can0", Frame(0x185, b""), None)]


def test_a_full_queue_is_told_and_keeps_the_bus_open(interface: emulated.Interface, opened: CanBus) -> None:
    interface.hold()
    assert "No buffer space" in eventually(lambda: opened.send_frame(FRAME))
    interface.release()
    assert set(wait(opened, lambda events: len(events) >= 10)) == {FrameEchoed("can0", FRAME)}


@pytest.mark.parametrize("how", ["down", "deleted"])
def test_a_bus_that_goes_down_is_opened_again(
    interface: emulated.Interface, opened: CanBus, clock: Clock, how: str
) -> None:
    interface.down() if how == "down" else interface.delete()
    [event] = wait(opened, len)
    assert (event.state, "failed" in event.why) == ("down", True)
    assert opened.send_frame(FRAME) is not None
    assert opened.poll() == [], "it waits between attempts"
    for pause in (0.1, 0.2, 0.4, 0.8, 1.0, 1.0):
        clock.now += pause + 1e-6
        assert [event.state for event in opened.poll()] == ["down"]
    interface.up() if how == "down" else interface.make()
    clock.now += 1.1
    assert [event.state for event in wait(opened, len)] == ["active"]
    assert opened.send_frame(FRAME) is None
    wait(opened, lambda events: FrameEchoed("can0", FRAME) in events)


def test_sending_on_a_bus_that_is_down_shows_it(interface: emulated.Interface, opened: CanBus) -> None:
    interface.down()
    why = opened.send_frame(FRAME)
    assert why is not None
    assert "Network is down" in why
    assert [event.state for event in opened.poll()] == ["down"]
    opened.close()
    assert [event.state for event in opened.poll()] == ["closed"]
    assert opened.send_frame(FRAME) == "the bus is closed"


@pytest.mark.parametrize("kind", ["nonsense", "socketcan"])
def test_a_bus_that_cannot_be_opened_is_named(kind: str, caplog: pytest.LogCaptureFixture) -> None:
    bus = CanBus(BusWiring("can7", kind, "nowhere0"))
    with caplog.at_level("DEBUG"), pytest.raises(BusError, match=rf"can7.*nowhere0.*{kind}"):
        bus.open()
    assert [record for record in caplog.records if record.name.startswith("can")] == []
    assert (bus.send_frame(FRAME), bus.poll(), bus.fileno()) == ("the bus is closed", [], None)


@pytest.mark.parametrize(
    ("kind", "data", "state", "errors", "lost"),
    [
        (0x04, "00 04 00 00 00 00 60 00", "warning", (96, 0), False),
        (0x04, "00 08 00 00 00 00 00 61", "warning", (0, 97), False),
        (0x04, "00 10 00 00 00 00 00 80", "passive", (0, 128), False),
        (0x204, "00 24 00 00 00 00 82 07", "passive", (130, 7), False),  # passive is past warning in receiving
        (0x04, "00 40 00 00 00 00 5f 00", "active", (95, 0), False),
        (0x04, "00 01 00 00 00 00 02 03", None, (2, 3), True),  # its receive buffer ran over
        (0x04, "00 01 00 00 00 00 00 00", None, None, True),  # likewise; this driver tells no counters
        (0x204, "00 01 00 00 00 00 00 00", None, (0, 0), True),
        (0x04, "00 01", None, None, True),
        (0x04, "00 02", None, None, False),
        (0x08, "00 01", None, None, False),
        (0x04, "", None, None, False),
        (0x40, "00 00 00 00 00 00 00 00", "bus-off", None, False),
        (0x44, "00 20 00 00 00 00 ff 00", "bus-off", (255, 0), False),
        (0x100, "", "active", None, False),
        (0x140, "", "bus-off", None, False),
        (0x08, "00 00 08 00 00 00 00 00", None, None, False),  # a bit error alone
    ],
)
def test_error_frames(kind: int, data: str, state: str | None, errors: tuple[int, int] | None, lost: bool) -> None:
    assert read_error(kind, bytes.fromhex(data)) == (state, errors, lost)


OWNER = """
from hyperbit.drivers.canopen.wire.bus import lock_interface
lock = lock_interface("can-of-a-test")
print("owns", flush=True)
input()
"""


def test_one_process_owns_an_interface_until_it_ends() -> None:
    command, pipe = [sys.executable, "-c", OWNER], subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "owns\n"
        with pytest.raises(InterfaceInUse, match=f"process {owner.pid} of hyperbit uses can-of-a-test: stop it first"):
            lock_interface("can-of-a-test")
        lock_interface("another-can").close()
        owner.kill()
    lock_interface("can-of-a-test").close()
