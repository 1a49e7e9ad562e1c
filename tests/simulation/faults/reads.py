"""Faults that only reads find: objects that change, outputs that do not follow, errors without an emergency."""

from __future__ import annotations

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.faults.fault import AT_ONCE, Fault, Place, Told, row
from tests.simulation.faults.sight import Bits
from tests.simulation.statements.boards import bytes_of

LONGEST_TURN = 6.0  # [s] that is worth waiting for
READ_BACK = 2.0  # [s] from a switch until outputs that do not follow are told: about a second, and eight reads
THREE_READS = 3.5  # [s]
HARDWARE_ERROR = 0x0606_0000
REGISTER, HISTORY = 0x1001, 0x1003


@row("board")
def another_program_writes(at: Place) -> Fault | None:
    if at.turn > LONGEST_TURN or not (objects := at.sight.needed(at.name)):
        return None
    index, sub, bits = at.random.choice(objects)
    before = at.objects.number(index, sub)
    value = before ^ at.random.choice([1 << k for k in range(32) if bits >> k & 1])
    words = (f"{index:04X}h sub {sub}", "is needed", "another program")
    told = Told(("board-changed",), (at.name,), words, at.turn, lost=(at.name,))
    return Fault(at.number(index, sub, value), at.number(index, sub, before), told)


@row("board")
def another_program_writes_what_is_not_used(at: Place) -> Fault | None:
    """Bits that the wiring does not use are of no concern."""
    if at.turn > LONGEST_TURN or not (objects := at.sight.unused(at.name)):
        return None
    index, sub, bits = at.random.choice(objects)
    before = at.objects.number(index, sub)
    return Fault(at.number(index, sub, before ^ bits), at.number(index, sub, before), Told(within=at.turn))


@row("board")
def error_without_an_emergency(at: Place) -> Fault | None:
    if at.turn > LONGEST_TURN or not at.objects.has(HISTORY) or at.objects.number(REGISTER):
        return None
    code, register = at.random.choice([0x2310, 0x5000, 0x8F00]), at.random.choice([1, 0x80, 0x05])

    def begin() -> None:
        for index, sub, value in ((HISTORY, 1, code), (HISTORY, 0, 1), (REGISTER, 0, register)):
            at.objects.set_number(index, sub, value)

    words = (f"1001h sub 0 is {register:02X}h", "1003h sub 1 is", f"({code:04X}h)", "Remove the cause")
    told = Told(("board-error",), (at.name,), words, at.turn + 0.5)
    return Fault(begin, at.number(REGISTER, 0, 0), told)


@row("board")
def error_for_a_moment(at: Place) -> Fault | None:
    """A register that is read once is no error yet."""
    if at.objects.number(REGISTER):
        return None
    seen: list[Frame] = []

    def read(frame: Frame) -> str:
        if frame.id == cia301.SDO_REQUEST + at.node and frame.data[1:4] == b"\x01\x10\x00":
            seen.append(frame)
            at.objects.set_number(REGISTER, 0, int(len(seen) == 1))
        return ""

    def end() -> None:
        at.bus.restore()
        at.objects.set_number(REGISTER, 0, 0)

    return Fault(at.intercept(read), end, Told(within=min(at.turn, LONGEST_TURN)))


@row("board")
def new_error_among_kept_ones(at: Place) -> Fault | None:
    """An error that a board keeps from before is known; only a new entry of its history tells another one."""
    kept = at.board.variant.keeps_loss and at.objects.number(REGISTER) and at.objects.has(HISTORY)
    if at.turn > LONGEST_TURN or not kept:
        return None

    def end() -> None:
        at.boards.fault("power_cut", at.name)
        at.boards.fault("power_on", at.name)

    told = Told(("board-error",), (at.name,), ("1001h sub 0 is 11h", "(2310h)"), at.turn + 0.5, ("board-rebooted",))
    return Fault(at.number(HISTORY, 1, 0x2310), end, told)


@row("board")
def emergency_that_stands(at: Place) -> Fault | None:
    """Bits of 1001h that an emergency has told are no further fault."""
    if at.turn > LONGEST_TURN or at.objects.number(REGISTER):
        return None

    def begin() -> None:
        at.objects.set_number(REGISTER, 0, 3)
        at.post(Frame(0x80 + at.node, b"\x10\x23\x03\0\0\0\0\0"))()

    told = Told(("emergency",), (at.name,), ("(2310h)",), AT_ONCE)
    return Fault(begin, at.number(REGISTER, 0, 0), told, lambda: at.world.pass_time(at.turn))


@row("board")
def another_program_writes_outputs(at: Place) -> Fault | None:
    if at.turn > LONGEST_TURN or not (outputs := _outputs(at)):
        return None
    base, sub, used = at.random.choice(outputs)
    bit = at.random.choice([1 << k for k in range(8) if used >> k & 1])
    before = at.objects.number(base, sub)
    words = (f"{used & (before ^ bit):02X}h in {base:04X}h sub {sub} (outputs)", f"{used & before:02X}h was switched")
    told = Told(("not-switched",), (at.name,), words, at.turn + 0.6, lost=(at.name,))
    return Fault(at.number(base, sub, before ^ bit), at.number(base, sub, before), told)


@row("board")
def another_program_writes_outputs_that_are_not_used(at: Place) -> Fault | None:
    if at.turn > LONGEST_TURN or not (outputs := _outputs(at)):
        return None
    base, sub, used = outputs[0]
    before = at.objects.number(base, sub)
    return Fault(at.number(base, sub, before ^ ~used & 0xFF), at.number(base, sub, before), Told(within=at.turn))


@row("board")
def answers_come_twice(at: Place) -> Fault | None:
    """Two boards have one node id: each SDO is answered twice."""
    if at.turn > LONGEST_TURN:
        return None
    twice = at.intercept(lambda frame: "twice" if at.is_answer(frame) else "")
    told = Told(("duplicate-node",), (at.name,), ("two boards", at.name), 1.5 * at.turn + 2.0, lost=(at.name,))
    return Fault(twice, at.bus.restore, told)


@row("board")
def board_loses_a_SYNC(at: Place) -> Fault | None:
    """Its outputs do not follow; an end-stop may tell first."""
    if (switch := at.world.switch_on(at.name)) is None:
        return None

    def begin() -> None:
        at.boards.loses = at.name, cia301.SYNC
        switch.begin()

    def end() -> None:
        at.boards.loses = None

    words = () if switch.also else ("does not follow RPDO and SYNC", "(outputs)")
    codes, sources = ("not-switched", *switch.also), (at.name, switch.label)
    told = Told(codes, sources, words, READ_BACK + switch.late, switch.also, lost=(at.name,))
    return Fault(begin, end, told)


@row("board")
def outputs_cannot_be_read(at: Place) -> Fault | None:
    if (switch := at.world.switch_on(at.name)) is None:
        return None
    base, sub = switch.place

    def begin() -> None:
        at.objects.refused[base, sub] = HARDWARE_ERROR
        switch.begin()

    words = (f"{base:04X}h sub {sub} (outputs)", "3 times in a row", "hardware error")
    told = Told(("not-verified",), (at.name,), words, THREE_READS + switch.late, lost=(at.name,))
    return Fault(begin, at.objects.refused.clear, told)


def _outputs(at: Place) -> list[Bits]:
    """Returns the used bits of each output byte, if no pulse is on, and reads compare them."""
    if not at.world.reads_outputs(at.name):
        return []
    return [(at.judged.base, sub, at.judged.used >> 8 * (sub - 1) & 0xFF) for sub in bytes_of(at.judged.used)]
