"""The event loop: CAN, socket, ticks and signals around the core. One thread, which blocks only in `select`."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import select
import time
import traceback
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from hyperbit.controller.executor.core import events
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.process.buses import CanBuses
from hyperbit.controller.executor.process.server import ExecutorServer
from hyperbit.controller.flight_recorder import FlightRecorder
from hyperbit.controller.host.notify import Notifier
from hyperbit.controller.host.output import flush_outputs
from hyperbit.controller.host.process import Log, Notify, Quit
from hyperbit.controller.messages.state import LoopTimes
from hyperbit.controller.program import TICK

if TYPE_CHECKING:
    from hyperbit.controller.executor.process.embedded_boards import EmbeddedBoards

log = logging.getLogger("executor")

SOON = 0.001  # [s] before due diagnostics, a tick requests the figures of the process
CLOSE = 0.0007  # [s] before a tick no message is handled; a program takes about as long
MOST_ROUNDS = 32  # polls of the buses in a row, before the tick is checked
MOST_PENDING = 1_000  # recorded events that wait for the end of a tick
CHECKPOINTING = 0.005  # [s], least time before the next tick for a checkpoint; 24 boards with 48 actuators take 0.002 s
CHECKPOINT_AT = 10_000  # events since the last checkpoint
CLOSING = 0.25  # [s] for the running stage at the end
FLUSHING = 0.5  # [s] for the messages that wait at the end
WORTH, TOO_MANY = 500, 5_000  # objects since the last collection; collecting 5,000 takes about 3 ms


class EventLoop:
    """Passes events to the core, and performs its actions.

    Frames are sent at once, since the arm waits for them. Messages and log lines are sent when no event and no echo of
    an RPDO is awaited, and at the next tick at the latest. A client's message shortly before a tick waits for it.
    `clock`: CLOCK_MONOTONIC [s].
    """

    def __init__(
        self,
        core: Executor,
        buses: CanBuses | EmbeddedBoards,
        server: ExecutorServer,
        notifier: Notifier,
        clock: Callable[[], float] = time.monotonic,
        recorder: FlightRecorder | None = None,
    ) -> None:
        self._core, self._buses, self._server, self._notifier = core, buses, server, notifier
        self._clock, self.recorder = clock, recorder
        self.real_time = Timekeeper(TICK)
        self._garbage = Garbage()
        self._quitting = False
        self.queued = deque[events.Action]()
        self._wake, self._woken = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)

    def quit(self) -> None:
        """Asks the loop to end; a second call ends it at once. Any thread or signal handler may call this."""
        self._quitting = True
        with contextlib.suppress(OSError):  # the loop has ended already
            os.write(self._woken, b"q")

    def run(self) -> None:
        """Runs until `quit`; then gives the running program its result, and closes everything."""
        with self._garbage:
            if self.recorder is not None:
                self.recorder.begin(self._core, self._may_checkpoint)
            self.real_time.start(self._clock())
            while not self._quitting:
                self.round()
            self._end()

    def _may_report(self, now: float) -> bool:
        return bool(self.queued) and not self._core.collecting and not self.real_time.tick_is_near(now)

    def round(self) -> None:
        try:
            ready = self._wait()
            self._receive_frames()
            began = self._clock()
            if self.real_time.remaining(began) <= 0:
                self._tick(began)
            for event in self._server.poll(ready):
                self._step(event)
                self._receive_frames()
            if self.real_time.rests and not self._core.resting(now := self._clock()):
                self.real_time.hurry(now)
            if not ready and self._may_report(self._clock()):
                self._report(self.queued.popleft())
        except Exception:  # the arm holds, and the boards keep their master
            self._step(events.Defect(traceback.format_exc()))

    def _wait(self) -> list[int]:
        """Waits for a readable or writable file descriptor or the tick; returns the readable ones. See `resting`."""
        now, rests = self._clock(), self.real_time.rests
        longest = self.real_time.remaining(now) if rests else min(self.real_time.remaining(now), self._buses.wait(now))
        timeout = 0.0 if self._may_report(now) else max(longest, 0.0)
        clients = [] if self.real_time.tick_is_near(now) else self._server.readable()
        readable = [self._wake, *([] if rests else self._buses.filenos()), *clients]
        writable = self._server.writable()
        read, written, _ = select.select(readable, writable, [], timeout)
        if written:
            self._server.flush()
        if self._wake in read:
            os.read(self._wake, 4096)
        return read

    def _receive_frames(self) -> None:
        for _ in range(MOST_ROUNDS):
            arrived = self._buses.poll(self._clock())
            for event in arrived:
                self._step(event)
            if not arrived or self.real_time.remaining(self._clock()) <= 0:
                return

    def _tick(self, began: float) -> None:
        self._report_all()
        flush_outputs()
        if self._core.reports.diagnostics_due(began + SOON):
            self._step(events.Health(self.real_time.drain_figures(), self._server.dropped, self._core.journal.problem))
        self._step(events.ExecutorTick())
        self._receive_frames()
        self.real_time.ticked(began, self._clock(), self._core.period)
        if self.recorder is not None:
            self.recorder.flush()
        self._garbage.collect(self._core.modes.mode != "executing")

    def _step(self, event: events.Event) -> None:
        """Passes an event to the core, sends its frames, and queues its other actions for `_report`."""
        now = self._clock()
        actions: list[events.Action] | None = None
        try:
            actions = self._core.step(event, now)
            for action in actions:
                if isinstance(action, events.SendFrame):
                    self._buses.send_frame(action.bus, action.frame, self._clock())
                else:
                    self.queued.append(action)
        finally:
            if self.recorder is not None:
                self.recorder(event, now, None, actions)

    def _may_checkpoint(self, count: int) -> bool:
        """Whether the core may be pickled: while the arm holds, or after CHECKPOINT_AT events while it moves."""
        spare = self.real_time.remaining(self._clock()) > CHECKPOINTING
        return spare and self._core.calm and (self._core.modes.mode != "executing" or count >= CHECKPOINT_AT)

    def _report(self, action: events.Action) -> None:
        match action:
            case events.ToClient():
                self._server.send_message(action.client, action.message)
            case events.ToSimulation():
                try:
                    text, played = self._buses.play_fault(action.fault), True
                except ValueError as error:
                    text, played = str(error), False
                self._step(events.FaultPlayed(action.client, action.request, text, played))
            case Notify():
                self._notifier.notify(action.text)
            case Log():
                log.log(action.level, "%s", action.text, extra={"journal": action.fields})
            case _:
                pass

    def _report_all(self) -> None:
        while self.queued:
            self._report(self.queued.popleft())

    def _end(self) -> None:
        """Ends the program with a result, and closes everything. A second `quit` waits for no stage and contraction."""
        self._quitting = False
        self._step(Quit())
        until = self._clock() + CLOSING + self._core.ending.timeout
        while not (self._core.ended or self._quitting) and self._clock() < until:
            self.round()
        self._step(Quit())
        self._report_all()
        until = self._clock() + FLUSHING
        while self._server.waiting and self._clock() < until:
            select.select([], self._server.writable(), [], max(until - self._clock(), 0.0))
            self._server.flush()
        self._server.close()
        self._buses.close()
        os.close(self._wake)
        woken, self._woken = self._woken, -1
        os.close(woken)


class Timekeeper:
    """Ticks at a fixed phase, every `period` seconds or after several; missed ticks are counted and skipped."""

    def __init__(self, period: float) -> None:
        self._period, self._planned, self._overruns = period, period, 0
        self.rests = False  # the next tick comes after several periods
        self.next_tick = self._last = 0.0
        self._late, self._periods, self._works = list[float](), list[float](), list[float]()

    def start(self, now: float) -> None:
        self.next_tick = self._last = now

    def hurry(self, now: float) -> None:
        """Ends a rest: the next tick is the first of the phase."""
        spare = int((self.next_tick - now) / self._period) * self._period
        self.next_tick -= max(spare, 0.0)
        self._planned -= max(spare, 0.0)
        self.rests = False

    def remaining(self, now: float) -> float:
        return max(self.next_tick - now, 0.0)

    def tick_is_near(self, now: float) -> bool:
        """Returns whether the next tick is close, but not due: long work would delay it."""
        return 0.0 < self.next_tick - now < CLOSE

    def ticked(self, began: float, ended: float, planned: float) -> None:
        """Records a tick; the next one comes after `planned` seconds."""
        self._late.append(began - self.next_tick)
        self._periods.append(began - self._last - (self._planned - self._period))
        self._works.append(ended - began)
        self._last, self._planned, self.rests = began, planned, planned > self._period
        self.next_tick += planned
        if self.next_tick < ended:
            missed = int((ended - self.next_tick) / self._period) + 1
            self._overruns += missed
            self.next_tick += missed * self._period

    def drain_figures(self) -> LoopTimes:
        """Returns the figures since the last call, and resets them."""
        count = max(len(self._works), 1)
        late = sorted(self._late)
        times = LoopTimes(
            ticks=len(self._works),
            longest_period=max(self._periods, default=0.0),
            mean_work=sum(self._works) / count,
            longest_work=max(self._works, default=0.0),
            overruns=self._overruns,
            late_p50=late[len(late) // 2] if late else 0.0,
            late_p99=late[len(late) * 99 // 100] if late else 0.0,
            late_worst=late[-1] if late else 0.0,
        )
        for figures in (self._late, self._periods, self._works):
            figures.clear()
        self._overruns = 0
        return times


class Garbage:
    """Collects garbage at harmless times: a full collection would stop the loop for milliseconds.

    Objects that live as long as the process are excluded from collection.
    """

    def __enter__(self) -> Garbage:
        gc.collect()
        gc.freeze()
        gc.disable()
        return self

    def __exit__(self, *_: object) -> None:
        gc.enable()
        gc.unfreeze()

    def collect(self, holding: bool) -> None:
        """Collects all objects if the arm holds, otherwise only the youngest ones, above TOO_MANY."""
        young, older, _ = gc.get_count()
        if holding and (young > WORTH or older > 0):
            gc.collect()
        elif young > TOO_MANY:
            gc.collect(0)
