"""Reads a board's objects and compares them with the needs of its wiring, for the boot and for `check --bus`."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import dataclass, field

from hyperbit.drivers.canopen.boot import configuration
from hyperbit.drivers.canopen.boot.pdo_setup import PdoState
from hyperbit.drivers.canopen.boot.quirks import NONE, VENDORS, Quirk, quirk_of
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import INPUTS, OUTPUTS, Pdo, subs_of
from hyperbit.drivers.canopen.sdo import objects
from hyperbit.drivers.canopen.sdo.client import SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.errors import Errors
from hyperbit.drivers.canopen.sdo.objects import Need
from hyperbit.drivers.canopen.sdo.procedure import BoardError, Step
from hyperbit.drivers.canopen.wiring import MASTER, ErrorState, Timing

_PROFILE, _HAS_INPUTS, _HAS_OUTPUTS = 0x191, 1 << 16, 1 << 17  # of 1000h (CiA 401, 6.2)
_NO_PROFILE = (0, 0xFFFF)  # low words of 1000h: no profile, or several devices (CiA 301, 7.5.2.1)


@dataclass
class Inspection:
    """The values read from one board, and the needs of its wiring."""

    layout: BoardLayout
    quirk: Quirk = NONE
    warnings: list[str] = field(default_factory=list)  # sentences on the limits of the board, without its name
    values: dict[tuple[int, int], int] = field(default_factory=dict)  # read or written, by index and sub-index
    needs: list[Need] = field(default_factory=list)  # in the order of writing, without PDOs and error mode
    error_mode: list[Need] = field(default_factory=list)  # needs that are written when the board is operational
    has_error_mode: bool = False  # the board has 6206h
    synchronous: bool = True  # the board has 1005h, so it receives SYNC
    refuses_sync: bool = False  # the board has refused a synchronous transmission type of its RPDOs
    kept: Errors | None = None  # errors that stay without a present cause
    guarded: bool = False  # supervised by node guarding in place of heartbeats
    rpdos: list[tuple[Pdo, PdoState]] = field(default_factory=list)  # wanted ones, each with its present state
    tpdos: list[tuple[Pdo, PdoState]] = field(default_factory=list)  # likewise
    bringing: list[Pdo] = field(default_factory=list)  # further TPDOs, used as they are: they have watched objects

    @property
    def name(self) -> str:
        return self.layout.name

    def unmet(self, needs: Iterable[Need]) -> list[Need]:
        """Returns the unmet needs of objects that the board has."""
        return [n for n in needs if (n.index, n.sub) in self.values and not n.met(self.values[n.index, n.sub])]

    def warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)


Reading = Generator[Step, SdoOutcome, None]


def inspect(it: Inspection, kind: int, timing: Timing, error_state: ErrorState | None) -> Reading:
    """Reads all relevant objects except PDOs; writes nothing.

    `kind` is the device type, 1000h; `error_state` that of the arm's file, for boards without an error mode. Raises
    BoardError if the board cannot meet a need of its wiring, or does not answer.
    """
    yield from _identify(it)
    yield from _check_type(it, kind)
    yield from _supervision(it, timing)
    yield from _read(it, configuration.synchronisation() + configuration.emergencies(it.layout.node))
    if (0x1005, 0) not in it.values and it.layout.outputs:
        it.synchronous = False
        it.warn("it has no 1005h sub 0 (COB-ID of SYNC): its outputs switch at once with their frame, not on SYNC")
    if it.layout.outputs:
        yield from _outputs(it, error_state)
    yield from _error_behaviour(it)
    yield from _read(it, configuration.interrupts(it.layout))
    for k, each in enumerate(it.layout.watched):
        outcome = yield from objects.answered(it.name, Transfer(*each))
        objects.watched(it.name, *each, it.layout.watched_bits(k).bit_length() - 1, outcome)


def ensure(it: Inspection, needs: list[Need]) -> Reading:
    """Writes the values that differ, and reads them back."""
    for need in it.unmet(needs):
        yield from objects.ensure(it.name, need, it.values[need.index, need.sub])
        it.values[need.index, need.sub] = need.corrected(it.values[need.index, need.sub])


def _identify(it: Inspection) -> Reading:
    vendor = yield from objects.find(it.name, 0x1018, 1, 4)
    product = None
    if vendor in VENDORS:
        product = yield from objects.find(it.name, 0x1018, 2, 4)
    it.quirk = quirk_of(vendor, product)
    yield from _read(it, configuration.identity(it.layout.settings))


def _check_type(it: Inspection, kind: int) -> Reading:
    """Checks the device type, 1000h, and the number of output and input bytes.

    The bits of 1000h alone do not suffice: not every coupler sets them.
    """
    settings = it.layout.settings
    if settings.object == OUTPUTS and kind & 0xFFFF != _PROFILE:
        yield from _check_without_profile(it, kind)
    for bits, base, flag, what in (
        (it.layout.output_bits, settings.object, _HAS_OUTPUTS, "outputs"),
        (it.layout.input_bits, INPUTS, _HAS_INPUTS, "inputs"),
    ):
        if not bits:
            continue
        count = yield from objects.find(it.name, base, 0)
        it.values[base, 0] = count or 0
        subs = subs_of(bits)
        if not count or count < subs[-1]:
            has = "no" if not count else f"{count} bytes of"
            text = f"board {it.name} has {has} {what} in {base:04X}h; sub {subs[-1]} is needed, the wiring uses it"
            raise BoardError(ArmFault("wrong-device", it.name, f"{text} (1000h sub 0 is {kind:08X}h)"))
        if base in (OUTPUTS, INPUTS) and kind & 0xFFFF == _PROFILE and not kind & flag:
            it.warn(f"1000h sub 0 is {kind:08X}h, without the bit of digital {what}, but {base:04X}h is there")


def _check_without_profile(it: Inspection, kind: int) -> Reading:
    """Accepts a device type without profile 401 if it names no other profile and the objects exist."""
    bits, base = (it.layout.output_bits, OUTPUTS) if it.layout.outputs else (it.layout.input_bits, INPUTS)
    text = f"{kind:08X}h in 1000h sub 0 (device type), not the profile 0191h of CiA 401"
    if kind & 0xFFFF in _NO_PROFILE and (yield from objects.find(it.name, base, 0)):
        it.warn(f"it has {text}, but {base:04X}h sub {subs_of(bits)[-1]} is there")
        return
    advice = "is the node id right? A board with outputs in an object of its maker needs `object` in the arm's file"
    text = f"board {it.name} has {text} with outputs in 6200h: {advice}"
    raise BoardError(ArmFault("wrong-device", it.name, text))


def _supervision(it: Inspection, timing: Timing) -> Reading:
    """Selects heartbeats, or node guarding if the board lacks 1016h or 1017h."""
    beats, guard = configuration.heartbeats(timing, (yield from _entry(it))), configuration.guarding(timing)
    yield from _read(it, [*beats, guard[0]], [])
    if (guard[0].index, guard[0].sub) in it.values:
        yield from _read(it, guard[1:], [])
    beating, guarding = (all((n.index, n.sub) in it.values for n in needs) for needs in (beats, guard))
    it.guarded = guarding and (it.quirk.guarding or not beating)
    if not (beating or guarding):
        text = (
            f"board {it.name} has neither 1016h sub 1 and 1017h (heartbeats) nor 100Ch and 100Dh (node guarding): it"
            " would not notice that the executor has ended, and would not be noticed if it fails"
        )
        raise BoardError(ArmFault("wrong-device", it.name, text))
    # Some boards allow only one of the two: the other one is switched off first.
    off = [Need(n.index, n.sub, 0, n.size, n.what) for n in (beats if it.guarded else guard)]
    it.needs = [*off, *(guard if it.guarded else beats), *it.needs]


def _entry(it: Inspection) -> Generator[Step, SdoOutcome, int]:
    """Returns the entry of 1016h that watches the master already, else the first free one, else the first."""
    count = yield from objects.find(it.name, 0x1016, 0)
    for sub in range(1, 1 + (count or 0)):
        entry = it.values[0x1016, sub] = yield from objects.read(it.name, 0x1016, sub, 4)
        if entry >> 16 & 0x7F == MASTER:
            return sub
    free = [sub for sub in range(1, 1 + (count or 0)) if not it.values[0x1016, sub] & 0xFFFF]
    return free[0] if free else 1


def _error_behaviour(it: Inspection) -> Reading:
    """Reads 1029h. A board with an error mode needs it if its outputs must go off."""
    lost = configuration.on_master_lost(it.layout, required=it.has_error_mode)
    yield from _read(it, [lost])
    if (lost.index, lost.sub) not in it.values:
        it.warn(f"it has no {lost.place}; CiA 301 makes it enter pre-operational when the master is lost")


def _outputs(it: Inspection, error_state: ErrorState | None) -> Reading:
    """Checks polarity, filter and error mode of the outputs; a maker's object has none of these."""
    layout = it.layout
    state = layout.settings.error_state or error_state
    goes_off = state == "off" and layout.loss_is_off  # goes off by itself, as required
    if layout.settings.object == OUTPUTS:
        yield from _read(it, configuration.polarity(layout) + configuration.filters(layout))
        yield from _read(it, configuration.error_mode(layout, required=not goes_off), it.error_mode)
    it.has_error_mode = any(index == 0x6206 for index, _ in it.values)
    if it.has_error_mode:
        return
    own = f"error mode for its maker's object {layout.settings.object:04X}h"
    missing = "6206h (error mode)" if layout.settings.object == OUTPUTS else own
    if layout.loss[0] and not goes_off:
        text = f"board {it.name} has no {missing}; it is needed: with on_loss: contract, or with pulses, its outputs"
        text += " must go off when the master is lost; if they do so by themselves, set boards.error_state to off"
        raise BoardError(ArmFault("wrong-device", it.name, text))
    if state is None:
        text = (
            f"board {it.name} has no {missing}, so what its outputs do when the master is lost cannot be read or"
            " written: if you know it, set boards.error_state to off, hold or device in the arm's file"
        )
        raise BoardError(ArmFault("wrong-device", it.name, text))
    does = {"off": "go off", "hold": "hold", "device": "do what the device is set to"}[state]
    it.warn(f"it has no {missing}; by the arm's file (error_state) its outputs {does} when the master is lost")


def _read(it: Inspection, needs: list[Need], into: list[Need] | None = None) -> Reading:
    """Reads the objects of needs, and collects the needs that may be written."""
    for need in needs:
        place = need.index, need.sub
        if place not in it.values:
            present = yield from objects.check(it.name, need)
            if present is not None:
                it.values[place] = present
    target = it.needs if into is None else into
    target += [need for need in needs if need.fixed is None]
