"""The history of the world: what happened at the boards, how often, and what nobody outside can know since then."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from hyperbit.controller.executor.core.events import Event, FromClient
from hyperbit.controller.program import Accepted, Ended, Program, Replaced, Replacement, Snapshot, Trial, Up
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.buses.bus_model import RPDOS
from tests.simulation.statements.account import Account
from tests.simulation.statements.motions import Energised, Switch
from tests.simulation.statements.statement import Statement

LIES = ("lose_sensor", "cut_wires", "short_wires")  # faults of end-stops


class Record(Statement):
    """The history of a world; it sees all facts first, and requires nothing.

    Attributes:
        programs: accepted programs, by instance of the executor and number.
        results: number of the result of each program.
        synced: number of switches of each actuator by SYNCs.
        slack: permitted difference between the journal and `synced`, after a lost frame or an unread board.
        lying: mask of the actuators with frozen end-stops or broken wires.
        fallen: mask of the actuators whose outputs changed without a SYNC, perhaps unknown to the executor.
        suspect: mask of the actuators whose boards have missed a frame since their boot.
    """

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        count = account.arm.count
        self.counts: Counter[str] = Counter()
        self.instance = 0
        self.programs: dict[tuple[int, int], Program | Trial] = {}
        self.results: dict[tuple[int, int], int] = {}
        self.synced, self.slack = [0] * count, [0] * count
        self.suspect = self.fallen = 0
        self.lying = self._lied = 0
        self._mode = "starting"
        self._note = account.world.note
        self._message: object = None

    def started(self) -> None:
        self._note("the executor starts")
        self.instance += 1
        self._mode = "starting"

    def forgets(self) -> None:
        self._note("the switch journal is lost")
        self.synced, self.slack = [0] * len(self.synced), [0] * len(self.slack)

    def killed(self) -> None:
        self._note("the executor is dead")
        self.counts["executors that ended"] += 1

    def told(self, event: Event) -> None:
        self._note(("executor takes", event))
        self._message = event.message if isinstance(event, FromClient) else None

    def raised(self, counts: Sequence[int], journal: Sequence[int]) -> None:
        """Records that the planner's ledger has greater counts than the switch journal: these are valid."""
        if len(counts) == len(journal):
            for k, (count, known) in enumerate(zip(counts, journal, strict=True)):
                self.synced[k] += max(count - known, 0)

    def says(self, message: Up) -> None:
        self._note(("executor says", message))
        self.counts[type(message).__name__] += 1
        match message:
            case Accepted():
                program = self._message
                assert isinstance(program, Program | Trial), "only a program or a trial is accepted"
                self.programs[self.instance, program.program] = program
                self.counts["strict"] += isinstance(program, Program) and program.strict
                self.counts["trials"] += isinstance(program, Trial)
            case Replaced(accepted=True) if isinstance(self._message, Replacement):
                self.counts["parked"] += not self._message.stages
            case Ended():
                self.results.setdefault((self.instance, message.program), message.result)
                self.counts["starved"] += "no further stages" in message.message
                self.counts[message.status] += 1
            case Snapshot():
                if self._mode == "starting" and message.mode == "ready":
                    self.suspect = self.fallen = 0  # the outputs were read back
                self.counts["fault"] += message.mode == "fault" != self._mode
                self._mode = message.mode

    def logs(self, level: int, text: str) -> None:
        self._note(("executor logs", text))

    def leaves(self, bus: str, frame: Frame, missing: int) -> None:
        """Records a sent frame of the executor; the boards of a mask of actuators do not receive it."""
        self._note(("boards hear", bus, frame, f"not those of {missing:b}" if missing else ""))
        if missing and (frame.id == cia301.SYNC or frame.id & 0x780 in RPDOS):
            self.suspect |= missing
        if self.suspect and frame.id == cia301.SYNC:
            for k in range(len(self.slack)):
                self.slack[k] += self.suspect >> k & 1

    def switches(self, switch: Switch) -> None:
        self._note((f"{switch.mask:b} switched to {switch.after:b}", switch.cause))
        by_sync, sync = switch.cause == "SYNC", switch.sync
        for k in range(len(self.synced)):
            self.synced[k] += by_sync and switch.mask >> k & 1
            if sync is not None and by_sync:  # the executor had guessed otherwise, if at all
                self.slack[k] += (switch.mask & sync.homing) >> k & 1
        self.fallen |= switch.mask * (not by_sync)
        self.counts["switches"] += switch.mask.bit_count() * by_sync

    def energises(self, coils: Energised) -> None:
        if coils.again:  # the end-stop of one that did not follow its coil told the other state
            for k in range(len(self.slack)):
                self.slack[k] += coils.again >> k & 1

    def fault(self, verb: str, name: str) -> None:
        if verb in LIES:
            self.lying |= 1 << self.account.arm.labels.index(name)
        elif verb == "restore_sensor":
            self.lying &= ~(1 << self.account.arm.labels.index(name))

    def steps(self) -> None:
        """Permits a difference of the counts where nobody can tell whether an intended switch took place.

        This is so for outputs that went off unnoticed, and for pairs that are off with broken wires of end-stops.
        """
        intended = self.account.world.intended
        if not intended and not self._lied:
            return
        lied = intended & self.lying
        for k in range(len(self.slack)):
            self.slack[k] += ((self.fallen & intended) | (lied & ~self._lied)) >> k & 1
        self.fallen &= ~intended
        self._lied = lied
