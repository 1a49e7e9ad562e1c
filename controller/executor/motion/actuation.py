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
    uncertain if nobody reads the board back (`verify: false`), and the end of the pulse was not read either.
    """

    def __init__(self, master: Master, arm: ExecutedArm, kinds: Kinds, journal: SwitchJournal) -> None:
        self.free_at = 0.0  # when the last switched actuator has settled, by its travel time [s]
        self.target: int | None = None  # states of the running commit; None if no commit runs
        self.uncertain = kinds.paired  # mask of the actuators of unknown state; their bits of `states` are guesses
        self.missed = 0  # mask of uncertain actuators whose last pulse was not confirmed
        self.switches = 0  # number of switches since the executor started
        # set if the bus accepted no command for BUSY_FOR; cleared by the caller that reports it
        self.fault: ArmFault | None = None
        self._master, self._outputs, self._switching = master, master.outputs, master.switching
        self._arm, self._kinds, self._journal = arm, kinds, journal
        self._arrives_at = [-1e12] * len(arm.actuators)
        self._last = 0  # states after the last switch; of a pair with both outputs off, nothing else tells them
        # when a bus accepted no command for the first time [s]; None: nothing waits to be switched
        self.busy_since: float | None = None
        self._pulse_ends = dict.fromkeys(kinds.pulse, -math.inf)
        self._watched = 0  # mask of the actuators without a confirmed end of their pulse
        self.told = 0  # mask of the actuators reported as overdue
        self._unheard = 0  # mask of the actuators whose pulse nobody reads back, until its end is read
        self._adopted_at = -math.inf
        self._given_up = False  # the running commit is not wanted any more
        self._boots: tuple[int, ...] = ()  # boot count of each board when the outputs were adopted

    @property
    def states(self) -> int:
        """The states that the outputs command, or commanded before a pulse ended."""
        return self._kinds.states(self._outputs.commanded, self._last)

    @property
    def under_way(self) -> int:
        """Mask of the actuators that frames under way will switch."""
        leaving = self._switching.leaving
        if not leaving:
            return 0
        outputs = self._outputs.commanded ^ leaving
        extending, contracting = self._kinds.on(outputs & leaving)
        energised = (extending ^ contracting) & self._kinds.paired
        return (self._kinds.states(outputs, self._last) ^ self.states) | (energised & self.uncertain)

    @property
    def unproven(self) -> int:
        """Mask of the switched actuators that neither an end-stop nor a read-back of outputs has confirmed."""
        lines = self._outputs.unproven
        return self._kinds.actuators(lines) | self.missed if lines or self.missed else 0

    def pulsing(self, now: float) -> bool:
        """Returns whether a pulse is on; a pulse that could not be ended within LATE no longer counts."""
        if not self._kinds.pulsed:
            return False
        extending, contracting = self._kinds.on(self._outputs.commanded)
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
        if self.target is not None or self._switching.under_way:
            return False
        if not self._master.outputs_known:
            self._record_refused("a board is not up", now)
            return False
        on = self._on(now) | self.differ(states, homing) & self._kinds.paired
        self._journal.intend(self.states, states)
        try:
            self._master.commit(self._kinds.outputs(states, on), now)
        except Busy as error:
            self._journal.resolve(self.states)
            self._record_refused(str(error), now)
            return False
        self.target, self._given_up = states, False
        return True

    def give_up(self, why: str) -> None:
        """Gives up the running commit if its SYNC was not handed out. `under_way` has the lines that still switch."""
        if self.target is not None:
            self._given_up = True
            self._switching.give_up(why)

    def tick(self, now: float) -> None:
        """Switches off the outputs whose pulse is over, and those that may still be on; in every mode, every period.

        A frame that a bus refuses now is sent at the next tick. A board without its master switches its outputs off
        itself.
        """
        if not self._kinds.paired:
            return
        self._find_missed()
        extending, contracting = self._kinds.on(self._outputs.commanded)
        over = (extending & contracting) | ((extending | contracting) & ~self._on(now))
        if off := self._kinds.lines(over) | self._watch_doubtful_pulses(now):
            self._master.release(off, now)

    def find_overdue(self, now: float) -> list[ArmFault]:
        """Returns a fault for each pulse that was not read back as off in time, once until the next boot has ended."""
        if not self._watched or self._master.booting.under_way:
            self.told = 0
            return []
        outputs = self._outputs
        on = self._kinds.actuators(outputs.commanded | outputs.doubtful)
        over = self._watched & ~(on | self._kinds.actuators(outputs.released))
        self._watched &= ~over
        self._unheard &= ~(over & self._master.inputs.known)
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
        extending, contracting = self._kinds.on(self._outputs.commanded & lines)
        energised = (extending ^ contracting) & self._kinds.paired
        states = self.states
        moved = (states ^ self._last) | (energised & self.uncertain)
        pulses = energised & self._kinds.pulsed
        for k in indices(pulses):
            self._pulse_ends[k] = now + self._kinds.pulse[k]
        self._watched |= pulses
        self._unheard |= pulses & self._kinds.trusted
        self.uncertain &= ~energised
        self.missed &= ~energised
        self._last = states
        self._record_moved(moved, now)
        self.switches += moved.bit_count()
        return moved

    def conclude(self, now: float) -> int | None:
        """Counts the switches of a commit that has ended; returns its states if the outputs match them."""
        if self.target is None or self._switching.under_way or not self._master.outputs_known:
            return None
        states, self.target = self.target, None
        self._journal.resolve(self.states)
        why = self._switching.failed
        if why is None or self._given_up:
            self.busy_since = None
        else:
            self._record_refused(why, now)
        return states if self.states == states else None

    def adopt(self, measured: int, definite: int, now: float) -> None:
        """Adopts the outputs that the boards read back, and counts the switches of an interrupted commit.

        Actuators whose outputs have changed rest from now on. After a start all actuators rest: the previous process
        may have switched them just before. No output is energised. `measured`: the states of the actuators `definite`.
        """
        before, first = self._last, self._adopted_at == -math.inf
        interrupted = 0 if self.target is None else (self.target ^ before) & self._kinds.paired
        self.target, self.fault = None, None
        self._find_missed()
        self.missed = 0
        extending, contracting = self._kinds.on(self._outputs.commanded)
        told = extending ^ contracting
        self.uncertain |= self._find_rebooted() | interrupted | self._unheard | (extending & contracting)
        resting = definite & self._kinds.paired & ~told
        self._last = states = merged(resting, measured, self.states)
        self.uncertain &= ~(told | resting)
        self._unheard = 0
        self.switches += self._journal.resolve(states, self.uncertain).bit_count()
        self._record_moved(self._kinds.everything if first else before ^ states, now)
        self._adopted_at = now
        self._watched = (extending | contracting) & self._kinds.pulsed

    def _on(self, now: float) -> int:
        """Returns the mask of the paired actuators with an output on, without those whose pulse is over."""
        extending, contracting = self._kinds.on(self._outputs.commanded)
        on = extending ^ contracting
        over = (k for k in indices(on & self._kinds.pulsed) if now >= self._pulse_ends[k] - EARLY)
        return on & ~mask_of(over)

    def _watch_doubtful_pulses(self, now: float) -> int:
        """Watches pulses that may be on without a command; returns the mask of their output lines."""
        lines = self._outputs.doubtful & ~self._outputs.commanded & self._outputs.pulsed
        pulses = self._kinds.actuators(lines) if lines else 0
        for k in indices(pulses & ~self._watched):
            self._pulse_ends[k] = now
        self._watched |= pulses
        return lines

    def _find_missed(self) -> None:
        """Detects actuators whose last pulse was not confirmed: their state is unknown, unless another pulse is on."""
        if missed := self._outputs.drain_missed():
            self.missed |= self._kinds.actuators(missed) & ~self._kinds.actuators(self._outputs.commanded)
            self.uncertain |= self.missed

    def _find_rebooted(self) -> int:
        """Returns the mask of the paired actuators whose board has restarted since the last adoption."""
        before, self._boots = self._boots, tuple(board.boots for board in self._master.boards)
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
