"""Actuation: the single owner of output commands, pulses, the inrush limit, rest times and switch counts."""

import math

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.kinds import Kinds, indices, mask_of, merged
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.drivers.canopen.faults import ArmFault, Busy
from hyperbit.drivers.canopen.run.master import Master

BUSY_FOR = 0.25  # [s]; a bus that accepts no command for longer is a fault
LATE = 0.1  # [s] after its end a pulse is overdue. Nothing waits for it any longer: its bus accepts no frames
EARLY = 0.004  # [s] by which a pulse may end early; otherwise a slow bus could add a whole period


class Actuation:
    """Switches the outputs of the boards.

    `tick` switches a pulsed output off when its pulse ends, in every mode. The state of an actuator with two outputs is
    uncertain while both outputs are off and the last one that was on is unknown. This happens after a start of the
    executor, after a restart of the board, and after a pulse that was over before it was read back. After a boot it is
    uncertain if nobody reads the board back (`verify: false`), and the board was not heard since the pulse.
    """

    def __init__(self, master: Master, arm: ExecutedArm, kinds: Kinds, journal: SwitchJournal) -> None:
        self.free_at = 0.0  # when the last switched actuator has settled, by its travel time [s]
        self.target: int | None = None  # states of the running commit; None if no commit runs
        self.uncertain = kinds.paired  # mask of the actuators of unknown state; their bits of `states` are guesses
        self.missed = 0  # mask of uncertain actuators whose last pulse was not confirmed
        self.switches = 0  # number of switches since the executor started
        # set if the bus accepted no command for BUSY_FOR; cleared by the caller that reports it
        self.fault: ArmFault | None = None
        self._master, self._arm, self._kinds, self._journal = master, arm, kinds, journal
        self._arrives_at = [-1e12] * len(arm.actuators)
        self._states = 0  # last states, valid for paired actuators with both outputs off
        self._adopted: int | None = None  # states as adopted or switched since; None before the first adoption
        # when a bus accepted no command for the first time [s]; None: nothing waits to be switched
        self.busy_since: float | None = None
        self._pulse_ends = dict.fromkeys(kinds.pulse, -math.inf)
        self._watched = 0  # mask of the actuators without a confirmed end of their pulse
        self.told = 0  # mask of the actuators reported as overdue
        self._adopted_at = -math.inf
        self._doubtful = 0  # mask of the paired actuators that the running commit energises
        self._unheard: dict[int, int | None] = {}  # actuators whose pulse nobody reads back; frames of the board then
        self._given_up = False  # the running commit is not wanted any more
        self._boots: tuple[int, ...] = ()  # boot count of each board when the outputs were adopted

    @property
    def states(self) -> int:
        """The states that the outputs command, or commanded before a pulse ended."""
        return self._kinds.states(self._master.outputs, self._states)

    @property
    def under_way(self) -> int:
        """Mask of the actuators that frames under way will switch."""
        leaving = self._master.leaving
        if not leaving:
            return 0
        outputs = self._master.outputs ^ leaving
        extending, contracting = self._kinds.on(outputs & leaving)
        energised = (extending ^ contracting) & self._kinds.paired
        return (self._kinds.states(outputs, self._states) ^ self.states) | (energised & self.uncertain)

    @property
    def unproven(self) -> int:
        """Mask of the switched actuators that neither an end-stop nor a read-back of outputs has confirmed."""
        unread = self._master.verification.unread
        return self._kinds.actuators(unread) | self.missed if unread or self.missed else 0

    def pulsing(self, now: float) -> bool:
        """Returns whether a pulse is on; a pulse that could not be ended within LATE no longer counts."""
        if not self._kinds.pulsed:
            return False
        extending, contracting = self._kinds.on(self._master.outputs)
        on = (extending | contracting) & self._kinds.pulsed
        return any(now < self._pulse_ends[k] + LATE for k in indices(on))

    def resting(self, now: float) -> bool:
        """Returns whether no commit and no pulse is under way, and all travels are over and proven."""
        waits = self.target is not None or self._watched or self.unproven
        return not waits and now >= self.free_at and not self.pulsing(now)

    def differ(self, states: int, homing: int) -> int:
        """Returns the mask of the actuators that a switch to `states` energises or releases, with those of `homing`."""
        return (self.states ^ states) | (self.uncertain & homing)

    def ready_at(self, differ: int, strict: bool) -> float:
        """Returns when the actuators of a mask may switch [s]: after the last stage and their rest time."""
        ready = 0.0
        if differ and (strict or self._arm.inrush is not None):
            ready = self.free_at
        if differ and self._arm.rest > 0:
            ready = max(ready, max(self._arrives_at[k] for k in indices(differ)) + self._arm.rest)
        return ready

    def switch(self, states: int, now: float, homing: int = 0) -> bool:
        """Starts a switch to `states`; returns False if the caller must try again at the next tick."""
        if self.target is not None or self._master.committing:
            return False
        if not self._master.outputs_known:
            self._record_refused("a board is not up", now)
            return False
        differ = self.differ(states, homing) & self._kinds.paired
        self._journal.intend(self.states, states)
        try:
            self._master.commit(self._kinds.outputs(states, self._on(now) | differ), now)
        except Busy as error:
            self._journal.resolve(self.states)
            self._record_refused(str(error), now)
            return False
        self.target, self._doubtful, self._given_up = states, differ, False
        return True

    def give_up(self, why: str) -> None:
        """Gives up the running commit if its SYNC was not handed out. `under_way` has the lines that still switch."""
        if self.target is not None:
            self._given_up = True
            self._master.give_up(why)

    def tick(self, now: float) -> None:
        """Switches off the outputs whose pulse is over, and those that may still be on; in every mode, every period.

        A frame that a bus refuses now is sent at the next tick. A board without its master switches its outputs off
        itself.
        """
        if not self._kinds.paired:
            return
        self._find_missed()
        if self._unheard:
            self._find_heard(now)
        extending, contracting = self._kinds.on(self._master.outputs)
        over = (extending & contracting) | ((extending | contracting) & ~self._on(now))
        doubtful = self._watch_doubtful_pulses(now)
        if over or doubtful:
            possible = self._master.outputs | self._master.doubtful
            self._master.commit(self._kinds.without(possible, over) & ~doubtful, now, release=True)

    def find_overdue(self, now: float) -> list[ArmFault]:
        """Returns a fault for each pulse that was not read back as off in time, once until the next boot has ended."""
        if not self._watched or self._master.booting:
            self.told = 0
            return []
        on = self._kinds.actuators(self._master.outputs | self._master.doubtful)
        self._watched &= on | self._kinds.actuators(self._master.released)
        untold = indices(self._watched & on & ~self.told)
        due = [k for k in untold if now >= max(self._pulse_ends[k], self._adopted_at) + LATE]
        self.told |= mask_of(due)
        faults = list[ArmFault]()
        for k in due:
            it = self._arm.wiring.channels[k]
            text = f"the pulse of actuator {it.place} could not be ended in time: its coil may be on"
            advice = f"it is switched off again until it reads off; cut the power of {it.bus}/{it.node} meanwhile"
            faults.append(ArmFault("pulse-overdue", it.place, f"{text}; {advice}"))
        return faults

    def record_switched(self, lines: int, now: float) -> int:
        """Records that the SYNC of output lines was sent; returns the mask of the moving actuators."""
        extending, contracting = self._kinds.on(self._master.outputs & lines)
        energised = (extending ^ contracting) & self._kinds.paired
        states = self.states
        moved = (states ^ self._states) | (energised & self.uncertain)
        for k in indices(energised & self._kinds.pulsed):
            self._pulse_ends[k] = now + self._kinds.pulse[k]
            self._watched |= 1 << k
        self._unheard |= dict.fromkeys(indices(energised & self._kinds.pulsed & self._kinds.trusted))
        self.uncertain &= ~energised
        self.missed &= ~energised
        self._doubtful &= ~energised
        self._states = states
        if self._adopted is not None:  # a pulse found at the start may end before the first adoption
            self._adopted = states
        self._record_moved(moved, now)
        self.switches += moved.bit_count()
        return moved

    def conclude(self, now: float) -> int | None:
        """Counts the switches of a commit that has ended; returns its states if the outputs match them."""
        if self.target is None or self._master.committing or not self._master.outputs_known:
            return None
        states, self.target = self.target, None
        self._journal.resolve(self.states)
        why = self._master.commit_failed
        if why is None or self._given_up:
            self.busy_since = None
        else:
            self._record_refused(why, now)
        self._doubtful = 0
        return states if self.states == states else None

    def adopt(self, measured: int, definite: int, now: float) -> None:
        """Adopts the outputs that the boards read back, and counts the switches of an interrupted commit.

        Actuators whose outputs have changed rest from now on. After a start all actuators rest: the previous process
        may have switched them just before. No output is energised. `measured`: the states of the actuators `definite`.
        """
        self.target, self.fault = None, None
        self._find_missed()
        self.missed = 0
        extending, contracting = self._kinds.on(self._master.outputs)
        told = extending ^ contracting
        self.uncertain |= self._find_rebooted() | self._doubtful | mask_of(self._unheard) | (extending & contracting)
        self.uncertain &= ~told
        resting = definite & self._kinds.paired & ~told
        self._states = merged(resting, measured, self.states)
        self.uncertain &= ~resting
        self._doubtful = 0
        self._unheard.clear()
        states, first = self.states, self._adopted is None
        self.switches += self._journal.resolve(states, self.uncertain).bit_count()
        self._record_moved(self._kinds.everything if first else (self._adopted or 0) ^ states, now)
        self._adopted, self._adopted_at = states, now
        self._watched = (extending | contracting) & self._kinds.pulsed

    def _on(self, now: float) -> int:
        """Returns the mask of the paired actuators with an output on, without those whose pulse is over."""
        extending, contracting = self._kinds.on(self._master.outputs)
        on = extending ^ contracting
        over = (k for k in indices(on & self._kinds.pulsed) if now >= self._pulse_ends[k] - EARLY)
        return on & ~mask_of(over)

    def _watch_doubtful_pulses(self, now: float) -> int:
        """Watches pulses that may be on without a command; returns the mask of their output lines."""
        doubtful = self._master.doubtful & ~self._master.outputs
        lines = doubtful & ~self._kinds.without(doubtful, self._kinds.pulsed)
        pulses = self._kinds.actuators(lines) if lines else 0
        for k in indices(pulses & ~self._watched):
            self._pulse_ends[k] = now
        self._watched |= pulses
        return lines

    def _find_missed(self) -> None:
        """Detects actuators whose last pulse was not confirmed: their state is unknown, unless another pulse is on."""
        if missed := self._master.verification.drain_missed():
            self.missed |= self._kinds.actuators(missed) & ~self._kinds.actuators(self._master.outputs)
            self.uncertain |= self.missed

    def _find_heard(self, now: float) -> None:
        """Forgets the pulses whose board was heard after their end: it was there, so it has taken them."""
        for k, before in list(self._unheard.items()):
            frames = self._master.heard(self._master.board_of[k])
            if before is None and frames and now >= self._pulse_ends[k]:
                self._unheard[k] = frames
            elif before is not None and frames > before:
                del self._unheard[k]

    def _find_rebooted(self) -> int:
        """Returns the mask of the paired actuators whose board has restarted since the last adoption."""
        before, self._boots = self._boots, tuple(self._master.boots)
        if before == self._boots or not before:
            return 0
        board_of = self._master.board_of
        return mask_of(k for k in indices(self._kinds.paired) if before[board_of[k]] != self._boots[board_of[k]])

    def _record_moved(self, mask: int, now: float) -> None:
        states = self.states
        for k in indices(mask):
            self._arrives_at[k] = now + self._kinds.travel[k][states >> k & 1]
            self.free_at = max(self.free_at, self._arrives_at[k])

    def _record_refused(self, why: str, now: float) -> None:
        if self.busy_since is None:
            self.busy_since = now
        if now - self.busy_since > BUSY_FOR:
            self.fault = ArmFault("bus-busy", "bus", f"no command could be sent for {BUSY_FOR:g} s: {why}")
            self.busy_since = None
