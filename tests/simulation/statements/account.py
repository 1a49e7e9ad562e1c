"""The account of a world: pins, frames, messages and faults with their times. All statements are judged over it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from hyperbit.controller.executor.core.events import ClientGone, ClientId, Event, FromClient
from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import (
    Accepted,
    Acknowledge,
    Answer,
    Begun,
    Cancel,
    Clearance,
    Counts,
    Ended,
    Hello,
    Lock,
    Program,
    Question,
    Replaced,
    Replacement,
    Setpoint,
    Settled,
    Snapshot,
    Stop,
    Trial,
    Up,
    Welcome,
    unpack,
)
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, FrameReceived
from tests.simulation.buses.bus_model import RPDOS
from tests.simulation.statements.arm import JudgedArm, merged
from tests.simulation.statements.motions import Energised, Motion, Switch, Sync
from tests.simulation.statements.pin_record import Doors, PinRecord
from tests.simulation.statements.statement import Statement, Statements, Witness

if TYPE_CHECKING:
    from tests.simulation.world import World


class Account(Witness):
    """What happened in a world. A fact has a kind, and the statements see it by the method of this name:

    started(), killed(): a process of the executor.
    told(event): the executor takes an event of bus, client or loop.
    says(message), tells(client, message): it sends a message, once; to each client.
    sends(bus, frame): it hands out a frame. leaves(bus, frame, missing): the frame is on the bus; the boards of a mask
    of actuators miss it. answers(bus, frame): a board sends a frame.
    switches(switch), energises(coils), reads(): pins and end-stops change.
    fault(verb, name): something breaks at the boards, or is mended.
    logs(level, text), notifies(text).
    steps(): a step of the world is over. rests(): all trouble has ended, and the arm is at rest.

    Attributes:
        arm: what its file says.
        pins: what boards drive and end-stops read.
        doors: whether the executor must know that one is open.
        heard_at: by board, when a frame of it reached this process last [s].
        clear_since: time since when nothing disturbs the world; infinity while something does [s].
        instance: number of the executor's process.
        instance_at: time of its start [s].
        roles: roles of the welcomed clients.
        planner: the welcomed planner, or the commissioner in its place; None without one.
        commissioned: whether a commissioner is in its place.
        shown: the latest snapshot of this process.
        epoch: the latest that was told.
        booted: a boot of this process has ended: it knows what the boards drive.
        order: number of the events that executors took so far.
        owed: results of this process that the planner has not acknowledged, by number.
        questions: number of the questions to planners so far.
        held: mask of the actuators that the file or a request has locked in their `held_states`.
        ordered: NMT state of each board before the first NMT command of this process to it.
        quitting: the process was asked to end in order.
        ordered_end: its end has come.
        questioned: a question to the planner is open.
        programs: accepted programs of this process by number.
        running: the last of them, until its result.
        followed: set-points that may be followed.
    """

    def __init__(self, world: World) -> None:
        self.world, self.arm = world, JudgedArm(world.arm)
        self.statements = Statements(())
        self.pins = PinRecord(self.arm, world.agenda)
        self.doors, self.instance_at = Doors(world.arm), -math.inf
        self.clear_since = math.inf
        self.instance = self.order = self.questions = 0
        self.ordered: dict[str, object] = {}
        self._begin()

    def judge(self, every: Iterable[Statement]) -> None:
        self.statements = Statements(every)

    def see(self, kind: str, *facts: Any) -> Any:
        """Shows a fact of a kind to the statements that look at it, then takes it."""
        self.statements.see(kind, facts)
        return super().see(kind, *facts)

    @property
    def now(self) -> float:
        return self.world.agenda.now

    @property
    def clear(self) -> bool:
        """Whether nothing disturbs the world, and nothing has since the arm was at rest."""
        return self.now >= self.clear_since

    @property
    def mode(self) -> str:
        return "starting" if self.shown is None else self.shown.mode

    @property
    def homing(self) -> int:
        """Mask of the actuators of unknown state, as told."""
        return 0 if self.shown is None else unpack(self.shown.homing)

    @property
    def known(self) -> int:
        """Mask of the actuators whose states are known, as told."""
        return 0 if self.shown is None else unpack(self.shown.known)

    @property
    def locked(self) -> int:
        """Mask of the locked actuators, as told."""
        return self.arm.declared[0] if self.shown is None else unpack(self.shown.locked)

    @property
    def wanted(self) -> list[Motion]:
        """What may move the arm now: the running program, or the followed set-points."""
        return [*self.followed, *([self.running] if self.running else [])]

    def _begin(self) -> None:
        """Forgets the last process."""
        self.roles: dict[ClientId, str] = {}
        self._hellos: dict[ClientId, str] = {}
        self.planner: ClientId | None = None
        self.shown: Snapshot | None = None
        self.epoch, self.quitting, self.booted, self.message = 0, False, False, None
        self.programs: dict[int, Motion] = {}
        self.owed: dict[int, Ended] = {}
        self.heard_at: dict[str, float] = {}
        self.questioned = self.ordered_end = False
        self.ordered.clear()
        self.doors.forget()
        self.held, self.held_states = self.arm.declared
        self.running: Motion | None = None
        self.followed: list[Motion] = []
        self._commanded: dict[str, Sync] = {}  # RPDOs of each bus that were handed out last

    # --- the executor's process

    def started(self) -> None:
        self.instance += 1
        self.instance_at = self.now
        self._begin()

    def killed(self) -> None:
        self._begin()
        self.arm.believe(True)

    def told(self, event: Event) -> None:
        self.order += 1
        match event:
            case FromClient(client, message):
                self.message: Any = message
                if isinstance(message, Hello) and client not in self.roles:
                    self._hellos[client] = message.role
                elif client in self.roles:
                    self._take(client, message)
            case ClientGone(client):
                self.roles.pop(client, None)
                if client == self.planner:
                    self.planner = None
                    self.arm.believe(True)
                    self.bar()
            case Quit():
                self.ordered_end, self.quitting = self.quitting, True
                self.bar()
            case FrameReceived(bus, frame):
                self.heard_at[f"{bus}/{frame.id & 0x7F}"] = self.now
                self.doors.hear(bus, frame, self.now)
            case BusChanged(_, "bus-off" | "down"):  # its boards are lost, and so is what they told of doors
                self.doors.forget()

    @property
    def greets_planner(self) -> bool:
        """Whether the executor handles the Hello of a planner."""
        return isinstance(self.message, Hello) and self.message.role != "operator"

    @property
    def commissioned(self) -> bool:
        return self.planner is not None and self.roles[self.planner] == "commissioner"

    def _take(self, client: ClientId, message: Any) -> None:
        match message:
            case Stop():
                self.bar()
            case Cancel(program=None) if client == self.planner:
                self.bar()
            case Cancel(program=number) if client == self.planner and self.running is not None:
                if self.running.number == number:
                    self.running.barred_at = self.now
            case Clearance() if client == self.planner:
                self.questioned = False
            case Counts() if client == self.planner:
                self.world.record.raised(message.counts, self.world.executor.journal.counts)
            case Acknowledge() if client == self.planner:
                self.owed.pop(message.result, None)
            case Setpoint() if client == self.planner and message.epoch >= self.epoch:
                self.followed.append(Motion(message, self.order, self.now))

    def bar(self) -> None:
        """Takes the permission to move from all that was asked for so far."""
        for motion in self.wanted:
            motion.barred_at = min(motion.barred_at, self.now)
        self.followed = []

    def says(self, message: Up) -> None:
        match message:
            case Accepted() if isinstance(self.message, Program):
                self.running, self.questioned = Motion(self.message, self.order, message.begin), False
                self.programs[message.program] = self.running
                self.followed = []
            case Accepted() if isinstance(self.message, Trial) and self.shown is not None:
                outputs = unpack(self.shown.outputs)
                self.running, self.followed = Motion.of_trial(self.message, outputs, self.order, message.begin), []
                self.programs[message.program] = self.running
            case Replaced(accepted=True) if self.running is not None and isinstance(self.message, Replacement):
                self.running.append(self.message.first, self.message.stages)
                self.questioned = False
                self.running.final, self.running.strict = self.message.final, self.running.strict or self.message.strict
            case Begun() if message.program in self.programs:
                motion = self.programs[message.program]
                motion.taken, motion.unsettled = message.stage, motion.stages[message.stage].mark >= 0
            case Settled() if message.program in self.programs:
                self.programs[message.program].unsettled = False
            case Ended() if message.program in self.programs:
                self.owed[message.result] = message
                motion = self.programs[message.program]
                motion.ended = message
                if motion is self.running:
                    self.running, self.questioned = None, False
            case Question():
                self.questions += 1
                self.questioned = True
            case Snapshot():
                if message.epoch > self.epoch or message.mode not in ("ready", "executing"):
                    self.bar()
                if self.mode == "starting" and message.mode == "ready":  # the outputs were read back
                    self.pins.booted()
                    self.booted = True
                self.shown, self.epoch = message, message.epoch
                self.followed = [one for one in self.followed if one.number >= message.stream]

    def tells(self, client: ClientId, message: Up) -> None:
        lock = self.message
        if isinstance(message, Answer) and message.accepted and isinstance(lock, Lock) and client == self.planner:
            bit, on = 1 << lock.actuator, -1 if lock.state > 0 else 0
            self.held = self.held & ~bit | (bit if lock.state >= 0 else 0)
            self.held_states = merged(bit, on, self.held_states)
        if isinstance(message, Welcome):
            self.roles[client] = self._hellos[client]
            if self.roles[client] != "operator":
                self.planner = client
                self.arm.believe(not self.commissioned)

    # --- buses and boards

    def sends(self, bus: str, frame: Frame) -> object:
        if frame.id & 0x780 in RPDOS:
            asked = [(motion, motion.due(self.now)) for motion in self.wanted]
            number = None if self.running is None else self.running.number
            strict = self.running is not None and self.running.strict
            self._commanded[bus] = Sync(self.now, self.now, number, strict, self.homing, asked)
        elif frame.id == cia301.NMT and frame.data[1:]:
            name = f"{bus}/{frame.data[1]}"
            if name in self.world.boards.simulated.names:
                self.ordered.setdefault(name, self.world.boards.simulated.board(name).state)
        elif frame.id == cia301.SYNC and (commanded := self._commanded.get(bus)) is not None:
            asked = [(motion, stages) for motion, stages in commanded.asked if motion.barred_at == math.inf]
            # An RPDO that a program has left on the board may serve the next program.
            number = commanded.program if self.running is None else self.running.number
            return commanded._replace(at=self.now, asked=asked, program=number)
        return None

    def leaves(self, bus: str, frame: Frame, missing: int) -> None:
        """A frame of the executor is on the bus; the boards of a mask of actuators miss it."""
        if missing and (frame.id == cia301.SYNC or frame.id & 0x780 in RPDOS):
            self.pins.missed |= missing

    def switches(self, switch: Switch) -> None:
        """Actuators of one bus are driven to other ends."""
        self.pins.switch(switch)

    def energises(self, coils: Energised) -> None:
        """Coils of one bus came on or went off."""
        self.pins.energise(coils)

    def reads(self, extended: int, contracted: int) -> None:
        """The end-stops of these masks read 1."""
        self.pins.read(extended, contracted)

    def fault(self, verb: str, name: str) -> None:
        """Something breaks at the boards, or is mended."""
        if verb == "open":
            self.doors.open(self.now)
        elif verb == "close" and self.world.boards.opened <= {name}:
            self.doors.close_all()

    # --- the world

    def rests(self) -> None:
        """All trouble has ended, and the arm is at rest: from now on nothing disturbs the world."""
        self.clear_since = self.now

    def disturbed(self) -> None:
        """Something may disturb the world from now on."""
        self.clear_since = math.inf
