"""Statements on pins: why they change, and what they never do."""

from __future__ import annotations

import math

from hyperbit.controller.executor.core.events import ClientId, Event, FromClient
from hyperbit.controller.program import TICK, Answer, Cancel, Stop, Up, unpack
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.buses.board_side import FOREIGN_START
from tests.simulation.statements.account import Account
from tests.simulation.statements.arm import bits_of
from tests.simulation.statements.motions import EPSILON, Energised, Switch
from tests.simulation.statements.statement import Statement

ROUNDED = 0.01  # [s] by which boards round their time-out
LONGER = 0.1  # [s] that a pulse may be too long if its board has missed a frame: until it is read back


class PinsHaveACause(Statement):
    """Each change of a pin has a cause: SYNC of a stage that was asked for, `on_loss`, `on_stop`, supply, a boot."""

    number = 1

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._heard_at = [-math.inf] * account.arm.count  # last heartbeat of the executor at each actuator's board [s]
        self._guarded_at = [math.inf] * account.arm.count  # last remote frame to it, if it is guarded [s]

    def leaves(self, bus: str, frame: Frame, missing: int) -> None:
        arm, now = self.account.arm, self.account.now
        if frame.id == cia301.HEARTBEAT + 127:
            for k, of in enumerate(arm.bus_of):
                if of == bus and not missing >> k & 1:
                    self._heard_at[k] = now
        elif frame.id & cia301.REMOTE:
            for k, board in enumerate(arm.board_of):
                if board == f"{bus}/{frame.id & 0x7F}" and not missing >> k & 1:
                    self._guarded_at[k] = now

    def switches(self, switch: Switch) -> None:
        account, text = self.account, f"{switch.mask:b} switched to {switch.after:b} by {switch.cause}"
        if switch.cause == "SYNC":
            self._find_cause(switch, text)
        elif switch.cause == "time":
            heard = max(min(self._heard_at[k], self._guarded_at[k]) for k in bits_of(switch.mask))
            lost = account.now - heard >= account.arm.timing.heartbeat_timeout - ROUNDED
            self.require(lost, lambda: f"{text}, {account.now - heard:g} s after a heartbeat")
        elif switch.cause.startswith(("frame 6", "frame 000h")):  # the boot of a board that left operational
            off = account.mode in ("starting", "stopped") and not switch.mask & switch.after
            self.require(off, lambda: f"{text} in mode {account.mode}")
        else:
            self.require(switch.cause in ("START", "fault", FOREIGN_START), text)

    def _find_cause(self, switch: Switch, text: str) -> None:
        account, sync, shown = self.account, switch.sync, self.account.shown
        unsure = account.pins.missed | (0 if shown is None else unpack(shown.homing) | unpack(shown.locked))
        sure = switch.mask & ~unsure
        stages = [states for _, due in sync.asked for states in due] if sync is not None else []
        if account.quitting and account.arm.contracts_at_end:
            stages.append(0)
        asked = any(not (switch.after ^ states) & sure for states in stages)
        loose = switch.mask & account.held & ~account.pins.missed & (switch.after ^ account.held_states)
        loose &= switch.after ^ account.arm.measured(*account.pins.now[3:], account.held_states)
        self.require(not loose, f"{text}; {loose:b} are locked")
        self.require(asked or not sure, lambda: f"{text}; asked for are {[f'{states:b}' for states in stages]}")


class AStopIsABarrier(Statement):
    """After the answer to a stop or cancel no frame that moves leaves for what arrived before it."""

    number = 2

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._asked: dict[tuple[ClientId, int], int] = {}  # order of the arrival of each stop and cancel
        self._barrier = -1

    def started(self) -> None:
        self._asked, self._barrier = {}, -1

    def told(self, event: Event) -> None:
        match event:
            case FromClient(client, Stop() as message):
                self._asked[client, message.request] = self.account.order
            case FromClient(client, Cancel(program=None) as message):
                self._asked[client, message.request] = self.account.order

    def tells(self, client: ClientId, message: Up) -> None:
        if isinstance(message, Answer) and (client, message.request) in self._asked:
            order = self._asked.pop((client, message.request))
            if "the bus has not sent" not in message.message:  # else the answer tells what still switches
                self._barrier = max(self._barrier, order)

    def switches(self, switch: Switch) -> None:
        sync = switch.sync
        if switch.cause == "SYNC" and sync is not None and sync.asked and self._barrier >= 0:
            newest = max(motion.order for motion, _ in sync.asked)
            self.require(
                newest > self._barrier, f"{switch.mask:b} switched for motion {newest} after stop {self._barrier}"
            )


class CoilsEndInTime(Statement):
    """Never are both coils on; a pulse ends two periods late at most, while its board hears the executor.

    One period is until the next tick, the other one for a commit under way. A pulse may be told as overdue instead. A
    boot after that tells so again only if it fails.
    """

    number = 7

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._since: dict[int, float] = {}  # when a coil of each actuator came on [s]
        self._away: dict[int, float] = {}  # time since then in which the executor could not end it [s]
        self._told = set[int]()  # those that were on when an overdue pulse was told
        self._looked_at = 0.0

    @property
    def _overdue(self) -> bool:
        shown = self.account.shown
        return shown is not None and any(fault.code == "pulse-overdue" for fault in shown.faults)

    def energises(self, coils: Energised) -> None:
        both = self.account.world.boards.both_on()
        self.require(not any(both), f"both coils of an actuator were on: {both}")
        of_bus = [k for k, bus in enumerate(self.account.arm.bus_of) if bus == coils.bus]
        for k in of_bus:
            if not coils.on >> k & 1:
                self._since.pop(k, None)
                self._told.discard(k)
            if coils.came >> k & 1:
                self._since[k], self._away[k] = self.account.now, 0.0

    def steps(self) -> None:
        account, pulses = self.account, self.account.arm.pulse
        passed, self._looked_at = account.now - self._looked_at, account.now
        for k, since in self._since.items():
            if k not in pulses:
                continue
            if self._overdue:
                self._told.add(k)
            booting = k in self._told and account.mode == "starting"
            if not account.booted or not account.world.reaches(k) or self._overdue or booting:
                self._away[k] += passed
            late = account.now - since - pulses[k] - self._away[k]
            longest = 2 * TICK + LONGER * (account.pins.missed >> k & 1)
            self.require(late <= longest + EPSILON, f"a coil of actuator {k} is on {late:g} s too long")


class CoilsComeOnByASync(Statement):
    """A coil comes on only by a SYNC, or where its board contracts its actuator without the executor."""

    number = 7

    def energises(self, coils: Energised) -> None:
        account = self.account
        came = coils.came & ~account.pins.missed & ~account.world.let_go
        if came and coils.cause != FOREIGN_START:
            self.require(coils.cause == "SYNC", f"the coils {came:b} came on by {coils.cause}")


class FewSwitchAtOnce(Statement):
    """At most `inrush` actuators switch at once; with a limit, or a rest, each waits for the travels before."""

    number = 7

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._commanded_at, self._switched = -math.inf, 0
        self._settles_at = -math.inf  # when the stage before has settled [s]
        self._settles = self._settles_at  # when the present one has
        self._rested = [-math.inf] * account.arm.count  # when each actuator may switch again [s]

    def switches(self, switch: Switch) -> None:
        if switch.cause == "SYNC" and switch.sync is not None:
            self._look(switch.mask & ~self.account.pins.missed, switch.after, switch.sync.commanded_at)

    def _look(self, mask: int, after: int, commanded_at: float) -> None:
        arm, now = self.account.arm, self.account.now
        if commanded_at != self._commanded_at:
            self._commanded_at, self._switched, self._settles_at = commanded_at, 0, self._settles
        self._switched |= mask
        self.require(self._switched.bit_count() <= arm.most, f"{self._switched:b} switch at once")
        if arm.limited and mask:
            self.require(now >= self._settles_at - EPSILON, f"{mask:b} switch before the stage before has settled")
        for k in bits_of(mask):
            travel = arm.travel[k][after >> k & 1]
            if arm.rest:
                self.require(now >= self._rested[k] - EPSILON, f"actuator {k} has not rested")
            self._rested[k], self._settles = now + travel + arm.rest, max(self._settles, now + travel)


class NoStartChangesAPin(Statement):
    """The NMT command START of the executor changes no output."""

    number = 8

    def leaves(self, bus: str, frame: Frame, missing: int) -> None:
        self.armed += frame.id == cia301.NMT and frame.data[:1] == bytes([cia301.Command.START])

    def switches(self, switch: Switch) -> None:
        if switch.cause == "START":
            self.require(False, f"START switched {switch.mask:b} to {switch.after:b}")

    def energises(self, coils: Energised) -> None:
        if coils.cause == "START":
            self.require(False, f"START switched on the coils {coils.came:b}")
