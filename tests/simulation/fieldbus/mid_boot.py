"""Boots in which one thing goes wrong at a drawn SDO frame."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.drivers.canopen.wire.cia301 import Frame, State
from tests.simulation.faults.fault import Deck, Fault
from tests.simulation.fieldbus.life import LONGEST_BOOT
from tests.simulation.fieldbus.use import UsedArm
from tests.simulation.verdict import require

MOST_RESTARTS = 5  # of one board in a boot
ERRORS = (0x2310, 0x5000, 0x4200)
SYNC_READ = b"\x05\x10\x00"  # 1005h in an SDO frame


def disturb_boot(arm: UsedArm, deck: Deck) -> None:
    """Boots the boards with one disturbance, and judges what becomes of them; then they are ready."""
    random = arm.random
    if random.random() < 0.7:
        arm.running, arm.calm, arm.ready = None, False, False
        arm.change(0.4)
    name = random.choice(list(arm.looks))
    kind = random.choice([_frame, _frame, _restart, _restart, _restarts, _error, *[_fault] * 4])
    arm.made[f"boot with: {kind.__name__[1:]}"] += 1
    arm.note(f"boot with {kind.__name__[1:]} of {name}")
    kind(arm, name, deck)
    arm.mend()
    if not arm.ready:
        arm.calm = False
        arm.repair()
        arm.boot(new=True)


def _at_frame(arm: UsedArm, name: str, at: int, happen: Callable[[], str], only: int = 0) -> None:
    """Calls a function at an SDO frame of a board; `only`: index of the object whose frames count."""
    count, node = [0], int(name.split("/")[1])

    def look(frame: Frame) -> str:
        sdo = frame.id in (0x600 + node, 0x580 + node)
        if not sdo or (only and int.from_bytes(frame.data[1:3], "little") != only):
            return ""
        count[0] += 1
        return happen() if count[0] == at + 1 and arm.running is not None and arm.master.booting.under_way else ""

    arm.buses[name.split("/")[0]].intercept = look


def _draw_place(arm: UsedArm) -> int:
    return arm.random.choice([0, 1, 2, 3, arm.random.randrange(40), arm.random.randrange(100)])


def _frame(arm: UsedArm, name: str, deck: Deck) -> None:
    """One SDO frame is lost, late or doubled: the boot ends as without it."""
    place, what = _draw_place(arm), arm.random.choice(["lose", "lose", "late", "twice"])
    if arm.board(name).state is not State.OPERATIONAL:
        place += 6  # a board that was stopped is asked once more only
    _at_frame(arm, name, place, lambda: what)
    arm.boot(new=True)


def _restart(arm: UsedArm, name: str, deck: Deck) -> None:
    """The board restarts once, and boots anew."""

    def cut() -> None:
        if arm.master.booting.under_way:
            _cut_supply(arm, name)
            arm.boots.again(name)

    def restart() -> str:
        arm.agenda.after(1e-6, cut)
        return "lose"

    outputs = arm.random.random() < 0.5
    place, only = (arm.random.randrange(12), arm.judged.boards[name].base) if outputs else (_draw_place(arm), 0)
    _at_frame(arm, name, place, restart, only)
    arm.boot(new=True)


def _restarts(arm: UsedArm, name: str, deck: Deck) -> None:
    """The board restarts again and again at one place of its boot, and is refused for it."""
    board, restarts = arm.board(name), list[Frame]()
    if board.variant.boot_time or board.silent or not board.powered:
        return

    def look(frame: Frame) -> str:
        if frame.id != 0x600 + board.node or frame.data[1:4] != SYNC_READ:
            return ""
        restarts.append(frame)
        arm.agenda.after(1e-6, lambda: _cut_supply(arm, name))
        return "lose"

    arm.buses[name.split("/")[0]].intercept = look
    _boot_unjudged(arm)
    ours = [fault.code for fault in arm.master.booting.faults if fault.source == name]
    right = ours == ["board-rebooted"] and len(restarts) > MOST_RESTARTS
    require(right or (not restarts and len(ours) == 1), f"{name} restarted {len(restarts)} times, told is {ours}")


def _cut_supply(arm: UsedArm, name: str) -> None:
    for verb in ("power_cut", "power_on"):
        arm.boards.fault(verb, name)


def _error(arm: UsedArm, name: str, deck: Deck) -> None:
    """The board reports an error: it is refused."""
    code = arm.random.choice(ERRORS)

    def happen() -> str:
        arm.board(name).emergencies.report(code)
        now = arm.sight.found(name)
        arm.boots.found[name] = arm.boots.found[name]._replace(errors=now.errors, starts=now.starts, explained=True)
        return ""

    _at_frame(arm, name, arm.random.randrange(3, 30), happen)
    arm.boot(new=True)


def _fault(arm: UsedArm, name: str, deck: Deck) -> None:
    """A fault of the table: the boot ends, and that of a bus is told of it, and not of its boards."""
    drawn = deck.draw(arm, alone=False)
    if drawn is None:
        return
    (row, fault), struck = drawn, list[Fault]()
    lasts = fault.told is not None and fault.told.clears and row.strikes == "bus"
    arm.made[f"boot with: {row.name}"] += 1
    arm.note(f"boot with {row.name}")

    def happen() -> str:
        struck.append(fault)
        arm.agenda.after(1e-6, lambda: struck and fault.begin())
        if not lasts:
            arm.agenda.after(1e-6 + arm.random.uniform(0.0, row.longest), lambda: struck and fault.end())
        return ""

    _at_frame(arm, name, _draw_place(arm), happen)
    _boot_unjudged(arm)
    told = fault.told
    if struck and lasts and told is not None and told.lost and not told.also:
        here = [(one.code, one.source) for one in arm.master.booting.faults if one.source.startswith(told.sources[0])]
        lost = not arm.master.outputs_known and not arm.master.back
        require(here == [(told.codes[0], told.sources[0])] and lost, f"{row.name} in a boot, told is {here}")
    if struck:
        fault.end()
    struck.clear()


def _boot_unjudged(arm: UsedArm) -> None:
    arm.start_boot(new=True)
    arm.calm = False
    arm.wait(arm.at_rest, LONGEST_BOOT, "booted")
