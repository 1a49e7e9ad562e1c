"""Commands that are given up, refused, or whose frames do not leave: what switches, and what the master tells of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from hyperbit.drivers.canopen.faults import Busy
from tests.simulation.buses.bus_model import BusModel
from tests.simulation.faults.fault import Fault, Maker, Place, Row, Told
from tests.simulation.fieldbus.judge.wires import bits_in
from tests.simulation.fieldbus.use import COMMITTED, UsedArm
from tests.simulation.verdict import require

AT_ONCE = 0.05  # [s] until a failure is told
READ_BACK = 1.3  # [s] from a switch until outputs are read
WHY = "somebody else is served"


class Command(NamedTuple):
    """A drawn command, and the buses whose lines it changes."""

    arm: UsedArm
    before: int
    states: int
    buses: list[BusModel]

    @property
    def changed(self) -> int:
        return self.before ^ self.states

    def send(self) -> None:
        self.arm.commit(self.states)

    def refused(self, states: int, why: type[Exception] = Busy) -> str:
        try:
            self.arm.commit(states)
        except why as error:
            return str(error)
        require(False, f"a command of {states:b} is not refused")
        return ""

    def over(self) -> None:
        self.arm.wait(lambda: not self.arm.master.committing, COMMITTED + self.arm.watching.slack, "over")


class Disturbance(NamedTuple):
    """What befalls a command.

    Attributes:
        happen: sends the command, and disturbs it; returns the lines that switch nevertheless.
        fails: words of the failure that is told; None: it is not judged; "": it has not failed.
        waits: whether all boards must switch with SYNC.
    """

    happen: Callable[[Command], int]
    fails: str | None = ""
    waits: bool = True


def _give_up(command: Command) -> int:
    command.send()
    master = command.arm.master
    require(master.committing and master.collecting, "a command has begun, and is not told")
    master.give_up(WHY)
    require(not master.committing, "a command was given up, and is told")
    return 0


def _give_up_too_late(command: Command) -> int:
    command.send()
    arm, master = command.arm, command.arm.master
    arm.wait(lambda: not master.collecting, 0.1, "past its RPDOs")
    require(master.leaving == command.changed, f"{master.leaving:b} are leaving, {command.changed:b} change")
    require(not master.outputs_known, "outputs are known while SYNCs leave")
    master.give_up(WHY)
    return command.changed


def _give_up_at_once(command: Command) -> int:
    """Boards without SYNC still switch when their frames leave, all others hold."""
    arm, leaving = command.arm, 0
    for name, board in arm.judged.boards.items():
        at_once = sum(bits_in(part.mapping, board.base) for part in arm.switching.parts_of(name) if not part.waits)
        leaving |= sum(wire.line for wire in board.outputs if at_once >> wire.bit & 1) & command.changed
    command.send()
    if arm.master.committing:
        arm.master.give_up(WHY)
        require(arm.master.leaving == leaving, f"{arm.master.leaving:b} are leaving, {leaving:b} are commanded")
    return leaving


def _command_again(command: Command) -> int:
    command.send()
    why = command.refused(command.before)
    require("previous commit" in why, f"a second command is refused by {why!r}")
    return command.changed


def _command_while_an_older_frame_waits(command: Command) -> int:
    """No command begins before a frame with its COB-ID has left, of a command that was given up."""
    for bus in command.buses:
        bus.stuck = True
    command.send()
    command.arm.master.give_up(WHY)
    command.refused(command.arm.possible(command.before ^ (command.changed & -command.changed)))
    for bus in command.buses:
        bus.restore()
    return 0


def _lose_RPDO(command: Command) -> int:
    command.buses[0].room = 0
    command.send()
    command.buses[0].room = None
    return 0


def _command_lines_that_are_not_there(command: Command) -> int:
    command.refused(1 << command.arm.judged.lines.bit_length(), ValueError)
    command.refused(-1, ValueError)
    return 0


def _command_the_present_states(command: Command) -> int:
    arm = command.arm
    sent = arm.handed_out
    arm.commit(command.before)
    require(not arm.master.committing and arm.handed_out == sent, "a command that changes nothing sends frames")
    return 0


DISTURBANCES = {
    "command is given up": Disturbance(_give_up, WHY),
    "command is given up after its SYNC": Disturbance(_give_up_too_late),
    "command is given up that waits for no SYNC": Disturbance(_give_up_at_once, None, waits=False),
    "command during a command": Disturbance(_command_again, waits=False),
    "command while an older frame waits": Disturbance(_command_while_an_older_frame_waits, None),
    "RPDO is not sent": Disturbance(_lose_RPDO, "was not sent"),
    "command of lines that are not there": Disturbance(_command_lines_that_are_not_there, waits=False),
    "command of the present states": Disturbance(_command_the_present_states, waits=False),
}


def _command(at: Place, needs_sync: bool = True) -> Command | None:
    arm = at.world
    before, states = arm.switching.states, arm.drawn_states()
    buses = [bus for bus in arm.buses.values() if arm.switching.lines_on(bus.name) & (before ^ states)]
    if not buses or before & arm.judged.pulsed or (needs_sync and not all(map(arm.waits, arm.looks))):
        return None
    return Command(arm, before, states, buses)


def _disturbed(disturbance: Disturbance, at: Place) -> Fault | None:
    command, arm = _command(at, disturbance.waits), at.world
    split = arm.wiring.shared_rpdo or any(len(arm.switching.parts_of(name)) > 1 for name in arm.looks)
    if command is None or (disturbance.happen is _give_up_at_once and (split or all(map(arm.waits, arm.looks)))):
        return None

    def begin() -> None:
        switched = disturbance.happen(command)
        command.over()
        failed, driven = arm.master.commit_failed, arm.switching.driven()
        require(driven == command.before ^ switched, f"the pins are {driven:b}; {switched:b} of {command} switches")
        require(arm.master.outputs == driven, f"outputs {arm.master.outputs:b} are told; {driven:b} are driven")
        wanted = disturbance.fails
        right = wanted is None or (failed is None if wanted == "" else wanted in (failed or ""))
        require(right, f"the failure is {failed!r}; {wanted!r} is due")
        told = sum(mask for mask, _ in arm.master.drain_switched())
        require(told == switched, f"{told:b} is told as switched, {switched:b} has")
        arm.switching.booted()  # what the boards have latched, nobody knows

    def check() -> None:
        """The next command switches."""
        before, states = arm.switching.driven(), arm.random.choice([command.states, arm.drawn_states()])
        if before != states:
            arm.commit(states)
            command.over()
            told = sum(mask for mask, _ in arm.master.drain_switched())
            right = arm.switching.driven() == states and arm.master.commit_failed is None
            require(right, f"the pins are {arm.switching.driven():b} after {command}: {arm.master.commit_failed}")
            require(told == before ^ states, f"{told:b} is told as switched")
        arm.forget()

    return Fault(begin, arm.release_quietly, Told(within=AT_ONCE, beats=disturbance.happen is not _lose_RPDO), check)


def frames_stay_in_the_controller(at: Place) -> Fault | None:
    command, timing = _command(at), at.timing
    late = timing.heartbeat_timeout / 2 + 0.03
    if command is None or late + AT_ONCE > timing.heartbeat_timeout - timing.heartbeat:
        return None  # the boards would lose the master before
    arm, bus = command.arm, at.random.choice(command.buses)

    def begin() -> None:
        bus.stuck = True
        command.send()

    def check() -> None:
        failed, driven = arm.master.commit_failed or "", arm.switching.driven()
        require(driven == command.before == arm.master.outputs, f"the pins are {driven:b} after {command}")
        require("were not sent for" in failed or f"{bus.name} was lost" in failed, f"the failure is {failed!r}")
        require(not arm.master.drain_switched(), "switches of a command that has failed are told")

    lost = tuple(name for name, board in arm.judged.boards.items() if board.bus == bus.name)
    return Fault(begin, bus.restore, Told(within=late, also=("bus-busy",), lost=lost, beats=False), check)


def bus_is_lost_with_a_SYNC(at: Place) -> Fault | None:
    command = _command(at)
    if command is None:
        return None
    arm, bus = command.arm, at.random.choice(command.buses)
    doubtful = arm.switching.lines_on(bus.name) & command.changed

    def begin() -> None:
        bus.at_next_sync(lambda: at.after(0.0, bus.go_down))
        command.send()
        arm.wait(lambda: bus.state == "down", 0.2, "down")

    def check() -> None:
        failed = arm.master.commit_failed or ""
        require("was lost while its SYNC" in failed, f"the failure is {failed!r}")
        told = arm.master.doubtful
        require(told == doubtful, f"{told:b} are doubtful, {doubtful:b} may have switched")
        require(not arm.master.outputs_known, "outputs are known, and a SYNC was lost")
        command.over()
        why = command.refused(command.states)
        require(bus.name in why, f"a command on a lost bus is refused by {why!r}")

    lost = tuple(name for name, board in arm.judged.boards.items() if board.bus == bus.name)
    return Fault(begin, bus.restore, Told(("bus-down",), (bus.name,), (), AT_ONCE, lost=lost, beats=False), check)


def _release(arm: UsedArm, off: int) -> None:
    """Switches lines off while a board is lost: no frame changes another pin."""
    arm.ask_for_nothing()
    arm.commit(~off & arm.judged.lines, release=True)
    arm.wait(lambda: not arm.moves(), COMMITTED + arm.watching.slack, "released")
    require(not arm.switching.driven() & off, f"{off:b} is not switched off beside a lost board")


def command_without_a_board(at: Place) -> Fault | None:
    """A command is refused while a board is lost; lines of other boards can still be switched off."""
    command, arm = _command(at, needs_sync=False), at.world
    if command is None:
        return None

    def check() -> None:
        why = command.refused(command.before ^ 1)
        require(at.name in why and "not ready" in why, f"a command without {at.name} is refused by {why!r}")
        others = [b for name, b in arm.judged.boards.items() if name != at.name and b.lines & arm.master.outputs]
        if others and all(map(arm.waits, arm.looks)):
            _release(arm, others[0].lines & arm.master.outputs)

    told = Told(("board-lost",), (at.name,), (), at.timing.heartbeat_timeout + AT_ONCE, lost=(at.name,))
    return Fault(at.do("silence"), at.do("unsilence"), told, check)


def release_beside_a_board_that_only_hears(at: Place) -> Fault | None:
    """A board that is not heard has latched a command that was given up: no SYNC of a release switches it."""
    command, arm = _command(at), at.world
    if command is None or not at.judged.lines & command.changed or arm.wiring.shared_rpdo:
        return None
    off = [b.lines & command.before for n, b in arm.judged.boards.items() if n != at.name and n in at.here]
    if not any(off):
        return None

    def begin() -> None:
        command.send()
        arm.master.give_up(WHY)
        arm.pass_time(AT_ONCE)
        sends = (0x080, 0x580, 0x700, *range(0x180, 0x580, 0x100))
        at.bus.intercept = lambda frame: "lose" if frame.id - at.node in sends else ""

    told = Told(("board-lost",), (at.name,), (), 2 * AT_ONCE + at.timing.heartbeat_timeout, lost=(at.name,))
    return Fault(begin, at.bus.restore, told, lambda: _release(arm, next(filter(None, off))))


def pulses_are_too_short(at: Place) -> Fault | None:
    """Pulses end before their outputs are read: each is missed, and the third in a row is a fault."""
    arm, before = at.world, at.world.switching.states
    blind = [wire.line for wire in at.judged.outputs if wire.line & arm.judged.pulsed & at.judged.unsensed]
    if not blind or before & arm.judged.pulsed or at.board.variant.answer_delay or not all(map(arm.waits, arm.looks)):
        return None
    line = at.random.choice(blind)

    def begin() -> None:
        for _ in range(3):
            arm.commit(before | line)
            arm.wait(lambda: arm.master.outputs & line, 0.1, "on")
            arm.commit(~line & arm.judged.lines, release=True)
            arm.wait(lambda: arm.master.drain_missed() & line, COMMITTED, f"{line:b} was on, not read back, and missed")
            arm.wait(lambda: not arm.moves(), COMMITTED, "released")
            arm.pass_time(READ_BACK)
            arm.master.drain_switched()

    words = ("before they were read back", "verify: false")
    return Fault(begin, told=Told(("not-verified",), (at.name,), words, AT_ONCE, lost=(at.name,)), check=arm.forget)


MAKERS: dict[str, Maker] = {name: partial(_disturbed, disturbance) for name, disturbance in DISTURBANCES.items()}
MAKERS |= {
    make.__name__.replace("_", " "): make
    for make in (
        frames_stay_in_the_controller,
        bus_is_lost_with_a_SYNC,
        command_without_a_board,
        release_beside_a_board_that_only_hears,
        pulses_are_too_short,
    )
}
ROWS = tuple(Row(name, make, "command", anytime=False, longest=0.0) for name, make in MAKERS.items())
