"""One CAN bus from the master's side: state, load, frames under way, and waiting frames."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.status import BusStatus, Traffic
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import REMOTE, Frame, wire_bits
from hyperbit.drivers.canopen.wiring import BusWiring

_MOST_UNSENT = 4  # queued frames handed out at once; a SocketCAN interface holds 10 by default
_ECHOED = 0.03  # [s] until nearly all commands are sent


class TxPending:
    """The frames that wait for their echo; `last_echo` is the time of the last echo [s].

    SocketCAN echoes each frame when it was sent (receive_own_messages). Frames are matched by identifier and data,
    since controllers with several mailboxes do not keep the order. But every controller sends a frame before a later
    one with a greater identifier. So the echo of the later frame shows that the echo of the earlier one was lost. Some
    interfaces never echo frames: no frame counts as pending until the first echo.
    """

    def __init__(self) -> None:
        self.last_echo: float | None = None
        self._pending: list[tuple[Frame, float]] = []  # with the time [s], in the order in which they were handed out
        self._given_up: Counter[Frame] = Counter()

    @property
    def count(self) -> int:
        return 0 if self.last_echo is None else len(self._pending)

    @property
    def oldest(self) -> float | None:
        """Time when the oldest pending frame was handed out [s]; None if no frame is pending."""
        return self._pending[0][1] if self.count else None

    def holds(self, cob_id: int) -> bool:
        return self.last_echo is not None and any(frame.id == cob_id for frame, _ in self._pending)

    def commanded(self, before: float) -> bool:
        """Returns whether an NMT command, SYNC or RPDO handed out before a time [s] is pending."""
        waits = any(frame.id < cia301.SDO_ANSWER and at < before for frame, at in self._pending)
        return waits and self.last_echo is not None

    def sent(self, frame: Frame, now: float) -> None:
        """Adds a frame. Gives up equal frames that were handed out before the last echo: their echoes were lost.

        Otherwise each echo of a heartbeat would count as the lost echo of the heartbeat before it, for ever.
        """
        last = -math.inf if self.last_echo is None else self.last_echo
        kept = [(each, at) for each, at in self._pending if each != frame or at >= last]
        if lost := len(self._pending) - len(kept):
            self._given_up[frame] += lost
        self._pending = [*kept, (frame, now)]

    def failed(self, frame: Frame) -> bool:
        return self._remove(frame) is not None

    def came_back(self, frame: Frame, now: float) -> list[Frame]:
        """Takes an echo; returns the sent frame, after earlier ones whose echo was lost. Empty: a foreign frame."""
        if (place := self._remove(frame)) is not None:
            earlier = (each for each, _ in self._pending[:place])
            lost = [each for each in earlier if each.id & ~REMOTE < frame.id & ~REMOTE]
            for each in lost:
                self._remove(each)
            self._given_up.update(lost)
        elif frame in self._given_up:
            lost = []
            self._given_up[frame] -= 1
            self._given_up = +self._given_up  # without zeros
        else:
            return []
        self.last_echo = now
        return [*lost, frame]

    def give_up(self, before: float = math.inf) -> None:
        """Stops waiting for frames handed out before a time [s]; their echoes are still recognised."""
        old = {frame for frame, at in self._pending if at < before}
        self._given_up.update(frame for frame, _ in self._pending if frame in old)
        self._pending = [(frame, at) for frame, at in self._pending if frame not in old]

    def forget(self) -> None:
        """Forgets all frames: a bus that was opened again cannot echo them."""
        self._pending.clear()
        self._given_up.clear()

    def _remove(self, frame: Frame) -> int | None:
        """Removes the oldest of equal frames; returns its place, or None."""
        place = next((k for k, (each, _) in enumerate(self._pending) if each == frame), None)
        if place is not None:
            del self._pending[place]
        return place


@dataclass(slots=True, eq=False)
class Outgoing:
    """A queued frame, which is sent again if the bus was full."""

    frame: Frame
    first_at: float | None = None  # when it was handed out first [s]; None while it waits
    sent: bool = False  # sending was confirmed
    cancelled: bool = False  # will not be sent any more


class Link:
    """One CAN bus; its `state` is "closed", "active", "warning", "passive", "bus-off" or "down".

    `rearm` arms the bus. The loss of the bus (bus-off, down, or stuck) disarms it. RPDOs and SYNC are sent only while
    it is armed: the kernel sends the frames that it still holds when the bus comes back. Only a release, which switches
    lines off, is sent on a bus that is not armed. The bus counts as lost if no frame could be sent for `stuck_after`
    [s].
    """

    def __init__(self, wiring: BusWiring, send: Callable[[str, Frame], None], stuck_after: float) -> None:
        self.wiring, self.name = wiring, wiring.name
        self.state, self.armed = "closed", False
        self.pending = TxPending()
        self.ignored = self.overruns = 0  # received frames that were not understood, and losses of frames
        self._hand_out, self._stuck_after = send, stuck_after
        self._lost_at = -1.0
        self._failing_since: float | None = None
        self._sent_since_tick = self._failed_since_tick = False
        self._queue: deque[Outgoing] = deque()
        self._urgent: deque[Outgoing] = deque()
        self._unsent: dict[Frame, Outgoing] = {}  # frames of the queue that were handed out and not yet sent
        self._errors = 0, 0
        self._dropped = self._tx_frames = self._rx_frames = self._bits = 0
        self._counted: tuple[float, int, int] | None = None  # time, frames and bits when the rates were computed
        self._frames_per_second = self._bits_per_second = 0.0

    @property
    def usable(self) -> bool:
        return self.state not in ("closed", "down", "bus-off")

    @property
    def failing(self) -> bool:
        return self._failing_since is not None

    @property
    def echoes(self) -> bool:
        return self.pending.last_echo is not None

    def misses_echo(self, now: float, last: Frame) -> bool:
        """Returns whether a command's echo is overdue, and no `last` frame (of least priority) is pending."""
        return self.pending.commanded(now - _ECHOED) and not self.pending.holds(last.id)

    def fit(self, now: float) -> bool:
        """Returns whether the bus sends frames again after its loss."""
        last = self.pending.last_echo
        heard = last is None or last > self._lost_at
        return self.usable and heard and not self.failing and self._stuck_for(now) <= self._stuck_after

    def rearm(self) -> ArmFault | None:
        """Arms the bus and drops waiting frames; returns a fault if the bus is not usable."""
        self._clear()
        self.armed = self.usable
        if self.armed:
            self.pending.give_up()
            self._failing_since = None
            return None
        code = "bus-off" if self.state == "bus-off" else "bus-down"
        return ArmFault(code, self.name, f"{self.name} is {self.state}: check the cable and the interface")

    def send_frame(self, frame: Frame, now: float) -> None:
        self._sent_since_tick = True
        self.pending.sent(frame, now)
        self._tx_frames += 1
        self._bits += wire_bits(len(frame.data))
        self._hand_out(self.name, frame)

    def queue(self, outgoing: Outgoing, now: float, urgent: bool = False) -> None:
        """Queues a frame; an urgent one goes before the others, and does not wait for frames outside the queue."""
        (self._urgent if urgent else self._queue).append(outgoing)
        self._pump(now)

    def received(self, bits: int) -> None:
        self._rx_frames += 1
        self._bits += bits
        if self.state == "bus-off":  # the error frame of its restart was missed
            self.state = "active"

    def echoed(self, frame: Frame, now: float) -> list[Frame]:
        """Takes the echo of a frame; returns the sent frames, see `TxPending.came_back`."""
        sent = self.pending.came_back(frame, now)
        if sent and self.state == "bus-off":
            self.state = "active"
        for each in sent:
            if (outgoing := self._unsent.pop(each, None)) is not None:
                outgoing.sent = True
        self._pump(now)
        return sent

    def send_failed(self, frame: Frame, now: float) -> None:
        """Records that a frame could not be sent; a queued frame is sent again after the next tick."""
        if not self.pending.failed(frame):
            return
        self._dropped += 1
        self._tx_frames -= 1
        self._bits -= wire_bits(len(frame.data))
        self._failed_since_tick = True
        if self._failing_since is None:
            self._failing_since = now
        if (outgoing := self._unsent.pop(frame, None)) is not None:
            self._queue.appendleft(outgoing)

    def answered(self, outgoing: Outgoing, now: float) -> None:
        """Records that a board has answered a queued frame, so the frame was sent."""
        outgoing.sent = True
        if self._unsent.get(outgoing.frame) is outgoing:
            del self._unsent[outgoing.frame]
            self._pump(now)

    def changed(self, state: str | None, why: str, errors: tuple[int, int] | None, now: float) -> ArmFault | None:
        """Takes a new state and new error counters; returns a fault if the bus is lost."""
        if errors is not None:
            self._errors = errors
        if state == "bus-off":
            advice = "the controller is bus-off after too many errors; check cable, termination, bit rate"
            return self._lose(state, "bus-off", why or advice, now)
        if state == "down":
            return self._lose(state, "bus-down", why or "the interface is down", now)
        if state is not None:
            if self.state in ("down", "closed"):  # the bus was opened again
                self.pending.forget()
                self._clear()
            self.state = state
            self.armed &= self.usable
        return None

    def tick(self, now: float, clock: float) -> ArmFault | None:
        """Returns a fault if the bus is stuck. `now` stands still while the loop stalls, `clock` is real time [s]."""
        if self._sent_since_tick and not self._failed_since_tick:
            self._failing_since = None
        self._sent_since_tick = self._failed_since_tick = False
        if not self.echoes:  # without echoes, frames that have not failed count as sent
            for outgoing in self._unsent.values():
                outgoing.sent = True
            self._unsent.clear()
        self.pending.give_up(now - max(1.0, 2 * self._stuck_after))
        self._count_rates(clock)
        if self.armed and self._stuck_for(now) > self._stuck_after:
            why = f"no frame was sent for {self._stuck_after:g} s: is the bus full, and does another node acknowledge?"
            return self._lose(self.state, "bus-busy", why, now)
        self._pump(now)
        return None

    def passive(self) -> ArmFault | None:
        """Returns a warning while the controller is error-passive; it does not stop the arm."""
        if self.state != "passive":
            return None
        errors = f"{self._errors[0]} transmit and {self._errors[1]} receive errors"
        text = f"{self.name} is error-passive after {errors}: check cable, termination, bit rate before it is bus-off"
        return ArmFault("bus-passive", self.name, text)

    def status(self, worst_case: Traffic) -> BusStatus:
        return BusStatus(
            name=self.name,
            state=self.state,
            tx_frames=self._tx_frames,
            rx_frames=self._rx_frames,
            tx_errors=self._errors[0],
            rx_errors=self._errors[1],
            dropped=self._dropped,
            ignored=self.ignored,
            overruns=self.overruns,
            frames_per_second=self._frames_per_second,
            bits_per_second=self._bits_per_second,
            load=min(1.0, self._bits_per_second / self.wiring.bitrate),
            worst_case=worst_case,
        )

    def _count_rates(self, clock: float) -> None:
        frames = self._tx_frames + self._rx_frames
        if self._counted is not None:
            began, frames_before, bits_before = self._counted
            if (elapsed := clock - began) < 1.0:
                return
            self._frames_per_second = (frames - frames_before) / elapsed
            self._bits_per_second = (self._bits - bits_before) / elapsed
        self._counted = clock, frames, self._bits

    def _pump(self, now: float) -> None:
        """Hands out queued frames, a few at a time: SDO transfers must not delay the heartbeat on a slow bus."""
        if self._failed_since_tick or not self.usable:
            return
        others = self.pending.count > len(self._unsent)  # commands and heartbeats that are not sent yet
        while len(self._unsent) < _MOST_UNSENT and (queue := self._urgent or (not others and self._queue)):
            outgoing = queue.popleft()
            if not outgoing.cancelled:
                if outgoing.first_at is None:
                    outgoing.first_at = now
                self._unsent[outgoing.frame] = outgoing
                self.send_frame(outgoing.frame, now)

    def _clear(self) -> None:
        for outgoing in (*self._urgent, *self._queue, *self._unsent.values()):
            outgoing.cancelled = True
        self._urgent.clear()
        self._queue.clear()
        self._unsent.clear()

    def _stuck_for(self, now: float) -> float:
        since = [t for t in (self._failing_since, self.pending.oldest) if t is not None]
        return now - min(since) if since else 0.0

    def _lose(self, state: str, code: str, why: str, now: float) -> ArmFault:
        self.armed, self.state, self._lost_at = False, state, now
        self._clear()
        return ArmFault(code, self.name, f"{self.name}: {why}")
