"""One CAN bus: its own reader thread, its state from error frames, and a send that knows what has left."""

from __future__ import annotations

import contextlib
import errno
import logging
import threading
import time
from collections.abc import Callable

import can

from drivers.error_frames import read_error
from drivers.faults import BusBusy, BusError, Fault
from drivers.meter import Meter
from drivers.outstanding import Outstanding
from drivers.status import BusStatus, Traffic
from drivers.wiring import BusSettings

_logger = logging.getLogger(__name__)

_POLL = 0.05  # [s] how long the reader waits for a frame before it looks whether it shall end
_FIRST_PAUSE, _LONGEST_PAUSE = 0.1, 1.0  # [s] between attempts to open the bus again
_GONE = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO)  # of an interface that is down or deleted


class CanBus:
    """One CAN bus.

    It is armed by `rearm` and disarmed when it is lost: bus-off, down, or stuck. What moves actuators is to be sent
    only while it is armed, and a SYNC only when all before it has left, because frames the kernel still holds go out
    when the bus comes back. What has left is known from the interface, which gives our own frames back (SocketCAN
    does, and python-can's virtual bus); from one that never does, a frame counts as gone once it is sent.

    Args:
        settings: which bus.
        on_frame: called from the reader thread with each standard data frame; returns False when it means nothing.
        on_fault: called when the bus is lost, from the reader thread or from that which sends.
        on_left: called from the reader thread when the last of our frames has left.
        stuck_after: the bus is lost when nothing could be sent, or what was sent did not leave, for so long [s].
    """

    def __init__(
        self,
        settings: BusSettings,
        on_frame: Callable[[can.Message], bool],
        on_fault: Callable[[Fault], None],
        on_left: Callable[[], None] = lambda: None,
        stuck_after: float = 0.2,
    ) -> None:
        self.settings = settings
        self._stuck_after = stuck_after
        self.state = "closed"
        self.armed = False
        self._on_frame = on_frame
        self._on_fault = on_fault
        self._on_left = on_left
        self._outstanding = Outstanding(longest=max(1.0, 2 * stuck_after))
        self._failing_since: float | None = None  # when sending began to fail
        self._lost_at = 0.0
        self._bus: can.BusABC | None = None
        self._closing = threading.Event()
        self._sending = threading.Lock()
        self._reader: threading.Thread | None = None
        self._meter = Meter()
        self._tx_errors = self._rx_errors = self._dropped = self._ignored = 0
        self._defect_told = False

    @property
    def name(self) -> str:
        """Of the bus."""
        return self.settings.name

    @property
    def usable(self) -> bool:
        """Whether frames can reach the wire, as far as is known."""
        return self.state not in ("closed", "down", "bus-off")

    @property
    def left(self) -> bool:
        """Whether all that was sent has left, as far as is known."""
        return not self._outstanding.waiting

    @property
    def failing(self) -> bool:
        """Whether the last frame could not be sent."""
        return self._failing_since is not None

    @property
    def fit(self) -> bool:
        """Whether frames reach the wire again since the bus was lost."""
        heard = self._outstanding.last > self._lost_at
        return self.usable and heard and not self.failing and self._stuck_for() <= self._stuck_after

    def open(self) -> None:
        """Opens the bus and starts reading.

        Raises:
            BusError: the interface cannot be opened.
        """
        try:
            self._bus = self._open()
        except Exception as error:  # python-can passes on whatever the interface raises
            s = self.settings
            raise BusError(f"{s.name}: cannot open {s.channel} of the interface {s.interface}: {error}") from error
        self.state = "active"
        self._closing.clear()
        self._reader = threading.Thread(target=self._read, name=f"read {self.name}", daemon=True)
        self._reader.start()

    def rearm(self) -> Fault | None:
        """Allows what moves actuators to be sent again, or tells why it cannot be."""
        self.armed = self.usable
        if self.armed:
            self._outstanding.write_off()
            self._failing_since = None
            return None
        code = "bus-off" if self.state == "bus-off" else "bus-down"
        return Fault(code, self.name, f"{self.name} is {self.state}: check the cable and the interface")

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        """Sends a frame now or not at all.

        Args:
            message: the frame.
            timeout: not used; python-can's signature, so that an SDO client can be given this bus.

        Raises:
            BusBusy: it could not be queued; it is counted and not kept.
        """
        try:
            with self._sending, self._outstanding.sending(message):
                if self._bus is None:
                    raise can.CanOperationError("the bus is not open")
                self._bus.send(message)
        except (can.CanError, OSError, ValueError) as error:
            self._dropped += 1
            self._failing_since = self._failing_since or time.monotonic()
            if getattr(error, "error_code", None) in _GONE and self.usable:
                self._lose("down", f"sending failed ({error}); it is opened again until it works")
            raise BusBusy(f"{self.name}: frame {message.arbitration_id:03X}h not sent: {error}") from error
        self._failing_since = None
        self._meter.sent(message)

    def tick(self, now: float) -> None:
        """Looks whether the bus is stuck, and renews the load figures once a second; `now` in [s]."""
        if self.armed and self._stuck_for() > self._stuck_after:
            why = "is it full, and does anybody acknowledge?"
            self._lose(self.state, f"no frame left for {self._stuck_after:g} s: {why}")
        self._meter.tick(now)

    def passive(self) -> Fault | None:
        """A warning while the controller is error-passive, which stops nothing."""
        if self.state != "passive":
            return None
        errors = f"{self._tx_errors} errors in sending and {self._rx_errors} in receiving"
        text = f"{self.name} is error-passive after {errors}: check cable, termination, bit rate before it is bus-off"
        return Fault("bus-passive", self.name, text)

    def status(self, worst_case: Traffic) -> BusStatus:
        """State and counters, beside the computed worst case."""
        meter = self._meter
        return BusStatus(
            name=self.name,
            state=self.state,
            tx_frames=meter.tx_frames,
            rx_frames=meter.rx_frames,
            tx_errors=self._tx_errors,
            rx_errors=self._rx_errors,
            dropped=self._dropped,
            ignored=self._ignored,
            frames_per_second=meter.frames_per_second,
            bits_per_second=meter.bits_per_second,
            load=min(1.0, meter.bits_per_second / self.settings.bitrate),
            worst_case=worst_case,
        )

    def close(self) -> None:
        """Stops reading and shuts the bus; sends nothing."""
        self.armed = False
        self._closing.set()
        if self._reader is not None:
            self._reader.join()
            self._reader = None
        self._shut()
        self.state = "closed"

    def _stuck_for(self) -> float:
        """For how long nothing has left that should have [s]."""
        since = [t for t in (self._failing_since, self._outstanding.oldest) if t is not None]
        return time.monotonic() - min(since) if since else 0.0

    def _open(self) -> can.BusABC:
        s = self.settings
        return can.Bus(
            interface=s.interface,
            channel=s.channel,
            bitrate=s.bitrate,
            receive_own_messages=True,
            ignore_config=True,
        )

    def _shut(self) -> None:
        with self._sending:
            bus, self._bus = self._bus, None
        if bus is not None:
            with contextlib.suppress(Exception):  # an interface that is gone may fail to shut, too
                bus.shutdown()

    def _read(self) -> None:
        pause = _FIRST_PAUSE
        while not self._closing.is_set():
            try:
                if self._bus is None:
                    self._outstanding.forget()
                    self._bus = self._open()
                message = self._bus.recv(_POLL)
            except Exception as error:  # whatever the interface raises, reading goes on when it is back
                self._shut()
                self._lose("down", f"reading failed ({error}); it is opened again until it works")
                self._closing.wait(pause)
                pause = min(2 * pause, _LONGEST_PAUSE)
                continue
            pause = _FIRST_PAUSE
            if self.state == "down" and self._bus is not None:
                self.state = "active"
            if message is not None:
                self._receive(message)

    def _receive(self, message: can.Message) -> None:
        if message.is_error_frame:
            self._receive_error(message)
            return
        if self.state == "bus-off":  # who hears is back on the bus, even if the word of it was lost
            self.state = "active"
        if not message.is_rx and self._outstanding.came_back(message):
            if self.left:
                self._on_left()
            return
        self._meter.received(message)
        try:
            standard = not (message.is_remote_frame or message.is_extended_id or message.is_fd)
            understood = standard and self._on_frame(message)
        except Exception:  # a frame nobody thought of must not end the reading
            if not self._defect_told:  # not once for each of thousands of frames
                _logger.exception("%s: cannot handle %s", self.name, message)
            self._defect_told, understood = True, False
        self._ignored += not understood

    def _receive_error(self, message: can.Message) -> None:
        said = read_error(message)
        if said.errors is not None:
            self._tx_errors, self._rx_errors = said.errors
        if said.state == "bus-off":
            self._lose("bus-off", "the controller is bus-off after too many errors; check cable, termination, bit rate")
        elif said.state is not None:
            self.state = said.state

    def _lose(self, state: str, why: str) -> None:
        self.armed = False
        self.state = state
        self._lost_at = time.monotonic()
        if not self._closing.is_set():
            code = {"bus-off": "bus-off", "down": "bus-down"}.get(state, "bus-busy")
            self._on_fault(Fault(code, self.name, f"{self.name}: {why}"))
