"""What other programs and faults leave on a board while no executor runs: the next boot corrects or refuses it.

Without codes in `told` the boot makes the board ready. Else it refuses the board, and leaves it as it was.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from hyperbit.drivers.canopen.wire.cia301 import Command, State
from tests.simulation.faults.fault import NOTHING, Fault, Maker, Place, Told, row
from tests.simulation.faults.reads import HARDWARE_ERROR
from tests.simulation.statements.boards import bytes_of

MASTER, OUTPUTS = 127, 0x6200
BUSY, BUSY_FOR = 0x0800_0022, 0.2  # abort code of a board that cannot answer now, and for how long [s]
CORRECTED: tuple[tuple[int, int, tuple[int, ...]], ...] = (  # index, sub-index, wrong values
    *((0x1005, 0, (0x85, 0x4000_0080)), (0x1006, 0, (1_000_000,)), (0x1007, 0, (10_000,)), (0x1019, 0, (10,))),
    *((0x1014, 0, (0x8000_0081, 0xEE)), (0x100C, 0, (0, 500)), (0x100D, 0, (0, 9)), (0x1029, 1, (0, 1, 2))),
    (0x1016, 1, (127 << 16 | 5000, 127 << 16 | 30_000, 127 << 16, 0, 3 << 16 | 1000, 5 << 16 | 100)),
    *((0x1017, 0, (0, 200, 400, 700)), (0x6005, 0, (0,)), (0x6006, 1, (0, 0x55)), (0x6006, 2, (0,))),
    *((0x6208, 1, (0, 0xF0)), (0x6208, 2, (0,)), (0x6207, 1, (0xFF, 0x0F)), (0x6207, 2, (0xFF,))),
    *((0x6206, 1, (0, 0xFF, 0x55)), (0x6206, 2, (0, 0xFF, 0xAA)), (0x6206, 8, (0, 0xFF))),
    *((0x1400, 1, (1 << 31 | 0x201, 0x333, 0x401)), (0x1400, 2, (0, 2, 240, 254, 255)), (0x1400, 5, (200,))),
    *((0x1600, 0, (0, 1, 3, 7)), (0x1600, 1, (0x6200_0208,)), (0x1800, 1, (1 << 31 | 0x181, 0x4000_0333))),
    *((0x1800, 2, (1, 254)), (0x1800, 3, (1000,)), (0x1800, 5, (0, 50)), (0x1A00, 0, (0, 1, 7))),
    (0x1A00, 1, (0x6000_0208,)),
)
DEAF = ((0x1005, 0, 0x85), (0x1006, 0, 1000), (0x1029, 1, 1), (0x6005, 0, 0), (0x1007, 0, 7))
ERRORS = ((0xFF00, 0x80), (0x5000, 0x01), (0x2310, 0x03), (0x4200, 0x08), (0x8140, 0x10))


def left(make: Callable[[Place], Fault | None]) -> Maker:
    """Adds what is left on a board that answers SDO, and may be found in another state."""

    def checked(at: Place) -> Fault | None:
        if at.board.state in (None, State.STOPPED):
            return None
        fault, ordered = make(at), at.random.random() < 0.3
        if fault is None or not ordered:
            return fault
        return fault._replace(begin=lambda: (fault.begin(), _order(at)))

    checked.__name__ = make.__name__
    return row("left")(checked)


def _order(at: Place) -> None:
    tells = at.objects.has(0x100C) or at.objects.number(0x1017)  # else nobody can find a stopped board
    at.world.order(at.name, at.random.choice([Command.PRE_OPERATIONAL, *([Command.STOP] if tells else [])]))


def _refusal(at: Place, code: str, *words: str) -> Told:
    return Told((code,), (at.name,), words)


def _entries(at: Place) -> Iterator[tuple[int, int, int]]:
    """Yields drawn objects with wrong values that the board takes."""
    objects, variant = at.objects, at.objects.variant
    for index, sub, values in at.random.sample(CORRECTED, at.random.choice([1, 1, 2, 4, 7])):
        entry, value = objects.described.get(index, {}).get(sub), at.random.choice(values)
        if entry is None or not entry.writable:
            continue
        if 0x1400 <= index < 0x1C00 and (variant.read_only or variant.absent or variant.changes):
            continue
        if 0x1400 <= index < 0x1C00 and not variant.synchronous:
            continue  # it takes no such value back after a refusal
        if index in (0x6206, 0x6207) and at.judged.pairs:
            continue  # a coil might come on at once, in the error state
        if index == 0x6207:
            value &= at.judged.used >> 8 * (sub - 1) & 0xFF  # START would switch off what is not used
            if not value:
                continue
        watched = [objects.number(0x1016, other) >> 16 for other in objects.subs(0x1016) if other != sub]
        if index == 0x1016 and value >> 16 in watched:
            continue  # CiA 301 forbids a second entry for one node
        yield index, sub, value


@left
def another_configuration(at: Place) -> Fault:
    def begin() -> None:
        for index, sub, value in _entries(at):
            at.world.note(f"{at.name}: {index:04X}h sub {sub} gets {value:X}h")
            at.objects.set_number(index, sub, value)
            if at.board.powered and at.board.state is not None:
                at.board.outputs.written(index, sub)
                at.board.supervision.written(index, at.agenda.now)
        at.board.pdos.configure()
        at.board.drive()
        at.boards.set_timer()
        at.boards.see("fault")

    return Fault(begin)


@row("left")
def another_state(at: Place) -> Fault:
    return Fault(lambda: _order(at))


@row("left")
def supply_was_off(at: Place) -> Fault:
    def begin() -> None:
        at.boards.fault("power_cut", at.name)
        at.boards.fault("power_on", at.name)

    return Fault(begin)


@row("left")
def supply_is_off(at: Place) -> Fault:
    told = Told(("board-missing",), (at.name,), (), clears=True)
    return Fault(at.do("power_cut"), at.do("power_on"), told)


@row("left")
def board_is_not_connected(at: Place) -> Fault:
    told = Told(("board-missing",), (at.name,), (), clears=True)
    return Fault(at.do("silence"), at.do("unsilence"), told)


@left
def error_stands(at: Place) -> Fault:
    code, register = at.random.choice(ERRORS)
    return _errors(at, (code, register))


@left
def error_is_hidden(at: Place) -> Fault:
    """A newer entry of the history reports the loss of the master."""
    code, register = at.random.choice(ERRORS)
    return _errors(at, (code, register), (0x8130, 0x11))


def _errors(at: Place, *errors: tuple[int, int]) -> Fault:
    def begin() -> None:
        for code, register in errors:
            at.board.emergencies.report(code, register)

    def end() -> None:
        for code, _ in errors:
            at.board.emergencies.recover(code)

    return Fault(begin, end, _refusal(at, "board-error", "1001h", "Remove the cause"))


@left
def errors_have_ended(at: Place) -> Fault:
    """Their entries of the history stay, or have an end of their own."""

    def begin() -> None:
        for code, register in at.random.sample(ERRORS, 3):
            at.board.emergencies.report(code, register)
            at.board.emergencies.recover(code)

    return Fault(begin)


@left
def object_cannot_be_read(at: Place) -> Fault | None:
    index, sub = at.random.choice([*_read(at), (0x1001, 0), (0x1005, 0), (0x1018, 1), (0x1400, 2)])
    if index not in at.objects.described or (index == 0x1400 and not at.judged.used):
        return None

    def begin() -> None:
        at.objects.refused[index, sub] = HARDWARE_ERROR

    told = _refusal(at, "sdo-refused", f"{index:04X}h sub {sub}", "hardware error")
    return Fault(begin, at.objects.refused.clear, told)


def _read(at: Place) -> list[tuple[int, int]]:
    """Returns the bytes of outputs and inputs that a boot reads."""
    outputs, inputs = bytes_of(at.judged.used), bytes_of(at.judged.sensed)
    return [(at.judged.base, sub) for sub in outputs] + [(0x6000, sub) for sub in inputs]


@left
def board_is_busy(at: Place) -> Fault:
    """It refuses an object for its present state: the boot asks again."""

    def begin() -> None:
        at.objects.refused[at.random.choice([(0x1000, 0), (0x1018, 1), (0x1005, 0)])] = BUSY
        at.after(BUSY_FOR, at.objects.refused.clear)

    return Fault(begin, at.objects.refused.clear)


@left
def board_ignores_a_write(at: Place) -> Fault | None:
    index, sub, value = at.random.choice(DEAF)
    if not at.objects.has(index) or (index == 0x1029 and not at.objects.described[index][sub].writable):
        return None
    variant = at.objects.variant

    def begin() -> None:
        at.objects.variant = replace(variant, deaf=variant.deaf | {index})
        at.objects.set_number(index, sub, value)

    def end() -> None:
        at.objects.variant = variant

    needed = index != 0x6005 or at.judged.sensed
    return Fault(begin, end, _refusal(at, "sdo-refused", f"{index:04X}h sub {sub}") if needed else NOTHING)


@left
def outputs_were_written(at: Place) -> Fault:
    base = at.board.variant.output_object

    def begin() -> None:
        for sub in at.objects.subs(base):
            at.objects.set_number(base, sub, at.random.getrandbits(8) & at.random.getrandbits(8))
            at.board.outputs.written(base, sub)
        at.board.drive()
        at.boards.see("fault")

    return Fault(begin, told=None)  # both outputs of an actuator may be on


@left
def another_device(at: Place) -> Fault | None:
    kind = at.random.choice([402, 0x0003_0192])
    if at.board.variant.output_object != OUTPUTS:
        return None
    other = at.objects.described[0x1000][0]._replace(default=kind.to_bytes(4, "little"))
    return _described(at, {**at.objects.described, 0x1000: {0: other}}, f"{kind:08X}h in 1000h", "0191h")


@left
def board_is_unsupervised(at: Place) -> Fault:
    described = {k: v for k, v in at.objects.described.items() if k not in (0x1016, 0x100C)}
    return _described(at, described, "1016h", "100Ch")


def _described(at: Place, described: object, *words: str) -> Fault:
    before = at.objects.described

    def begin() -> None:
        at.objects.described = described

    def end() -> None:
        at.objects.described = before

    return Fault(begin, end, _refusal(at, "wrong-device", *words))


@left
def outputs_are_inverted(at: Place) -> Fault | None:
    used = at.judged.used
    if not at.objects.has(0x6202) or at.objects.number(0x6202, 1) or not used or at.judged.pairs:
        return None

    def invert(polarity: int) -> Callable[[], None]:
        def write() -> None:
            for sub in at.objects.subs(0x6202):
                at.objects.set_number(0x6202, sub, polarity)
            at.board.drive()
            at.boards.see("fault")

        return write

    return Fault(invert(0xFF), invert(0), _refusal(at, "wrong-device", "6202h", "polarity"))
