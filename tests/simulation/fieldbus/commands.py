"""Commands that are given up, refused, or whose frames do not leave: what switches, and what the master tells of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from hyperbit.drivers.canopen.faults import Busy
from tests.simulation.buses.bus_model import BusModel
from tests.simulation.faults.fault import Fault, Maker, Place, Row, Told
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

    def give_up(self) -> int:
        """Gives it up; returns the lines that still switch, as told."""
        if self.arm.master.switching.under_way:
            self.arm.master.switching.give_up(WHY)
        return self.arm.master.switching.leaving

    def refused(self, states: int) -> str:
        try:
            self.arm.commit(states)
        except Busy as error:
            return str(error)
        require(False, f"a command of {states:b} is not refused")
        return ""

    def over(self) -> None:
        self.arm.wait(lambda: not self.arm.master.switching.under_way, COMMITTED + self.arm.sight.slack, "over")

    def judge(self, switched: int) -> None:
        """Requires that these lines have switched, and no others, and that the master tells this."""
        self.over()
        master, driven = self.arm.master, self.arm.driven()
        require(driven == self.before ^ switched, f"the pins are {driven:b}; {switched:b} of {self} switches")
        outputs = master.outputs.commanded
        require(outputs == driven, f"outputs {outputs:b} are told; {driven:b} are driven")
        told = sum(mask for mask, _ in master.switching.drain())
        require(told == switched, f"{told:b} is told as switched, {switched:b} has")


class Disturbance(NamedTuple):
    """What befalls a command.

    Attributes:
        happen: sends the command, and disturbs it; returns the lines that switch nevertheless.
        fails: whether a failure is told; None: it is not judged.
        waits: whether all boards must switch with SYNC.
    """

    happen: Callable[[Command], int]
    fails: bool | None = False
    waits: bool = True


def _give_up(command: Command) -> int:
    """Boards without SYNC still switch when their frames leave, all others hold."""
    arm = command.arm
    command.send()
    held = sum(board.lines for name, board in arm.judged.boards.items() if arm.waits(name))
    require(arm.master.switching.collecting or not held & command.changed, "a command has begun, and is not told")
    leaving = command.give_up()
    require(leaving == command.changed & ~held, f"{leaving:b} are leaving, {command} is given up, {held:b} wait")
    return leaving


def _give_up_too_late(command: Command) -> int:
    command.send()
    arm, master = command.arm, command.arm.master
    arm.wait(lambda: not master.switching.collecting, 0.1, "past its RPDOs")
    require(not master.outputs_known, "outputs are known while SYNCs leave")
    leaving = command.give_up()
    require(leaving == command.changed, f"{leaving:b} are leaving, {command.changed:b} change")
    return leaving


def _command_again(command: Command) -> int:
    command.send()
    command.refused(command.before)
    return command.changed


def _command_while_an_older_frame_waits(command: Command) -> int:
    """No command begins before a frame with its COB-ID has left, of a command that was given up."""
    for bus in command.buses:
        bus.stuck = True
    command.send()
    command.give_up()
    command.refused(command.arm.possible(command.before ^ (command.changed & -command.changed)))
    for bus in command.buses:
        bus.restore()
    return 0


def _lose_RPDO(command: Command) -> int:
    command.buses[0].room = 0
    command.send()
    command.buses[0].room = None
    return 0


DISTURBANCES = {
    "command is given up": Disturbance(_give_up, None, waits=False),
    "command is given up after its SYNC": Disturbance(_give_up_too_late),
    "command during a command": Disturbance(_command_again, waits=False),
    "command while an older frame waits": Disturbance(_command_while_an_older_frame_waits, None),
    "RPDO is not sent": Disturbance(_lose_RPDO, True),
}


def _command(at: Place, needs_sync: bool = True) -> Command | None:
    arm = at.world
    before, states = arm.driven(), arm.drawn_states()
    buses = [bus for bus in arm.buses.values() if arm.lines_on(bus.name) & (before ^ states)]
    if not buses or before & arm.judged.pulsed or (needs_sync and not all(map(arm.waits, arm.looks))):
        return None
    return Command(arm, before, states, buses)


def _disturbed(disturbance: Disturbance, at: Place) -> Fault | None:
    command, arm = _command(at, disturbance.waits), at.world
    split = arm.wiring.shared_rpdo or any(len(arm.rpdos(name)) > 1 for name in arm.looks)
    if command is None or (disturbance.happen is _give_up and split and not all(map(arm.waits, arm.looks))):
        return None

    def begin() -> None:
        command.judge(disturbance.happen(command))
        failed = arm.master.switching.failed
        require(disturbance.fails in (None, failed is not None), f"the failure of {command} is {failed!r}")

    def check() -> None:
        """The next command switches."""
        following = command._replace(
            before=arm.driven(), states=arm.random.choice([command.states, arm.drawn_states()])
        )
        if following.changed:
            following.send()
            following.judge(following.changed)
            failed = arm.master.switching.failed
            require(failed is None, f"{following} after {command} fails: {failed}")
        arm.forget()

    return Fault(begin, arm.release_quietly, Told(within=AT_ONCE, beats=disturbance.happen is not _lose_RPDO), check)


def frames_stay_in_the_controller(at: Place) -> Fault | None:
    command, timing = _command(at), at.timing
    late = timing.heartbeat_timeout / 2 + 0.03
    if command is None or late + AT_ONCE > timing.heartbeat_timeout - timing.heartbeat:
        return None  # the boards would lose the master before
    bus = at.random.choice(command.buses)

    def begin() -> None:
        bus.stuck = True
        command.send()

    def check() -> None:
        command.judge(0)
        require(command.arm.master.switching.failed, "a command has failed, and nothing is told")

    lost = tuple(name for name, board in command.arm.judged.boards.items() if board.bus == bus.name)
    return Fault(begin, bus.restore, Told(within=late, also=("bus-busy",), lost=lost, beats=False), check)


def bus_is_lost_with_a_SYNC(at: Place) -> Fault | None:
    command = _command(at)
    if command is None:
        return None
    arm, bus = command.arm, at.random.choice(command.buses)
    doubtful = arm.lines_on(bus.name) & command.changed

    def begin() -> None:
        bus.at_next_sync(lambda: at.after(0.0, bus.go_down))
        command.send()
        arm.wait(lambda: bus.state == "down", 0.2, "down")

    def check() -> None:
        require(arm.master.switching.failed, "a command has failed, and nothing is told")
        told = arm.master.outputs.doubtful
        require(told == doubtful, f"{told:b} are doubtful, {doubtful:b} may have switched")
        command.over()
        require(bus.name in command.refused(command.states), f"a command is refused, and not for {bus.name}")

    lost = tuple(name for name, board in arm.judged.boards.items() if board.bus == bus.name)
    return Fault(begin, bus.restore, Told(("bus-down",), (bus.name,), (), AT_ONCE, lost=lost, beats=False), check)


def _release(arm: UsedArm, off: int) -> None:
    """Switches lines off while a board is lost: no frame changes another pin."""
    arm.ask_for_nothing()
    arm.release(off)
    arm.wait(lambda: not arm.moves(), COMMITTED + arm.sight.slack, "released")
    require(not arm.driven() & off, f"{off:b} is not switched off beside a lost board")


def command_without_a_board(at: Place) -> Fault | None:
    """A command is refused while a board is lost; lines of other boards can still be switched off."""
    command, arm = _command(at, needs_sync=False), at.world
    if command is None:
        return None

    def check() -> None:
        require(at.name in command.refused(command.before ^ 1), f"a command is refused, and not for {at.name}")
        on = arm.master.outputs.commanded
        others = [board.lines & on for name, board in arm.judged.boards.items() if name != at.name and board.lines & on]
        if others and all(map(arm.waits, arm.looks)):
            _release(arm, others[0])

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
        command.give_up()
        arm.pass_time(AT_ONCE)
        sends = (0x080, 0x580, 0x700, *range(0x180, 0x580, 0x100))
        at.bus.intercept = lambda frame: "lose" if frame.id - at.node in sends else ""

    told = Told(("board-lost",), (at.name,), (), 2 * AT_ONCE + at.timing.heartbeat_timeout, lost=(at.name,))
    return Fault(begin, at.bus.restore, told, lambda: _release(arm, next(filter(None, off))))


def pulses_are_too_short(at: Place) -> Fault | None:
    """Pulses end before their outputs are read: each is missed, and the third in a row is a fault."""
    arm, before = at.world, at.world.driven()
    blind = [wire.line for wire in at.judged.outputs if wire.line & arm.judged.pulsed & at.judged.unsensed]
    if not blind or before & arm.judged.pulsed or at.board.variant.answer_delay or not all(map(arm.waits, arm.looks)):
        return None
    line = at.random.choice(blind)

    def begin() -> None:
        for _ in range(3):
            arm.commit(before | line)
            arm.wait(lambda: arm.master.outputs.commanded & line, 0.1, "on")
            arm.release(line)
            missed = f"{line:b} was on, not read back, and missed"
            arm.wait(lambda: arm.master.outputs.drain_missed() & line, COMMITTED, missed)
            arm.wait(lambda: not arm.moves(), COMMITTED, "released")
            arm.pass_time(READ_BACK)
            arm.master.switching.drain()

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
