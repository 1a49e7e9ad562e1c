"""Commands that are given up, come too early, or change nothing."""

from __future__ import annotations

from typing import Any

from hyperbit.drivers.canopen.faults import Busy
from tests.simulation.fieldbus.command_maker import AT_ONCE, CommandMaker
from tests.simulation.fieldbus.expected import Expected, Fault
from tests.simulation.judge.fieldbus.wires import bits_in
from tests.simulation.judge.verdict import require


class CommandFaults(CommandMaker):
    """Makes faults of one command that the executor does not want, or must not have."""

    def command_is_given_up(self) -> Fault | None:
        if not (self._fit and self._waits()):
            return None
        master, world = self._world.master, self._world

        def cause() -> None:
            self._commit(self._states)
            require(master.committing and master.collecting, "a command has begun, and is not told")
            master.give_up("the test says so")
            require(not master.committing, "a command was given up, and is told")

        def check() -> None:
            self._unswitched("the test says so")
            world.switching.booted()  # what the boards have latched, nobody knows
            self._site.call(lambda m: m.commit(self._states, world.agenda.now))
            world.wait(lambda: not master.committing, 0.6 + world.watching.slack, "committed")
            world.switching.forget(self._states)
            require(world.switching.driven() == self._states, f"the pins are {world.switching.driven():b}")
            require(master.commit_failed is None, f"the next command has failed: {master.commit_failed}")
            switched = sum(mask for mask, _ in master.drain_switched())
            require(switched == self._changed, f"{switched:b} is told as switched, {self._changed:b} has")

        return Fault(cause, lambda: world.use.release_quietly(), Expected((), within=AT_ONCE), check)

    def command_is_given_up_that_waits_for_no_SYNC(self) -> Fault | None:
        """Boards without SYNC still switch when their frames leave, all others hold."""
        if not self._fit or self._waits():
            return None
        master, world = self._world.master, self._world
        parts = [part for name in world.wiring.boards for part in world.switching.parts_of(name) if not part.waits]
        at_once = sum(
            wire.line
            for name, board in world.wiring.boards.items()
            for wire in board.outputs
            if any(bits_in(p.mapping, board.base) >> wire.bit & 1 for p in parts if p.board.name == name)
        )
        leaving = at_once & self._changed
        both = [p.board.name for p in parts]
        if len(set(both)) < len(both) or world.drawn.wiring.shared_rpdo:
            return None  # frames that wait and frames that do not may carry one board

        def cause() -> None:
            self._commit(self._states)
            if not master.committing:
                return
            master.give_up("the test says so")
            told = master.leaving
            require(told == leaving, f"{told:b} are leaving, {leaving:b} are commanded to boards without SYNC")
            world.wait(lambda: not master.committing, 0.6 + world.watching.slack, "over")
            wanted = self._before ^ leaving
            driven = world.switching.driven()
            require(driven == wanted, f"the pins are {driven:b} after a command was given up; {wanted:b} may leave")
            require(master.outputs == wanted, f"outputs {master.outputs:b} are told; {wanted:b} are driven")

        def check() -> None:
            driven = world.switching.driven()
            self._commit(driven)  # sends anew what the boards with SYNC may have latched
            world.wait(lambda: not master.committing, 0.6 + world.watching.slack, "committed")
            require(world.switching.driven() == driven, f"the pins are {world.switching.driven():b}, were {driven:b}")
            master.drain_switched()
            world.switching.forget(driven)

        return Fault(cause, lambda: world.use.release_quietly(), Expected((), within=AT_ONCE), check)

    def command_while_an_older_frame_waits(self) -> Fault | None:
        """No command begins before a frame with its COB-ID has left, of a command that was given up."""
        if not (self._fit and self._waits()):
            return None
        world, master = self._world, self._world.master
        held = [bus for bus in self._site.buses.values() if world.switching.lines_on(bus.name) & self._changed]
        other = world.use.possible(self._before ^ (self._changed & -self._changed))

        def cause() -> None:
            for bus in held:
                bus.stuck = True
            self._commit(self._states)
            master.give_up("the test says so")
            try:
                self._commit(other)
                begun = master.committing
            except Busy:
                begun = False
            for bus in held:
                bus.stuck = False
                bus.begin()
            world.wait(lambda: not master.committing, 0.6 + world.watching.slack, "over")
            require(not begun, "a command begins while an older frame with its COB-ID waits")

        def check() -> None:
            driven = world.switching.driven()
            still = driven == master.outputs == self._before
            require(still, f"the pins are {driven:b} after commands that were given up")
            master.drain_switched()
            self._commit(other)
            world.wait(lambda: not master.committing, 0.6 + world.watching.slack, "committed")
            driven = world.switching.driven()
            require(driven == other, f"the pins are {driven:b} after a command of {other:b}")
            world.switching.forget(other)
            master.drain_switched()

        if other == self._before or self._timing.heartbeat_timeout < 0.1:
            return None
        return Fault(cause, lambda: world.use.release_quietly(), Expected((), within=AT_ONCE), check)

    def command_is_given_up_after_its_SYNC(self) -> Fault | None:
        if not (self._fit and self._waits()):
            return None
        master, world = self._world.master, self._world

        def cause() -> None:
            self._commit(self._states)
            world.wait(lambda: not master.collecting, 0.1, "past its RPDOs")
            leaving = master.leaving
            require(not leaving & ~self._changed, f"{leaving:b} are leaving, {self._changed:b} change")
            require(leaving == self._changed, f"{leaving:b} are leaving, {self._changed:b} change")
            require(not master.outputs_known, "outputs are known while SYNCs leave")
            master.give_up("too late")
            world.wait(lambda: not master.committing, 0.6 + world.watching.slack, "committed")

        def check() -> None:
            require(master.commit_failed is None, f"a command whose SYNC was sent has failed: {master.commit_failed}")
            require(world.switching.driven() == self._states == master.outputs, f"outputs {master.outputs:b} are told")
            world.switching.forget(self._states)
            master.drain_switched()

        return Fault(cause, lambda: world.use.release_quietly(), Expected((), within=AT_ONCE), check)

    def command_during_a_command(self) -> Fault | None:
        if not self._fit:
            return None
        master, world = self._world.master, self._world

        def cause() -> None:
            self._commit(self._states)
            why = self._refused(self._before, Busy)
            require("previous commit" in why, f"a second command is refused by {why!r}")
            world.wait(lambda: not master.committing, 0.6 + world.watching.slack, "committed")

        def check() -> None:
            require(world.switching.driven() == self._states, f"the pins are {world.switching.driven():b}")
            world.switching.forget(self._states)
            master.drain_switched()

        return Fault(cause, lambda: world.use.release_quietly(), Expected((), within=AT_ONCE), check)

    def command_of_lines_that_are_not_there(self) -> Fault:
        wrong = 1 << self._world.wiring.lines.bit_length()

        def cause() -> None:
            self._refused(wrong, ValueError)
            self._refused(-1, ValueError)

        return Fault(cause, lambda: None, Expected((), within=AT_ONCE))

    def command_of_the_present_states(self) -> Fault:
        """Nothing is sent."""
        world = self._world

        def cause() -> None:
            sent: list[Any] = []
            keep = self._site.hands_out
            self._site.hands_out = lambda bus, frame: sent.append(frame)
            self._commit(self._before)
            self._site.hands_out = keep
            require(not sent and not world.master.committing, f"a command that changes nothing sends {sent}")

        return Fault(cause, lambda: None, Expected((), within=AT_ONCE))
