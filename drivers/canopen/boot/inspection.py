"""Reads a board's objects and compares them with the needs of its wiring, for the boot and for `check --bus`."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field

from hyperbit.drivers.canopen.boot import board_needs
from hyperbit.drivers.canopen.boot.quirks import NONE, VENDORS, Quirk, quirk_of
from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import INPUTS, OUTPUTS, Pdo, subs_of
from hyperbit.drivers.canopen.sdo.client import SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.errors import Errors
from hyperbit.drivers.canopen.sdo.objects import Need, unwatchable
from hyperbit.drivers.canopen.sdo.procedure import Procedure, Step
from hyperbit.drivers.canopen.wiring import MASTER, Timing

_PROFILE, _HAS_INPUTS, _HAS_OUTPUTS = 0x191, 1 << 16, 1 << 17  # of 1000h (CiA 401, 6.2)
_NO_PROFILE = (0, 0xFFFF)  # low words of 1000h: no profile, or several devices (CiA 301, 7.5.2.1)


@dataclass
class Inspection:
    """What the wiring needs of one board, and what the boot chooses by the values of its objects."""

    layout: BoardLayout
    objects: Dictionary
    timing: Timing
    quirk: Quirk = NONE
    warnings: list[str] = field(default_factory=list)  # sentences on the limits of the board, without its name
    needs: list[Need] = field(default_factory=list)  # in the order of writing, without PDOs and error mode
    error_mode: list[Need] = field(default_factory=list)  # needs that are written when the board is operational
    refuses_sync: bool = False  # the board has refused a synchronous transmission type of its RPDOs
    kept: Errors | None = None  # errors that stay without a present cause
    guarded: bool = False  # supervised by node guarding in place of heartbeats
    rpdos: list[Pdo] = field(default_factory=list)  # wanted ones, each with the `parameters` of the board's PDO for it
    tpdos: list[Pdo] = field(default_factory=list)  # likewise
    bringing: list[int] = field(default_factory=list)  # `parameters` of further TPDOs, which have watched objects

    @property
    def name(self) -> str:
        return self.layout.name

    @property
    def synchronous(self) -> bool:
        """Whether the board has 1005h, so it receives SYNC."""
        return (0x1005, 0) in self.objects.values

    @property
    def has_error_mode(self) -> bool:
        return any(index == 0x6206 for index, _ in self.objects.values)

    def warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)


def inspect(it: Inspection) -> Procedure:
    """Reads all relevant objects except 1000h, which was read before, and PDOs; writes nothing."""
    yield from _identify(it)
    yield from _check_type(it)
    yield from _supervision(it)
    yield from _read(it, board_needs.synchronisation() + board_needs.emergencies(it.layout.node))
    if not it.synchronous and it.layout.outputs:
        it.warn("it has no 1005h sub 0 (COB-ID of SYNC): its outputs switch at once with their frame, not on SYNC")
    if it.layout.outputs:
        yield from _outputs(it)
    yield from _error_behaviour(it)
    yield from _read(it, board_needs.interrupts(it.layout))
    for k, each in enumerate(it.layout.watched):
        outcome = yield from it.objects.answered(Transfer(*each))
        if fault := unwatchable(it.name, *each, it.layout.watched_bits(k).bit_length() - 1, outcome):
            it.objects.refuse(fault.code, fault.message, each)


def _identify(it: Inspection) -> Procedure:
    vendor = yield from it.objects.find(0x1018, 1, 4)
    product = None
    if vendor in VENDORS:
        product = yield from it.objects.find(0x1018, 2, 4)
    it.quirk = quirk_of(vendor, product)
    yield from _read(it, board_needs.identity(it.layout.settings))


def _check_type(it: Inspection) -> Procedure:
    """Checks the device type, 1000h, and the number of output and input bytes.

    The bits of 1000h alone do not suffice: not every coupler sets them.
    """
    settings, kind = it.layout.settings, it.objects.values[0x1000, 0]
    if settings.object == OUTPUTS and kind & 0xFFFF != _PROFILE:
        yield from _check_without_profile(it, kind)
    for bits, base, flag, what in (
        (it.layout.output_bits, settings.object, _HAS_OUTPUTS, "outputs"),
        (it.layout.input_bits, INPUTS, _HAS_INPUTS, "inputs"),
    ):
        if not bits:
            continue
        count = yield from it.objects.find(base, 0)
        subs = subs_of(bits)
        if not count or count < subs[-1]:
            has = "no" if not count else f"{count} bytes of"
            text = f"board {it.name} has {has} {what} in {base:04X}h; sub {subs[-1]} is needed, the wiring uses it"
            it.objects.refuse("wrong-device", f"{text} (1000h sub 0 is {kind:08X}h)", (base, 0))
        if base in (OUTPUTS, INPUTS) and kind & 0xFFFF == _PROFILE and not kind & flag:
            it.warn(f"1000h sub 0 is {kind:08X}h, without the bit of digital {what}, but {base:04X}h is there")


def _check_without_profile(it: Inspection, kind: int) -> Procedure:
    """Accepts a device type without profile 401 if it names no other profile and the objects exist."""
    bits, base = (it.layout.output_bits, OUTPUTS) if it.layout.outputs else (it.layout.input_bits, INPUTS)
    text = f"{kind:08X}h in 1000h sub 0 (device type), not the profile 0191h of CiA 401"
    if kind & 0xFFFF in _NO_PROFILE and (yield from it.objects.find(base, 0)):
        it.warn(f"it has {text}, but {base:04X}h sub {subs_of(bits)[-1]} is there")
        return
    advice = "is the node id right? A board with outputs in an object of its maker needs `object` in the arm's file"
    text = f"board {it.name} has {text} with outputs in 6200h: {advice}"
    it.objects.refuse("wrong-device", text, (0x1000, 0))


def _supervision(it: Inspection) -> Procedure:
    """Selects heartbeats, or node guarding if the board lacks 1016h or 1017h."""
    beats, guard = board_needs.heartbeats(it.timing, (yield from _entry(it))), board_needs.guarding(it.timing)
    values = it.objects.values
    yield from _read(it, [*beats, guard[0]], [])
    if guard[0].at in values:
        yield from _read(it, guard[1:], [])
    beating, guarding = (all(need.at in values for need in needs) for needs in (beats, guard))
    it.guarded = guarding and (it.quirk.guarding or not beating)
    if not (beating or guarding):
        text = (
            f"board {it.name} has neither 1016h sub 1 and 1017h (heartbeats) nor 100Ch and 100Dh (node guarding): it"
            " would not notice that the executor has ended, and would not be noticed if it fails"
        )
        it.objects.refuse("wrong-device", text, *(need.at for need in (*beats, *guard)))
    # Some boards allow only one of the two: the other one is switched off first.
    off = [Need(n.index, n.sub, 0, n.size, n.what) for n in (beats if it.guarded else guard)]
    it.needs = [*off, *(guard if it.guarded else beats), *it.needs]


def _entry(it: Inspection) -> Generator[Step, SdoOutcome, int]:
    """Returns the entry of 1016h that watches the master already, else the first free one, else the first."""
    count = yield from it.objects.find(0x1016, 0)
    for sub in range(1, 1 + (count or 0)):
        if (yield from it.objects.read(0x1016, sub, 4)) >> 16 & 0x7F == MASTER:
            return sub
    free = [sub for sub in range(1, 1 + (count or 0)) if not it.objects.values[0x1016, sub] & 0xFFFF]
    return free[0] if free else 1


def _error_behaviour(it: Inspection) -> Procedure:
    """Reads 1029h. A board with an error mode needs it if its outputs must go off."""
    lost = board_needs.on_master_lost(it.layout, required=it.has_error_mode)
    yield from _read(it, [lost])
    if lost.at not in it.objects.values:
        it.warn(f"it has no {lost.place}; CiA 301 makes it enter pre-operational when the master is lost")


def _outputs(it: Inspection) -> Procedure:
    """Checks polarity, filter and error mode of the outputs; a maker's object has none of these."""
    layout, state = it.layout, it.layout.settings.error_state
    goes_off = state == "off" and layout.loss_is_off  # goes off by itself, as required
    missing, places = f"error mode for its maker's object {layout.settings.object:04X}h", [(layout.settings.object, 0)]
    if layout.settings.object == OUTPUTS:
        missing, places = "6206h (error mode)", [(0x6206, sub) for sub in subs_of(layout.output_bits)]
        yield from _read(it, board_needs.polarity(layout) + board_needs.filters(layout))
        yield from _read(it, board_needs.error_mode(layout, required=not goes_off), it.error_mode)
    if it.has_error_mode:
        return
    lacks = f"board {it.name} has no {missing}"
    if layout.loss[0] and not goes_off:
        text = f"{lacks}; it is needed: with on_loss: contract, or with pulses, its outputs must go off when the master"
        text += " is lost; if they do so by themselves, set boards.error_state to off"
        it.objects.refuse("wrong-device", text, *places)
    elif state is None:
        text = f"{lacks}, so what its outputs do when the master is lost cannot be read or written: if you know it, set"
        text += " boards.error_state to off, hold or device in the arm's file"
        it.objects.refuse("wrong-device", text, *places)
    else:
        does = {"off": "go off", "hold": "hold", "device": "do what the device is set to"}[state]
        it.warn(f"it has no {missing}; by the arm's file (error_state) its outputs {does} when the master is lost")


def _read(it: Inspection, needs: list[Need], into: list[Need] | None = None) -> Procedure:
    """Reads the objects of needs, and collects the needs that may be written."""
    for need in needs:
        yield from it.objects.check(need)
    target = it.needs if into is None else into
    target += [need for need in needs if need.fixed is None]
