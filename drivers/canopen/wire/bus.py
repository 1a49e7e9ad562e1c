"""One CAN bus over python-can, non-blocking. No other module of this folder imports python-can."""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import struct
import time
from collections.abc import Callable
from typing import Any

import can

from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.wire.cia301 import BUS_OFF, REMOTE, RESTARTED, Frame, wire_bits
from hyperbit.drivers.canopen.wire.events import BusChanged, BusOverrun, Event, FrameEchoed, FrameIgnored, FrameReceived
from hyperbit.drivers.canopen.wiring import BusWiring

# python-can logs each failed attempt to open an interface, and raises it too. The daemon tells it once.
logging.getLogger("can").setLevel(logging.CRITICAL)

_MOST_EVENTS = 256  # in one poll, so that a flood does not block the caller
_FIRST_PAUSE, _LONGEST_PAUSE = 0.1, 1.0  # [s] between attempts to open the bus again
_OLDEST = 10.0  # [s]; an older time stamp, or one in the future, is ignored
_GONE = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO)  # the interface is down or deleted
_NOTHING = (errno.EAGAIN, errno.EINTR)  # no frame waits

# Error frames of SocketCAN, from linux/can/error.h.
_CONTROLLER, _COUNTERS = 0x04, 0x200  # bits of the identifier: a class, and "has error counters"
_OVERRUN = 0x01  # a detail: the receive buffer of the controller ran over
_WARNING, _PASSIVE, _ACTIVE = 0x04 | 0x08, 0x10 | 0x20, 0x40  # details, in data[1]


def read_error(identifier: int, data: bytes) -> tuple[str | None, tuple[int, int] | None, bool]:
    """Parses an error frame: state, transmit and receive error counter, and whether frames were lost.

    The state is "active", "warning", "passive" or "bus-off". State and counters are None if the frame lacks them.
    """
    data = data.ljust(8, b"\0")
    state: str | None = None
    if identifier & _CONTROLLER:
        details = ((_PASSIVE, "passive"), (_WARNING, "warning"), (_ACTIVE, "active"))
        state = next((name for detail, name in details if data[1] & detail), None)
    if identifier & RESTARTED:
        state = "active"
    if identifier & BUS_OFF:
        state = "bus-off"
    controller = bool(identifier & _CONTROLLER)
    # Drivers before Linux 6.1 send the counters with a state, without the flag.
    told = identifier & _COUNTERS or (controller and (state is not None or any(data[6:8])))
    return state, (data[6], data[7]) if told else None, controller and bool(data[1] & _OVERRUN)


class InterfaceInUse(BusError):
    """Another process of this computer owns the interface."""


def lock_interface(channel: str) -> socket.socket:
    """Locks a SocketCAN interface until the returned socket is closed, or the process ends.

    It is a Unix socket in the abstract namespace, which belongs to a network namespace as interfaces do.
    """
    address = f"\0hyperbit/can/{channel}"
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        lock.bind(address)
    except OSError:
        owner: int | str = "(unknown)"
        with lock, contextlib.suppress(OSError):
            lock.connect(address)
            peer = lock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
            owner = struct.unpack("3i", peer)[0]
        raise InterfaceInUse(f"process {owner} of hyperbit uses {channel}: stop it first") from None
    lock.listen()
    return lock


class CanBus:
    """One CAN bus. No method blocks, and only `open` raises.

    A bus that goes down is opened again by `poll`, with a growing pause between attempts; `clock` returns the time [s],
    and `make` opens an interface of python-can.
    """

    def __init__(self, wiring: BusWiring, clock: Callable[[], float] = time.monotonic, make: Any = can.Bus) -> None:
        self.wiring, self.name, self._clock, self._make = wiring, wiring.name, clock, make
        self._bus: can.BusABC | None = None
        self._lock: socket.socket | None = None
        self._closed, self._down = True, False
        self._pause, self._next_try = _FIRST_PAUSE, 0.0
        self._events: list[Event] = []

    def open(self) -> None:
        """Opens the bus, and holds the lock of its interface until `close`.

        Raises:
            InterfaceInUse: another process of this computer owns the interface.
            BusError: the interface cannot be opened.
        """
        s = self.wiring
        if self._lock is None and s.interface == "socketcan":
            self._lock = lock_interface(s.channel)
        try:
            self._bus = self._open()
        except Exception as error:  # python-can passes on any exception of the interface
            raise BusError(f"{s.name}: cannot open {s.channel} of the interface {s.interface}: {error}") from error
        self._closed = self._down = False
        self._events.append(BusChanged(self.name, "active", "", None))

    def fileno(self) -> int | None:
        """Returns the file descriptor to wait on; None if there is none now, then call `poll` every tick.

        The number changes when the bus is opened again: ask for it after each `poll`.
        """
        with contextlib.suppress(Exception):  # virtual interfaces have none
            if self._bus is not None and (number := self._bus.fileno()) >= 0:
                return number
        return None

    def send_frame(self, frame: Frame) -> str | None:
        """Sends a frame now or not at all; returns why it was not sent, or None. The caller informs the master."""
        if self._bus is None:
            return "the bus is closed" if self._closed else "the interface is down"
        number, remote = frame.id & ~REMOTE, bool(frame.id & REMOTE)
        message = can.Message(arbitration_id=number, data=frame.data, is_remote_frame=remote, is_extended_id=False)
        try:
            self._bus.send(message)
        except Exception as error:
            if getattr(error, "error_code", None) in _GONE:
                self._lose(f"sending failed ({error})")
            return str(error) or repr(error)
        return None

    def poll(self) -> list[Event]:
        """Returns the events since the last call, at most 256 frames; after 256, call again soon."""
        if self._bus is None and not self._closed and self._clock() >= self._next_try:
            try:
                self._bus = self._open()
            except Exception as error:
                self._lose(f"it cannot be opened ({error})")
        for _ in range(_MOST_EVENTS):
            if self._bus is None:
                break
            try:
                message = self._bus.recv(0)
            except Exception as error:  # interfaces raise any exception; reading continues when the bus is back
                if getattr(error, "error_code", None) not in _NOTHING:
                    self._lose(f"reading failed ({error})")
                break
            if self._down:  # an interface that is down can be opened, but not read
                self._down, self._pause = False, _FIRST_PAUSE
                self._events.append(BusChanged(self.name, "active", "", None))
            if message is None:
                break
            self._events += self._read(message)
        events, self._events = self._events, []
        return events

    def close(self) -> None:
        """Closes the bus. Sends nothing."""
        self._closed = True
        self._shut()
        if self._lock is not None:
            self._lock.close()
            self._lock = None
        self._events = [BusChanged(self.name, "closed", "", None)]

    def _read(self, message: can.Message) -> list[Event]:
        if message.is_error_frame:
            state, errors, overrun = read_error(message.arbitration_id, bytes(message.data))
            return [BusChanged(self.name, state, "", errors), *([BusOverrun(self.name)] if overrun else ())]
        remote = message.is_remote_frame
        if (remote and message.is_rx) or message.is_extended_id or message.is_fd:
            return [FrameIgnored(self.name, wire_bits(0 if remote else min(message.dlc, 8), message.is_extended_id))]
        frame = Frame(message.arbitration_id | (REMOTE if remote else 0), bytes(message.data))
        late = time.time() - message.timestamp  # the interface may use another clock
        at = time.monotonic() - late if 0.0 <= late < _OLDEST else None
        return [FrameReceived(self.name, frame, at) if message.is_rx else FrameEchoed(self.name, frame, at)]

    def _open(self) -> can.BusABC:
        s = self.wiring
        echo = s.interface != "pcan"  # its driver for Linux refuses to echo
        bus: can.BusABC = self._make(
            interface=s.interface, channel=s.channel, bitrate=s.bitrate, receive_own_messages=echo, ignore_config=True
        )
        if (raw := getattr(bus, "socket", None)) is not None:
            raw.setblocking(False)  # a full send buffer must fail, not block
        return bus

    def _shut(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            with contextlib.suppress(Exception):  # a missing interface may fail to shut down
                bus.shutdown()

    def _lose(self, why: str) -> None:
        self._shut()
        self._next_try = self._clock() + self._pause
        self._pause = min(2 * self._pause, _LONGEST_PAUSE)
        self._down = True
        self._events.append(BusChanged(self.name, "down", why, None))
