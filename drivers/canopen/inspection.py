"""What a board is and holds, against what its wiring needs: the reads and verdicts of boot and of `check --bus`."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import dataclass, field

from drivers.canopen import cia301, configuration, objects
from drivers.canopen.board import Board
from drivers.canopen.faults import Fault
from drivers.canopen.layout import BoardLayout
from drivers.canopen.objects import Need
from drivers.canopen.pdo import INPUTS, OUTPUTS, Pdo, subs_of
from drivers.canopen.pdo_setup import Held
from drivers.canopen.procedure import BoardError, Step
from drivers.canopen.quirks import NONE, VENDORS, Quirk, quirk_of
from drivers.canopen.sdo import Outcome
from drivers.canopen.wiring import ErrorState, Timing

_PROFILE, _HAS_INPUTS, _HAS_OUTPUTS = 0x191, 1 << 16, 1 << 17  # of 1000h (CiA 401, 6.2)
MASTER_LOST, _COMMUNICATION = 0x8130, 0x11  # emergency, and the bits of 1001h that it sets


@dataclass
class Inspection:
    """What was read of one board, and what is to be done with it.

    Attributes:
        layout: its wiring.
        quirk: what is special about it.
        warnings: what a person should know of the board; a sentence each, without its name.
        held: values read or written, by index and sub-index.
        needs: that must be met, in the order of writing; PDOs and error mode are apart.
        error_mode: needs that must be met once the board is operational.
        has_error_mode: whether it has 6206h.
        synchronous: whether it takes SYNC.
        refuses_sync: whether it has refused RPDOs that wait for SYNC.
        kept_errors: bits of its error register that it keeps without a present cause.
        guarded: whether it is supervised by node guarding, instead of heartbeats.
        rpdos: the wanted RPDOs, and as they are.
        tpdos: the wanted TPDOs, and as they are.
    """

    layout: BoardLayout
    quirk: Quirk = NONE
    warnings: list[str] = field(default_factory=list)
    held: dict[tuple[int, int], int] = field(default_factory=dict)
    needs: list[Need] = field(default_factory=list)
    error_mode: list[Need] = field(default_factory=list)
    has_error_mode: bool = False
    synchronous: bool = True
    refuses_sync: bool = False
    kept_errors: int = 0
    guarded: bool = False
    rpdos: list[tuple[Pdo, Held]] = field(default_factory=list)
    tpdos: list[tuple[Pdo, Held]] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Of the board."""
        return self.layout.name

    def unmet(self, needs: Iterable[Need]) -> list[Need]:
        """Returns the needs that are not met, without those of objects that the board does not have."""
        return [n for n in needs if (n.index, n.sub) in self.held and not n.met(self.held[n.index, n.sub])]

    def warn(self, text: str) -> None:
        """Adds a warning."""
        if text not in self.warnings:
            self.warnings.append(text)


Reading = Generator[Step, Outcome, None]


def inspect(it: Inspection, kind: int, timing: Timing, error_state: ErrorState | None) -> Reading:
    """Reads all that matters but PDOs, and changes nothing.

    Args:
        it: takes what is read.
        kind: the board's device type, 1000h.
        timing: of heartbeats.
        error_state: what a person knows of boards without an error mode.

    Raises:
        BoardError: the board cannot do what its wiring needs, or does not answer.
    """
    yield from _identify(it)
    yield from _check_type(it, kind)
    yield from _supervision(it, timing)
    yield from _read(it, configuration.synchronisation())
    if (0x1005, 0) not in it.held:
        it.synchronous = False
        it.warn("it has no 1005h sub 0 (COB-ID of SYNC): its outputs switch at once with their frame, not on SYNC")
    if it.layout.outputs:
        yield from _outputs(it, error_state)
    yield from _read(it, configuration.interrupts(it.layout))


def read_errors(it: Inspection, board: Board | None) -> Generator[Step, Outcome, tuple[int, str, bool]]:
    """Reads the error register and, if it is set, the newest entry of the error history.

    Returns:
        The bits of 1001h that stand for a fault; all in words, with the emergency that was heard; and whether the error
        is that the master was not heard, which ends when its heartbeats return.
    """
    register = yield from objects.read(it.name, 0x1001, 0, fresh=True)
    register &= ~it.quirk.ignored_errors
    if not register:
        return 0, "", False
    lost = False
    text = f"error register 1001h sub 0 holds {register:02X}h; 00h is needed"
    history = yield from objects.find(it.name, 0x1003, 1, 4)
    if history:
        text += f"; 1003h sub 1 holds {history:08X}h, {cia301.emergency_words(history & 0xFFFF)}"
        lost = history & 0xFFFF == MASTER_LOST and not register & ~_COMMUNICATION
    if board is not None and board.emergency is not None:
        text += f"; it reported {cia301.emergency_words(board.emergency)}"
    return register, text, lost


def settle(it: Inspection, needs: list[Need]) -> Reading:
    """Writes what differs, and reads it back."""
    for need in it.unmet(needs):
        yield from objects.settle(it.name, need, it.held[need.index, need.sub])
        it.held[need.index, need.sub] = need.corrected(it.held[need.index, need.sub])


def _identify(it: Inspection) -> Reading:
    vendor = yield from objects.find(it.name, 0x1018, 1, 4)
    product = None
    if vendor in VENDORS:
        product = yield from objects.find(it.name, 0x1018, 2, 4)
    it.quirk = quirk_of(vendor, product)
    yield from _read(it, configuration.identity(it.layout.settings))


def _check_type(it: Inspection, kind: int) -> Reading:
    """Checks 1000h, and how many bytes of outputs and inputs there are: not every coupler sets the bits of 1000h."""
    settings = it.layout.settings
    if settings.object == OUTPUTS and kind & 0xFFFF != _PROFILE:
        text = (
            f"board {it.name} holds {kind:08X}h in 1000h sub 0 (device type), not the profile 0191h of CiA 401 with"
            " outputs in 6200h: is the node id right? A board with outputs in an object of its maker needs `object` in"
            " the arm's file"
        )
        raise BoardError(Fault("wrong-device", it.name, text))
    for bits, base, flag, what in (
        (it.layout.output_bits, settings.object, _HAS_OUTPUTS, "outputs"),
        (it.layout.input_bits, INPUTS, _HAS_INPUTS, "inputs"),
    ):
        if not bits:
            continue
        count = yield from objects.find(it.name, base, 0)
        subs = subs_of(bits)
        if not count or count < subs[-1]:
            has = "no" if not count else f"{count} bytes of"
            text = f"board {it.name} has {has} {what} in {base:04X}h; sub {subs[-1]} is needed, the wiring uses it"
            raise BoardError(Fault("wrong-device", it.name, f"{text} (1000h sub 0 holds {kind:08X}h)"))
        if base in (OUTPUTS, INPUTS) and kind & 0xFFFF == _PROFILE and not kind & flag:
            it.warn(f"1000h sub 0 holds {kind:08X}h, without the bit of digital {what}, but {base:04X}h is there")


def _supervision(it: Inspection, timing: Timing) -> Reading:
    """Chooses heartbeats, or node guarding where the board lacks one of the two objects of heartbeats."""
    beats, guard = configuration.heartbeats(timing), configuration.guarding(timing)
    yield from _read(it, [*beats, guard[0]], [])
    if (guard[0].index, guard[0].sub) in it.held:
        yield from _read(it, guard[1:], [])
    beating, guarding = (all((n.index, n.sub) in it.held for n in needs) for needs in (beats, guard))
    it.guarded = guarding and (it.quirk.guarding or not beating)
    if not (beating or guarding):
        text = (
            f"board {it.name} has neither 1016h sub 1 and 1017h (heartbeats) nor 100Ch and 100Dh (node guarding): it"
            " would not notice that the executor has ended, and would not be noticed if it fails"
        )
        raise BoardError(Fault("wrong-device", it.name, text))
    # Some boards allow only one of the two at a time: the other is switched off first.
    off = [Need(n.index, n.sub, 0, n.size, n.what) for n in (beats if it.guarded else guard)]
    it.needs = [*off, *(guard if it.guarded else beats), *it.needs]
    lost = configuration.on_master_lost(it.layout)
    yield from _read(it, [lost])
    if (lost.index, lost.sub) not in it.held:
        it.warn(f"it has no {lost.place}; it is taken to go pre-operational when the master is lost, as CiA 301 has it")


def _outputs(it: Inspection, error_state: ErrorState | None) -> Reading:
    """Checks polarity, filter and error mode; a maker's object has none of them."""
    layout = it.layout
    if layout.settings.object == OUTPUTS:
        yield from _read(it, configuration.polarity(layout) + configuration.filters(layout))
        yield from _read(it, configuration.error_mode(layout), it.error_mode)
    it.has_error_mode = any(index == 0x6206 for index, _ in it.held)
    if it.has_error_mode:
        return
    missing = "6206h (error mode)" if layout.settings.object == OUTPUTS else "error mode for its maker's object"
    if layout.loss[0]:
        text = f"board {it.name} has no {missing}; it is needed: with on_loss: contract, or with pulses, its outputs"
        raise BoardError(Fault("wrong-device", it.name, f"{text} must go off when the master is lost"))
    state = layout.settings.error_state or error_state
    if state is None:
        text = (
            f"board {it.name} has no {missing}, so what its outputs do when the master is lost cannot be read or"
            " written: if you know it, set boards.error_state to off, hold or device in the arm's file"
        )
        raise BoardError(Fault("wrong-device", it.name, text))
    does = {"off": "go off", "hold": "hold", "device": "do what the device is set to"}[state]
    it.warn(f"it has no {missing}; by the arm's file (error_state) its outputs {does} when the master is lost")


def _read(it: Inspection, needs: list[Need], into: list[Need] | None = None) -> Reading:
    """Reads the objects of needs, and keeps the needs."""
    for need in needs:
        place = need.index, need.sub
        if place not in it.held:
            held = yield from objects.check(it.name, need)
            if held is not None:
                it.held[place] = held
    target = it.needs if into is None else into
    target += [need for need in needs if need.fixed is None]
