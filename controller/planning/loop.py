"""The loop around the planner's core: one thread that passes events to the core and carries out its actions."""

import itertools
import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, Protocol

from hyperbit.controller.flight_recorder import FlightRecorder
from hyperbit.controller.host.notify import Notifier
from hyperbit.controller.host.process import Log, Notify, Quit
from hyperbit.controller.messages.goals import Feedback, refused
from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.planning.core import events
from hyperbit.controller.planning.core.core import Core
from hyperbit.controller.planning.core.requests import CANCELED
from hyperbit.controller.planning.core.tasks import Failed
from hyperbit.controller.planning.ledger import Ledger, PublishedResults
from hyperbit.controller.planning.link import ExecutorLink, Inbox
from hyperbit.controller.planning.workers.pool import Workers
from hyperbit.controller.program import Cancel, Fault, Stop
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

log = logging.getLogger(__name__)

WARNINGS_EVERY = 0.25  # [s]
LOOK_EVERY = 0.02  # [s] between two looks into the mailboxes
STREAM_EVERY = 0.005  # [s] between two looks while set-points come
MOST_SENDERS = 16  # with a waiting set-point or measured tip; one more displaces the oldest
STREAM_ENDS = 0.5  # [s] after its last set-point
LAST_RESULTS = 1.5  # [s] for the core and the executor to end the running goal

STILL = 1.0  # [s] without a round of the loop, after which the process counts as having stood still
SETTLES = 1.0  # [s] after a standstill, until all messages sent meanwhile have arrived

OnReply = Callable[[Any], None]  # takes an `Answer`; of a request on `arm`, a `LiveArm`


class Out(Protocol):  # no method waits
    def publish(
        self, key: Literal["state", "diagnostics", "feedback"], message: State | Diagnostics | Feedback
    ) -> None: ...

    def publish_result(self, result: events.PublishResult) -> None: ...  # notes it, and posts `Published`


class Services(NamedTuple):  # services of the process for the planner
    inbox: Inbox  # event queue; ledger, outbox and workers post to it
    ledger: Ledger
    published: PublishedResults
    out: Out
    notifier: Notifier
    warnings: Callable[[], tuple[Fault, ...]]  # active ones of the clock, the network and the ledger
    fatal: Callable[[str], None]  # ends the process with a message


class Mailbox:
    """The latest set-point or measured tip of each sender. Thread-safe."""

    def __init__(self, kind: type[events.Arrived]) -> None:
        self._kind = kind
        self._latest: dict[str, events.Arrived] = {}

    def put(self, payload: bytes, arrival: events.Arrival, sender: str) -> None:
        """Replaces the waiting payload of a sender. Above the limit, drops that of the oldest sender."""
        if len(self._latest) >= MOST_SENDERS and sender not in self._latest:
            self._latest.pop(next(iter(self._latest)), None)
        if (waiting := self._latest.get(sender)) is not None:
            # A stream that began before a stop does not begin anew after it.
            arrival = arrival._replace(number=waiting.arrival.number)
        self._latest[sender] = self._kind(payload, arrival, sender)

    def take(self) -> list[events.Arrived]:
        waiting = [self._latest.pop(sender, None) for sender in list(self._latest)]
        return sorted(filter(None, waiting), key=lambda arrived: arrived.arrival.number)


class PlannerFailed(Exception):
    pass


class Loop:
    """Runs the core. Thread-safe.

    An exception of the core ends the process, because its state may be wrong then. An exception in an action is logged,
    and the next action follows. The link is closed with this object.
    """

    def __init__(
        self,
        core: Core,
        link: ExecutorLink,
        workers: Workers,
        services: Services,
        recorder: FlightRecorder | None = None,
        clocks: tuple[Callable[[], float], Callable[[], float]] = (time.monotonic, time.time),
    ) -> None:
        # Set when the core has ended and the executor has all messages, or the loop does not run.
        self.ended = threading.Event()
        self.ended.set()
        self._core, self._inbox, self._link = core, services.inbox, link
        self._workers, self._services = workers, services
        self.recorder, (self._clock, self._wall) = recorder, clocks
        self._numbers = itertools.count(1)  # of arrivals
        self._alive_at = self._clock()  # time of the last round [s]
        self._stood_still = (-math.inf, -math.inf)  # begin of a standstill, end of its requests' arrival [s]
        self.replies: dict[int, OnReply] = {}
        self.setpoints, self.tips = Mailbox(events.SetpointArrived), Mailbox(events.TipArrived)
        self.look_at, self._stream_until = 0.0, -math.inf  # time of the next look into them [s]
        self._wake, self.warnings_at = 0.0, 0.0  # the core steps once, also while no executor answers
        self._warned: tuple[Fault, ...] = ()
        self._closing = False
        self.thread = threading.Thread(target=self._run, name="planner", daemon=True)

    def start(self) -> None:
        self.ended.clear()
        self.thread.start()

    def end_goals(self) -> None:
        self._inbox.post(Quit())
        self.ended.wait(LAST_RESULTS)

    def close(self, timeout: float = 2.0) -> None:
        """Ends the thread and the connection, and refuses the requests that the core has not answered."""
        self._closing = True
        self._inbox.end_wait()
        if self.thread.ident is not None:
            self.thread.join(timeout)
        for number in list(self.replies):
            self._carry_out(events.Reply(number, refused(Refusal(Reason.SHUTTING_DOWN))))
        self._link.close()

    def arrive(self) -> events.Arrival:
        """Numbers a request, set-point or measured tip. Call it first, in the order of arrival."""
        now = self._note_alive()
        since, until = self._stood_still
        return events.Arrival(next(self._numbers), since if now < until else now)

    def _note_alive(self) -> float:
        """Returns the time; records whether the process stood still until now [s]."""
        now = self._clock()
        if now - self._alive_at > STILL:
            self._stood_still = self._alive_at, now + SETTLES
        self._alive_at = now
        return now

    def request(self, arrival: events.Arrival, key: events.Key, message: events.Message, reply: OnReply) -> None:
        """Posts a request. `reply` is called once, in the loop's thread, and must not wait.

        Simultaneous requests may reach the core in another order than their numbers. A stop, or a cancel without an id,
        goes to the executor before the loop is woken: in a flood of requests, a thread that wakes another one may wait
        for the GIL for some milliseconds.
        """
        number = arrival.number
        self.replies[number] = reply
        self._inbox.events.append(events.Request(arrival, key, message, self._wall()))
        unsent = None
        if key == "stop":
            unsent = self._link.send_now(Stop(number))
        elif isinstance(message, events.CancelMessage) and message.goal is None:
            unsent = self._link.send_now(Cancel(number, None, CANCELED))
        if unsent is not None:
            self._inbox.events.append(events.Unsent(number, unsent))
        self._inbox.wake()

    # --- the thread

    def _run(self) -> None:
        try:
            while not self._closing:
                self.round()
        except PlannerFailed as failure:
            self._services.fatal(str(failure))
        except BaseException as error:  # also SystemExit, which would end the thread silently
            log.critical("the planner failed", exc_info=True)
            self._services.fatal(f"the planner failed: {error!r}")
        finally:
            self.ended.set()

    def round(self) -> None:
        """Waits for events and handles them.

        Posted events come before the link's messages. A request is posted before its stop is sent to the executor. So
        the core knows the request when the executor's answer comes.
        """
        due = min(self._wake, self.warnings_at, self.look_at)
        if self._link.fileno() < 0:
            due = min(due, self._link.retry_at)
        ready = self._inbox.wait(0.0 if self._link.received else max(due - self._clock(), 0.0), self._link)
        self._note_alive()
        self._handle_posted()
        self._link.connect(self._clock())
        if self._link.queue:
            self._link.flush()
        if ready or self._link.received:
            messages = self._link.receive()
            self._handle_posted()
            for message in messages:
                self._step(message)
        now = self._clock()
        if now >= self._wake:
            self._wake = math.inf
            self._step(events.Tick())
        if now >= self.look_at:
            self._look(now)
        if now >= self.warnings_at:
            self.warnings_at = now + WARNINGS_EVERY
            warnings = self._warned
            try:
                warnings = self._services.warnings()
            except Exception:
                log.exception("the warnings are not known")
            if warnings != self._warned:
                self._warned = warnings
                self._step(events.Warned(warnings))
        if self._core.ended and not self._link.queue:
            self.ended.set()

    def _handle_posted(self) -> None:
        for _ in range(len(self._inbox.events)):
            event = self._inbox.events.popleft()
            if isinstance(event, events.Request):  # waiting set-points may have arrived earlier
                self._look(self._clock())
            self._step(event)

    def _look(self, now: float) -> None:
        setpoints, tips = self.setpoints.take(), self.tips.take()
        if setpoints:
            self._stream_until = now + STREAM_ENDS
        self.look_at = now + (STREAM_EVERY if now < self._stream_until else LOOK_EVERY)
        for event in (*setpoints, *tips):
            self._step(event)

    # --- the core

    def _step(self, event: events.Event) -> None:
        """Passes an event to the core and carries out the actions. Raises the core's exceptions, and PlannerFailed."""
        now, wall = self._clock(), self._wall()
        actions: Sequence[events.Action] | None = None
        try:
            actions = self._core.step(event, now, wall)
            for action in actions:
                self._carry_out(action)
        finally:
            self._record(event, now, wall, actions)

    def _record(self, event: events.Event, now: float, wall: float, actions: Sequence[events.Action] | None) -> None:
        """Gives a step to the recorder, until the recorder fails; `actions` are None after an exception."""
        if self.recorder is None:
            return
        try:
            self.recorder(event, now, wall, actions)
            if isinstance(event, events.Tick):  # not after each step: a worker may wait for the GIL
                self.recorder.flush()
        except Exception:
            self.recorder = None
            log.exception("the recording of events has ended")

    def _carry_out(self, action: events.Action) -> None:
        try:
            self._act(action)
        except PlannerFailed:
            raise
        except Exception as error:
            log.exception("the action %s failed", type(action).__name__)
            if isinstance(action, events.Start):  # no worker will answer
                self._inbox.post(events.Answered(action.number, Failed(repr(error)), True))

    def _act(self, action: events.Action) -> None:
        services = self._services
        match action:
            case events.Start(number, task):
                self._workers.start(number, task)
            case events.ToExecutor(message):
                self._link.send(message)
            case events.Reply(number, answer):
                if (reply := self.replies.pop(number, None)) is not None:
                    reply(answer)
                else:
                    log.error("request %d is not known, or was answered before", number)
            case events.Publish(key, published):
                services.out.publish(key, published)
            case events.PublishResult():
                services.out.publish_result(action)
            case events.Record():
                services.ledger.record(action)
            case events.RecordCounts(counts):
                services.ledger.counts(counts)
            case events.Abandon(number):
                self._workers.abandon(number)
            case events.Hurry(number):
                self._workers.hurry(number)
            case events.Disconnect(reason):
                self._link.drop(reason)
            case events.Wake(at):
                self._wake = at
            case Notify(text):
                services.notifier.notify(text)
            case Log(level, text, fields):
                log.log(level, "%s", text, extra={"journal": fields})
            case events.Fail(reason):
                raise PlannerFailed(reason)
