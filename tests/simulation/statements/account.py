"""The account of a world: pins, frames, messages and faults with their times. All statements are judged over it."""

from __future__ import annotations

import math
from collections import deque
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
    Up,
    Welcome,
    unpack,
)
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, FrameReceived
from tests.simulation.buses.bus_model import RPDOS, TPDOS
from tests.simulation.executor.witness import Witness
from tests.simulation.facts import Energised, Switch
from tests.simulation.statements.arm import JudgedArm, bits_of, merged
from tests.simulation.statements.motions import Motion, Pins, Sync
from tests.simulation.statements.statement import Statement, Statements

if TYPE_CHECKING:
    from tests.simulation.world import World

REMEMBERED = 100  # pins and readings
REACHED = 0.005  # [s] from a change of an input to the arrival of its TPDO


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
        pins: the present ones, after all earlier ones that are remembered.
        switched_at: when pins of each actuator changed last [s].
        changed_at: when its end-stops changed last [s].
        opened_at: when a door was opened [s]; infinity if all are closed.
        open_known_at: when inputs of its board have reached the executor since; infinity before [s].
        knows_open: whether they have.
        heard_at: by board, when a frame of it reached this process last [s].
        clear_since: time since when nothing disturbs the world; infinity while something does [s].
        instance: number of the executor's process.
        instance_at: time of its start [s].
        roles: roles of the welcomed clients.
        planner: the welcomed planner; None without one.
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
        missed: mask of the actuators whose boards have missed a frame since their boot; where nobody reads the outputs
            back, since their last switch.
        fallen: mask of the actuators whose outputs changed without a SYNC since the boot.
    """

    def __init__(self, world: World) -> None:
        self.world, self.arm = world, JudgedArm(world.arm)
        self.statements = Statements(())
        self.pins = deque([Pins(-math.inf, 0, 0, 0, 0)], maxlen=REMEMBERED)
        self.switched_at = [-math.inf] * self.arm.count
        self.changed_at = [-math.inf] * self.arm.count
        self.opened_at, self.open_known_at, self.instance_at = math.inf, math.inf, -math.inf
        self._locks = {f"{lock.bus}/{lock.node}" for lock in world.arm.wiring.interlocks}
        self.clear_since = math.inf
        self.instance = self.missed = self.fallen = self.order = self.questions = 0
        self.ordered: dict[str, object] = {}
        self._begin()

    def judge(self, every: Iterable[Statement]) -> None:
        self.statements = Statements(every)

    def see(self, kind: str, *facts: Any) -> None:
        """Shows a fact of a kind to the statements that look at it."""
        self.statements.see(kind, facts)

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

    def due(self, k: int) -> float:
        """Returns when an actuator has arrived at the latest, by its travel time [s]."""
        return self.switched_at[k] + self.arm.travel[k][self.pins[-1].states >> k & 1]

    @property
    def arrived(self) -> int:
        """Mask of the actuators whose end-stop at the end to which they are driven tells that they are there."""
        pins, arm = self.pins[-1], self.arm
        extended = pins.states & arm.extended_ends & pins.extended
        return extended | ~pins.states & arm.contracted_ends & pins.contracted

    def elsewhere(self, states: int) -> int:
        """Returns the mask of the actuators that are not in `states`: with no coil on, an end-stop may tell it."""
        pins, arm = self.pins[-1], self.arm
        read = arm.measured(pins.extended, pins.contracted, pins.states)
        return (states ^ pins.states) & ((states ^ read) | ~arm.paired | pins.on)

    def since(self, at: float) -> list[Pins]:
        """Returns all pins that held at a time or later, the newest first."""
        found: list[Pins] = []
        for pins in reversed(self.pins):
            found.append(pins)
            if pins.at <= at:
                break
        return found

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
        self.knows_open = self.questioned = self.ordered_end = False
        self.ordered.clear()
        self.held, self.held_states = self.arm.declared
        self.running: Motion | None = None
        self.followed: list[Motion] = []
        self._commanded: dict[str, Sync] = {}  # RPDOs of each bus that were handed out last

    # --- the executor's process

    def started(self) -> None:
        self.see("started")
        self.instance += 1
        self.instance_at = self.now
        self._begin()

    def killed(self) -> None:
        self.see("killed")
        self._begin()

    def hurries(self) -> None:
        self.see("hurries")

    def told(self, event: Event) -> None:
        self.order += 1
        self.see("told", event)
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
                    self.bar()
            case Quit():
                self.ordered_end, self.quitting = self.quitting, True
                self.bar()
            case FrameReceived(bus, frame):
                self._hear(bus, frame)
            case BusChanged(_, "bus-off" | "down"):  # its boards are lost, and so is what they told of doors
                self.open_known_at, self.knows_open = math.inf, False
            case _:
                pass

    def _hear(self, bus: str, frame: Frame) -> None:
        name = f"{bus}/{frame.id & 0x7F}"
        self.heard_at[name] = self.now
        if name in self._locks and frame.id & 0x780 in TPDOS and self.now > self.opened_at + REACHED:
            self.open_known_at, self.knows_open = min(self.open_known_at, self.now), True

    @property
    def greets_planner(self) -> bool:
        """Whether the executor handles the Hello of a planner."""
        return isinstance(self.message, Hello) and self.message.role == "planner"

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
            case _:
                pass

    def bar(self) -> None:
        """Takes the permission to move from all that was asked for so far."""
        for motion in self.wanted:
            motion.barred_at = min(motion.barred_at, self.now)
        self.followed = []

    def says(self, message: Up) -> None:
        self.see("says", message)
        match message:
            case Accepted() if isinstance(self.message, Program):
                self.running, self.questioned = Motion(self.message, self.order, message.begin), False
                self.programs[message.program] = self.running
                self.followed = []
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
                    self.missed, self.fallen = self.missed & self.arm.forgone, 0
                    self.booted = True
                self.shown, self.epoch = message, message.epoch
                self.followed = [one for one in self.followed if one.number >= message.stream]
            case _:
                pass

    def tells(self, client: ClientId, message: Up) -> None:
        self.see("tells", client, message)
        lock = self.message
        if isinstance(message, Answer) and message.accepted and isinstance(lock, Lock) and client == self.planner:
            bit, on = 1 << lock.actuator, -1 if lock.state > 0 else 0
            self.held = self.held & ~bit | (bit if lock.state >= 0 else 0)
            self.held_states = merged(bit, on, self.held_states)
        if isinstance(message, Welcome):
            self.roles[client] = self._hellos[client]
            if self.roles[client] == "planner":
                self.planner = client

    def logs(self, level: int, text: str) -> None:
        self.see("logs", level, text)

    def notifies(self, text: str) -> None:
        self.see("notifies", text)

    # --- buses and boards

    def sends(self, bus: str, frame: Frame) -> object:
        self.see("sends", bus, frame)
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
            return commanded._replace(at=self.now, asked=asked)
        return None

    def leaves(self, bus: str, frame: Frame, missing: int) -> None:
        """A frame of the executor is on the bus; the boards of a mask of actuators miss it."""
        self.see("leaves", bus, frame, missing)
        if missing and (frame.id == cia301.SYNC or frame.id & 0x780 in RPDOS):
            self.missed |= missing

    def answers(self, bus: str, frame: Frame) -> None:
        """A board sends a frame."""
        self.see("answers", bus, frame)

    def drives(self, states: int) -> None:
        """Takes the ends to which the actuators are driven at the begin of the world."""
        self.pins.append(self.pins[-1]._replace(states=states))

    def switches(self, switch: Switch) -> None:
        """Actuators of one bus are driven to other ends."""
        self.see("switches", switch)
        for k in bits_of(switch.mask):
            self.switched_at[k] = self.now
        self.fallen |= switch.mask * (switch.cause != "SYNC")
        self.missed &= ~(switch.mask & self.arm.forgone)
        last = self.pins[-1]
        self.pins.append(last._replace(at=self.now, states=merged(switch.mask, switch.after, last.states)))

    def energises(self, coils: Energised) -> None:
        """Coils of one bus came on or went off."""
        self.see("energises", coils)
        for k in bits_of(coils.came):
            self.switched_at[k] = self.now
        last = self.pins[-1]
        of_bus = sum(1 << k for k, bus in enumerate(self.arm.bus_of) if bus == coils.bus)
        self.pins.append(last._replace(at=self.now, on=merged(of_bus, coils.on, last.on)))

    def reads(self, extended: int, contracted: int) -> None:
        """The end-stops of these masks read 1."""
        self.see("reads", extended, contracted)
        last = self.pins[-1]
        for k in bits_of((last.extended ^ extended) | (last.contracted ^ contracted)):
            self.changed_at[k] = self.now
        self.pins.append(self.pins[-1]._replace(at=self.now, extended=extended, contracted=contracted))

    def fault(self, verb: str, name: str) -> None:
        """Something breaks at the boards, or is mended."""
        self.see("fault", verb, name)
        if verb == "open":
            self.opened_at = min(self.opened_at, self.now)
        elif verb == "close" and self.world.boards.opened <= {name}:
            self.opened_at, self.open_known_at, self.knows_open = math.inf, math.inf, False

    # --- the world

    def steps(self) -> None:
        self.see("steps")

    def rests(self) -> None:
        """All trouble has ended, and the arm is at rest: from now on nothing disturbs the world."""
        self.see("rests")
        self.clear_since = self.now

    def disturbed(self) -> None:
        """Something may disturb the world from now on."""
        self.clear_since = math.inf
