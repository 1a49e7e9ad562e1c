"""The judge of the executor's side: takes plain facts in the order in which they happen, and judges each one."""

from __future__ import annotations

import math
from typing import Any

from tests.simulation.judge.account import Account, Commit
from tests.simulation.judge.arm import JudgedArm, mask_of
from tests.simulation.judge.boards import Endings
from tests.simulation.judge.clients import Clients
from tests.simulation.judge.commands import Commands
from tests.simulation.judge.counts import Counts
from tests.simulation.judge.ground import Ground
from tests.simulation.judge.log import Log
from tests.simulation.judge.messages import Messages
from tests.simulation.judge.programs import Programs
from tests.simulation.judge.proofs import Proofs
from tests.simulation.judge.pulses import Pulses
from tests.simulation.judge.reasons import Reasons
from tests.simulation.judge.requests import Requests
from tests.simulation.judge.silence import Silence
from tests.simulation.judge.snapshots import Snapshots
from tests.simulation.judge.streams import Streams
from tests.simulation.judge.traffic import Look, Traffic
from tests.simulation.judge.travels import Travels

NMT, SYNC = 0x000, 0x080
RPDOS = range(0x200, 0x580, 0x100)


class Judge:
    """Judges one executor, its boards and its clients.

    The world calls the methods below as things happen. `quiet_from` and `disturb` tell whether the world works as it
    should: then each fact must be exact. In a disturbed world only what must hold at all times is judged.
    """

    def __init__(self, arm: Any) -> None:
        self.arm = JudgedArm(arm)
        self.ground = Ground(self.arm)
        self.account = Account(self.arm, self.ground)
        self.proofs = Proofs(self.account, arm)
        self.commands = Commands(self.account, arm, self.proofs)
        self.silence = Silence(self.account, self._lose_silent)
        self.snapshots = Snapshots(self.account, self.silence, self.proofs)
        self.travels, self.reasons = Travels(self.account, arm), Reasons(self.account)
        self.programs = Programs(self.account, self.snapshots, self.silence, self.travels, self.reasons, self.proofs)
        self.pulses = Pulses(self.account)
        self.streams = Streams(self.account, self.programs)
        self.requests = Requests(self.account, self.programs, self.snapshots, self.silence, self.reasons)
        self.counts, self.clients = Counts(self.account), Clients(self.account)
        self.messages = Messages(self)
        self._over = False  # whether the process was told to end at once
        self._ticks = False  # whether the event that is handled begins a period
        self._found = 0  # mask of the actuators of unknown state that the last SYNC has energised; each is a switch
        self._asked_to_end: bool | None = None  # at a request to end, whether the arm contracts before
        self.endings = Endings(self.account, arm)
        self.traffic, self.log = Traffic(self.account, arm), Log(self.account, self.endings.lets_go)

    def at(self, now: float) -> None:
        """Sets the time of the next facts [s]."""
        self.account.now = now

    def quiet_from(self, now: float) -> None:
        """Begins a time in which nothing disturbs the world."""
        self.account.clear_since = now

    def looks_at(self, boards: dict[str, Look]) -> None:
        self.traffic.look = self.commands.look = boards

    def disturb(self) -> None:
        """Ends the time in which nothing disturbs the world."""
        self.account.clear_since = math.inf

    def begins(self, instance: int) -> None:
        self.account.instance = instance
        self.endings.begins()
        self._forget()

    def _forget(self) -> None:
        self._ticks, self._asked_to_end, self._over = False, None, False
        self.counts.begin(self.endings.let_go)
        self.account.begin()
        parts = self.snapshots, self.programs, self.streams, self.requests, self.traffic, self.log
        self._commits: dict[str, Commit] = {}  # last one of each bus
        self._unsent: dict[str, Commit] = {}  # of each bus whose last SYNC could not be sent
        self._behind: dict[str, set[int]] = {}  # frames behind a SYNC: each echo tells that the SYNC was sent
        for part in (*parts, self.commands, self.silence, self.clients, self.travels, self.reasons, self.proofs):
            part.begin()

    def dies(self) -> None:
        if self._over and self.account.clear:
            self.programs.ends()
            self.requests.ends()
            self.clients.ends()
            self.counts.ends()
        self.endings.dies()
        self.pulses.dies()
        self._forget()

    def quits(self) -> None:
        self.close_step()
        a = self.account
        if not a.quitting:
            self._asked_to_end = a.arm.contracts_at_end and a.mode in ("ready", "executing") if a.clear else None
        self._over = a.quitting
        self.endings.quits()
        a.quitting = True
        self.commands.hold()
        self.programs.end("quit", "aborted")

    def ticks(self) -> None:
        """A period of the process begins."""
        self.close_step()
        self.account.ticked, self._ticks = self.account.now, True
        self.silence.tick()
        self.snapshots.tick()
        self.programs.tick()
        self.streams.tick()
        self.requests.tick()
        self.endings.tick()
        self.traffic.tick()
        self.counts.tick(self.silence.connected)
        self.clients.tick()
        self.log.tick()
        self.pulses.ticks()

    def close_step(self) -> None:
        if self._asked_to_end is not None:
            self.log.quits(self._asked_to_end)
        elif self._ticks:
            self.log.ticked()
        self._asked_to_end, self._ticks = None, False
        self.requests.close_step()
        self.clients.close_step()

    def other_event(self) -> None:
        """The process takes an event of another kind."""
        self.close_step()

    def echoes(self, bus: str, frame_id: int) -> None:
        self.close_step()
        tells = frame_id == SYNC or frame_id in self._behind.get(bus, ())
        if tells:
            self._behind.pop(bus, None)
        if tells and self.account.commit is not None:
            self.account.commit.awaited.discard(bus)
        if tells and bus in self._commits:
            arm = self.arm
            self.proofs.switched(self._commits[bus], mask_of(k for k in range(arm.count) if arm.bus_of[k] == bus))

    def fails(self, bus: str, frame_id: int) -> None:
        """The process hears that a frame of its own could not be sent; a SYNC may be sent again without RPDOs."""
        self.close_step()
        if frame_id == SYNC and bus in self._commits:
            self._unsent[bus] = self._commits[bus]
            self._commits[bus].awaited.discard(bus)

    def _lose_silent(self) -> None:
        self.snapshots.epoch_causes += self.account.clear
        self.messages.lose_planner()

    def hands_out(self, bus: str, frame_id: int, data: bytes) -> Commit | None:
        """The process hands a frame to a bus; returns the commit of a SYNC."""
        a = self.account
        self.traffic.hands_out(bus, frame_id, data)
        self.proofs.hands_out(bus, frame_id, data)
        self.travels.hands_out(bus, frame_id, data)
        self.counts.hands_out(bus)
        if frame_id & 0x780 in RPDOS:
            if a.commit is None or a.commit.at != a.now:
                a.commit = Commit(a.now, a.believed, unread=self.proofs.unread)
                self.programs.switches_for = a.run
            a.commit.open.add(bus)
            self._commits[bus] = a.commit
            self._unsent.pop(bus, None)
            self.commands.commit(bus, frame_id, data)
        elif frame_id == NMT:
            self.commands.order(bus, data)
        elif frame_id > SYNC and bus in self._behind:
            self._behind[bus].add(frame_id)
        elif frame_id == SYNC:
            self._behind[bus] = set()
            again = self._unsent.pop(bus, None)
            if again is None:
                self.commands.sync(bus)
            else:
                a.commit = again
                self.commands.sync_again(bus)
            assert a.commit is not None
            a.commit.open.discard(bus)
            a.commit.awaited.add(bus)
            return a.commit
        return None

    def misses(self, suspect: int) -> None:
        """Since their boot the boards of a mask of actuators have missed a frame."""
        self.commands.suspect = self.pulses.suspect = suspect

    def drives(self, states: int, mask: int, cause: str, commit: Commit | None = None) -> None:
        """The boards drive actuators of a mask to other ends than before; all states are given."""
        self.ground.drive(self.account.now, states, mask)
        if cause == "SYNC":
            self.commands.switched(states, mask, mask & ~self._found, commit)
            self.account.mover = self.account.commit
            self.programs.switched(mask & ~self._found)
            self.counts.switched(mask & ~self._found)
            self.travels.switched(mask)
            self.traffic.switched()

    def energises(self, on: int, came: int, states: int, cause: str, commit: Commit | None) -> None:
        """The actuators of mask `on` have one of two outputs on, those of `came` since this cause; `states` follow."""
        self.ground.energise(self.account.now, on, came)
        if cause == "SYNC":
            self._found = came & self.account.unknown
            self.commands.energised(states, self._found, commit)
            self.programs.switched(self._found)
            self.counts.switched(self._found & (self.account.believed ^ states))
            self.travels.switched(self._found)
            self.account.unknown &= ~came
            if self._found:
                self.account.mover = self.account.commit  # even if the valves have stayed
        self.pulses.energises(on, came, cause)

    def reads(self, extended: int, contracted: int) -> None:
        """The end-stops read 1 where these masks say so."""
        self.ground.read(self.account.now, extended, contracted)
        self.travels.reads(extended, contracted)
