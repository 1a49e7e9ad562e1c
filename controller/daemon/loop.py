"""The control loop: the one writer of the arm's state and of the bus, and the daemon's modes."""

import logging
import queue
import time
from collections.abc import Callable
from typing import TypeVar

from controller.daemon.avoidance import Avoidance, Kept
from controller.daemon.bringup import BringUp
from controller.daemon.degradation import Degradation
from controller.daemon.events import (
    Cancel,
    Degrade,
    Event,
    Follow,
    Improved,
    Judged,
    KeepOut,
    Payload,
    Planned,
    Prepared,
    Quit,
    Reset,
    Started,
    Stop,
)
from controller.daemon.faultlist import FaultList
from controller.daemon.inbox import Inbox
from controller.daemon.ledger import Ledger
from controller.daemon.line import Line
from controller.daemon.messages import done, refused
from controller.daemon.notify import Notifier
from controller.daemon.runner import Runner
from controller.daemon.state import Mode, Telemetry
from controller.daemon.telling import Teller
from controller.daemon.timekeeping import Timekeeper
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.motion import codes
from controller.motion.codes import Refusal
from controller.motion.pacing import Pace
from controller.obstacles.clearance import Clearance
from controller.obstacles.regions import NONE
from drivers.boards import Boards
from drivers.faults import BusBusy, Fault

log = logging.getLogger(__name__)

T = TypeVar("T")

PERIOD = 0.01  # [s]
RETRY = 1.0  # [s] between two attempts to leave a fault that has passed, and from a fault to the first
DEFECT = Fault("internal-error", "daemon", "internal error, see the journal; the arm holds")


class ControlLoop:
    """Owns boards and modes. Other threads only hand requests over, and read what is public.

    Attributes:
        mode: of the daemon.
        reason: a sentence on the mode.
        accept_after: goals up to this arrival are no longer taken.
        follow_after: nor are streams of setpoints that began up to this one.
        inbox: what the loop is to act on.

    Args:
        manipulator: the arm.
        boards: connected; the loop subscribes to their faults.
        travel: longest time of an actuator from end-stop to end-stop [s].
        publish: sends a payload on "feedback" or "result"; must not wait.
        telemetry: takes snapshots.
        ledger: counts switches and goals.
        notifier: word to systemd.
        arrival: returns the place among all requests of one that came now.
        clock: monotonic time [s].
        inrush: most actuators that may switch at once; None: no bound.
        rest: time that an actuator rests between two travels [s].
        collect: collects garbage; told after each tick, when most of a period is left, whether the loop is idle.
        reachable: whether anybody is connected of those that the daemon was told to connect to.
        degradation: actuators that are held; none if absent.
        avoidance: what is to be kept clear of; nothing if absent.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        boards: Boards,
        travel: float,
        publish: Callable[[str, Payload], None],
        telemetry: Telemetry,
        ledger: Ledger,
        notifier: Notifier,
        arrival: Callable[[], int],
        clock: Callable[[], float] = time.monotonic,
        inrush: int | None = None,
        rest: float = 0.0,
        collect: Callable[[bool], None] = lambda idle: None,
        reachable: Callable[[], bool] = lambda: True,
        degradation: Degradation | None = None,
        avoidance: Avoidance | None = None,
    ) -> None:
        self.mode: Mode = "starting"
        self.reason = "the boards are being brought up"
        self.accept_after = self.follow_after = self._taken = 0
        self.inbox = Inbox()
        self._avoidance = avoidance or Avoidance(Kept(Clearance(manipulator, NONE)))
        pace = Pace(travel + PERIOD, inrush, rest)
        self._runner = Runner(manipulator, boards, travel, pace, publish, ledger, self._avoidance)
        self._boards, self._notifier, self._arrival, self._collect = boards, notifier, arrival, collect
        self._reported: queue.SimpleQueue[Fault] = queue.SimpleQueue()  # apart from the inbox, to come before its rest
        self._degradation = degradation or Degradation(manipulator)
        self._faults = FaultList(frozenset({"stuck"} if self._degradation.continues else ()))
        self._bring_up = BringUp(boards, self.inbox.put)
        self._teller = Teller(boards, self._runner, ledger, telemetry, reachable)
        self._line = Line()
        self._ended = False
        self._next_beat = self._next_try = 0.0
        self._clock, self._time = clock, Timekeeper(PERIOD)
        boards.subscribe(self._reported.put)

    @property
    def commanded(self) -> Configuration | None:
        """Configuration to plan from, None while it is not known."""
        return self._runner.switching.commanded

    @property
    def free_at(self) -> float:
        """From when on the next transition may begin with the last one settled [s on the loop's clock]."""
        return self._runner.switching.free_at

    def may_run(self, arrival: int) -> bool:
        """Returns whether the goal of an arrival is being run, or waits to be; from any thread."""
        if arrival > self._taken:  # read first: a goal is begun before it counts as taken
            return True
        execution = self._runner.execution
        return execution is not None and execution.goal.arrival == arrival

    # --- the loop

    def run(self) -> None:
        """Runs until Quit is handed over; ends with the arm holding and every goal told its result."""
        self.begin()
        while not self._ended:
            self.step()
        self._notifier.send("STOPPING=1")
        self._line.close()
        self._runner.end("aborted", codes.PATH_TOLERANCE_VIOLATED, "the daemon is shutting down; the arm holds")
        if self.mode == "executing":
            self._enter("ready", "holding; the daemon is shutting down")
        self._guarded(self._show, self._clock())

    def begin(self) -> None:
        """Begins to bring the boards up, and makes the first tick due."""
        self._bring_up.begin()
        self._notifier.send("READY=1", f"STATUS={self.mode}: {self.reason}")
        self._time.start(self._clock())

    def step(self) -> None:
        """Acts on the next event, if one comes before the next tick, and ticks if that is due."""
        event = self.inbox.get(self._time.left(self._clock()))
        self._guarded(self._look_back, self._clock())
        if event is not None:
            self._guarded(self._handle, event)
        if isinstance(event, Planned):  # what is due of a fresh goal does not wait for the tick
            self._guarded(self._advance, self._clock())
        began = self._clock()
        if self._time.left(began) <= 0:
            self._guarded(self._tick, began)
            self._guarded(self._tell, began)
            self._time.ticked(began, self._clock())
            self._collect(self.mode == "ready" and not self.inbox.waiting())

    def _guarded(self, work: Callable[[T], None], argument: T) -> None:
        """Does a part of the loop's work: a defect in it must not let go of the arm, which holds and says so."""
        try:
            work(argument)
        except Exception:
            if DEFECT not in self._faults:  # not a hundred times a second
                log.exception("internal error")
            self._fail(DEFECT)

    def _look_back(self, now: float) -> None:
        """Looks, before anything is acted on, whether this process was halted: then what waited for it is stale."""
        if (fault := self._boards.halted(now)) is not None:
            self._fail(fault)

    def _tick(self, now: float) -> None:
        self._boards.tick(now)
        self._advance(now)
        self._recover(now)
        if self._notifier.watchdog and now >= self._next_beat:
            self._notifier.send("WATCHDOG=1")
            self._next_beat = now + self._notifier.watchdog / 4

    def _advance(self, now: float) -> None:
        """Goes on with the goal, or with what is followed."""
        while not self._reported.empty():  # before the goal goes on, which they may concern
            self._fail(self._reported.get())
        self._line.take(self._take)
        states = self._runner.switching.states
        try:
            end = self._runner.advance(now, held=len(self._line) > 0)
        except BusBusy as error:
            self._fail(Fault("bus-busy", "bus", str(error)))
            return
        if end is not None:
            self._enter("ready", end)
        self._teller.changed |= states is not self._runner.switching.states

    def _tell(self, now: float) -> None:
        if self._teller.state_due(now):
            self._show(now)
        if self._teller.diagnostics_due(now):
            self._teller.diagnose(now, self._time.take(), self.inbox.waiting())

    def _show(self, now: float) -> None:
        standing = self._avoidance.faults(self._boards.measured())
        faults = self._faults.all() + self._degradation.faults() + standing
        self._teller.show(now, self.mode, self.reason, faults, self._degradation.held)

    def _handle(self, event: Event) -> None:
        match event:
            case Planned():
                self._line.add(event)
            case Follow():
                self._follow(event)
            case Cancel():
                self._drop_until(event.arrival)
                followed = self._runner.following is not None
                told = self._runner.end("canceled", codes.INVALID_GOAL, "canceled; the arm holds") or followed
                if self.mode == "executing":
                    self._enter("ready", f"holding; {'following' if followed else 'the goal'} was canceled")
                event.reply(done("canceled" if told else "there was no goal to cancel; the arm holds"))
            case Stop():
                self._drop_until(event.arrival)
                self._runner.end("aborted", codes.PATH_TOLERANCE_VIOLATED, "emergency stop; the arm holds")
                self._enter("stopped", "emergency stop; the arm holds until reset")
                event.reply(done("stopped; the arm holds until reset"))
            case Reset():
                self._reset(event)
            case Degrade():
                self._degrade(event)
            case Prepared():
                self._prepared(event)
            case Improved():
                self._line.improve(event)
                self._runner.improve(event.arrival, event.plan, event.kept)
            case KeepOut():
                self._keep_out(event)
            case Judged():
                if (end := self._runner.judged(event)) is not None:
                    self._enter("ready", end)
            case Started():
                self._started(event.faults)
            case Quit():
                self._ended = True

    def _take(self, goal: Planned) -> None:
        """Begins a goal, or refuses it.

        Raises:
            Unknown: which of them is not known yet; nothing was done.
        """
        try:
            if goal.arrival <= self.accept_after:
                raise Refusal(codes.INVALID_GOAL, "a cancel, stop, reset or fault came before it began")
            if self.mode not in ("ready", "executing"):
                raise Refusal(codes.INVALID_GOAL, f"the arm is {self.mode}: {self.reason}")
            stages = self._runner.first(goal)
        except Refusal as refusal:
            self._taken = goal.arrival
            goal.reply(refused(refusal.code, str(refusal), goal.id))
            return
        self._runner.end("replaced", codes.INVALID_GOAL, f"replaced by goal {goal.id}")
        self.follow_after = max(goal.arrival, self.follow_after)
        self._runner.begin(goal, stages, self._clock())
        self._taken = goal.arrival
        self._enter("executing", f"goal {goal.id}")
        message = f"accepted, {len(goal.plan.trajectory.waypoints)} waypoints, {goal.plan.switches} switches planned"
        goal.reply({**done(message), "id": goal.id})

    def _keep_out(self, event: KeepOut) -> None:
        """Keeps clear of something else from now on; nothing moves by that."""
        self._avoidance.kept = event.kept
        event.reply(done(self._avoidance.sentence(self._boards.measured())))
        self._runner.judge(self.inbox.put)

    def _follow(self, wish: Follow) -> None:
        """Follows a moving goal, but none whose stream began before the last request that ended such."""
        if wish.arrival <= self.follow_after or self._clock() > wish.until:
            return
        if self.mode in ("ready", "executing"):
            self._runner.follow(wish)
            if (self.mode, self.reason) != ("executing", wish.reason):
                self._enter("executing", wish.reason)
        else:  # it must begin anew: the arm never moves by itself when a mode is entered
            self.follow_after = wish.arrival

    def _drop_until(self, arrival: int) -> None:
        """Takes no goal or stream any more that began up to an arrival."""
        self.accept_after, self.follow_after = arrival, max(arrival, self.follow_after)

    # --- modes

    def _enter(self, mode: Mode, reason: str) -> None:
        if (mode, reason) != (self.mode, self.reason):
            log.log(logging.WARNING if mode in ("fault", "stopped") else logging.INFO, "%s: %s", mode, reason)
            self._notifier.send(f"STATUS={mode}: {reason}")
        self.mode, self.reason, self._teller.changed = mode, reason, True

    def _fail(self, fault: Fault) -> None:
        """Holds, aborts the goal, and waits for reset; while boards are brought up, the end of that decides."""
        self._faults.add(fault)
        self._degradation.found(fault)
        self._teller.changed = True
        self._runner.end("aborted", codes.PATH_TOLERANCE_VIOLATED, fault.message)
        if self.mode in ("ready", "executing") or (self.mode == "starting" and not self._bring_up.running):
            self._enter_fault(fault.message)

    def _enter_fault(self, reason: str) -> None:
        """Takes no goal that came before the fault, however it is left."""
        self._drop_until(self._arrival())
        self._next_try = self._clock() + RETRY
        self._enter("fault", reason)

    def _recover(self, now: float) -> None:
        """Leaves a fault by itself when nothing else was wrong than a bus or boards not heard, and all are again.

        So it does when actuators were found stuck, if the arm is to go on without them.
        """
        if self.mode != "fault" or now < self._next_try or not self._faults.passing:
            return
        self._next_try = now + RETRY
        if self._boards.back() and not self._boards.moving(now):
            self._begin_anew("the boards are back and are being brought up")

    def _begin_anew(self, reason: str) -> None:
        self._faults.clear()
        self._runner.switching.forget()
        self._enter("starting", reason)
        self._bring_up.begin()

    def _reset(self, event: Reset) -> None:
        if self.mode not in ("fault", "stopped"):
            event.reply(done(f"nothing to reset: the arm is {self.mode}"))
            return
        self._drop_until(event.arrival)
        event.reply(done("resetting; the mode will be ready, or fault with the reason"))
        self._begin_anew("the boards are being brought up after a reset")

    def _started(self, faults: tuple[Fault, ...]) -> None:
        if not self._bring_up.end() or self.mode == "stopped":  # after an emergency stop, reset starts again
            return
        for fault in faults:
            self._faults.add(fault)
        if self._faults:
            self._enter_fault(self._faults.sentence())
            return
        self._go_on()

    # --- actuators that are held

    def _go_on(self) -> None:
        """Holds what is measured; the arm is ready when planning goes by the actuators that are held."""
        degradation = self._degradation
        degradation.settle(self._boards.measured(), self._boards.sensed)
        self._boards.degrade(degradation.held)
        self._boards.hold()
        try:
            self._runner.switching.adopt(self._boards.measured())
        except ValueError as error:
            self._fail(Fault("unknown-state", "arm", f"what the boards measure is no configuration: {error}"))
            return
        if degradation.behind:
            self._drop_until(self._arrival())
            degradation.begin(self.inbox.put)
            self._enter("starting", f"planning is made ready to go on, {degradation.sentence()}")
        else:
            degraded = f", {degradation.sentence()}" if degradation.faults() else ""
            self._enter("ready", f"holding what the boards measured{degraded}")

    def _prepared(self, event: Prepared) -> None:
        """Goes on when planning goes by the actuators that are held; what came before was planned by others."""
        self._degradation.end(event)
        if event.fault is not None:
            self._fail(event.fault)
        elif self.mode == "starting" and not self._bring_up.running:
            self._drop_until(self._arrival())
            self._go_on()

    def _degrade(self, event: Degrade) -> None:
        """Holds an actuator from now on, or uses it again; nothing moves by that."""
        objection = self._degradation.objection(event.wish, self._boards.measured(), self._boards.sensed)
        if self.mode == "executing" or self._boards.moving(self._clock()):
            objection = f"the arm is {self.mode}, and may not be while what is held changes: cancel, then try again"
        if objection is not None:
            event.reply(refused(codes.INVALID_GOAL, objection))
            return
        self._degradation.take(event.wish)
        waits = self.mode in ("fault", "stopped")
        event.reply(done(f"{self._degradation.sentence()}{', from the reset on' if waits else ''}"))
        if self.mode == "ready" or (self.mode == "starting" and not self._bring_up.running):
            self._go_on()
