"""Variants of simulated boards: the ways in which boards on the market differ from a complete CiA 401 board."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal, NamedTuple

from hyperbit.drivers.canopen.wiring import Interlock, NodeWiring
from hyperbit.drivers.simulation import dictionary
from hyperbit.drivers.simulation.dictionary import Changes, Object, array, number, pdo

_DISABLED = 1 << 31  # of a PDO's COB-ID
_NO_REMOTE = 1 << 30
_NOTHING: Mapping[tuple[int, int], int] = MappingProxyType({})
_NO_CHANGES: Changes = MappingProxyType({})


class StandingError(NamedTuple):
    """An error that a board has from power-on until its repair."""

    code: int  # of its emergency
    register: int  # bits of 1001h


@dataclass(frozen=True, eq=False)
class Variant:
    """Differences from the standard board, which has all objects of board.eds, heartbeats, and 64 outputs in RPDO1."""

    text: str  # the peculiarity, for the command line
    absent: frozenset[int] = frozenset()  # indices of objects that the board lacks
    changes: Changes = field(default_factory=lambda: _NO_CHANGES)  # objects in place of standard ones, or in addition
    read_only: frozenset[int] = frozenset()  # indices of objects that SDO cannot write
    deaf: frozenset[int] = frozenset()  # indices of objects that confirm a write and keep their value
    # values in its flash memory, in place of the default values
    stored: Mapping[tuple[int, int], int] = field(default_factory=lambda: _NOTHING)
    output_object: int = 0x6200  # index of the array of output bytes
    synchronous: bool = True  # RPDOs may wait for SYNC
    one_supervision: bool = False  # allows only one of node guarding and heartbeats
    saves: bool = False  # each SDO write goes to the flash memory
    error_state: Literal["modes", "hold", "off"] = "modes"  # outputs then go as in 6206h and 6207h, hold, or off
    shows_error_state: bool = False  # an SDO read of 6200h shows the outputs in the error state, not the last command
    off_outside_operational: bool = False  # outputs are on in operational only
    time_step: int = 1  # heartbeat and guarding times are rounded down to multiples of it [ms]
    keeps_loss: bool = False  # the loss of the master stands until a reset, without an emergency 0000h
    keeps_outputs: bool = True  # through an NMT reset of communication
    no_object: int = 0x0602_0000  # abort code of an SDO to an absent object
    logs_ends: bool = False  # the end of an error is an entry of 1003h too
    pads: bool = False  # TPDOs are filled up to 8 bytes
    errors: tuple[StandingError, ...] = ()
    starts: bool = True  # obeys the NMT command that makes it operational also while 1001h is not 0
    answer_delay: float = 0.0  # of SDO answers [s]
    boot_time: float = 0.0  # from power-on, or an NMT reset of the node, to the boot-up message [s]

    @functools.cached_property
    def objects(self) -> dictionary.Objects:
        return dictionary.changed(self.absent, self.read_only, self.changes)


def _entries(index: int, first: int, count: int, bits: int = 8) -> list[int]:
    """Returns the mapping entries of `count` sub-indices of an object."""
    return [index << 16 | sub << 8 | bits for sub in range(first, first + count)]


def _device_type(value: int) -> Changes:
    return {(0x1000, 0): number(4, value, writable=False)}


_GUARDING = {(0x100C, 0): number(2), (0x100D, 0): number(1)}
_ERROR_MODES = frozenset({0x6206, 0x6207})
_MAPPINGS = frozenset({0x1600, 0x1A00})
_ANALOG = {  # RPDO2 to 4 and TPDO2 to 4 of couplers with analog modules (CiA 401, 6.1.2 and 6.1.3)
    **array(0x6401, [0] * 12, size=2, writable=False, mappable=True),
    **array(0x6411, [0] * 12, size=2, mappable=True),
    **pdo(0x1401, 0x300, _entries(0x6411, 1, 4, 16), fixed=True),
    **pdo(0x1402, 0x400, _entries(0x6411, 5, 4, 16), fixed=True),
    **pdo(0x1403, 0x500, _entries(0x6411, 9, 4, 16), fixed=True),
}
_SHORT = {
    key: entry
    for key, entry in {
        **pdo(0x1400, 0x200, _entries(0x6200, 1, 4)),
        **pdo(0x1800, _NO_REMOTE | 0x180, _entries(0x6000, 1, 4)),
    }.items()
    if key[1] <= 4 or key[0] in (0x1400, 0x1800)
}
_SIXTEEN_BYTES = {
    **array(0x6000, [0] * 16, writable=False, mappable=True),
    **array(0x6200, [0] * 16, mappable=True),
    **array(0x6202, [0] * 16),
    **array(0x6206, [0xFF] * 16),
    **array(0x6207, [0] * 16),
}


def _maker_object(index: int, error_state: Literal["hold", "off"]) -> Variant:
    """Returns a board whose outputs are in an object of its maker."""
    return Variant(
        f"outputs in {index:04X}h of the maker, no objects of CiA 401 but inputs",
        absent=frozenset({0x6200, 0x6202, 0x6206, 0x6207}),
        changes={
            **_device_type(0),
            **array(index, [0] * 8, mappable=True),
            **pdo(0x1400, 0x200, _entries(index, 1, 8)),
        },
        output_object=index,
        error_state=error_state,
    )


STANDARD = Variant("all objects of board.eds: heartbeats, 64 outputs in RPDO1, 64 inputs in TPDO1")

VARIANTS: Mapping[str, Variant] = {
    "standard": STANDARD,
    "guarding-only": Variant(
        "node guarding with life time, no heartbeats (Buerkert 8640)",
        absent=frozenset({0x1016, 0x1017, 0x1029}),
        changes=_GUARDING,
    ),
    "guarding-with-1029h": Variant(
        "node guarding, no heartbeats, and 1029h: stopped boards only answer remote frames",
        absent=frozenset({0x1016, 0x1017}),
        changes=_GUARDING,
    ),
    "rounded-guarding": Variant(
        "node guarding, no heartbeats; the guard time is rounded down to 10 ms",
        absent=frozenset({0x1016, 0x1017, 0x1029}),
        changes=_GUARDING,
        time_step=10,
    ),
    "rounded-heartbeats": Variant("heartbeat times are rounded down to 10 ms", time_step=10),
    "watched-already": Variant(
        "1016h sub 2 watches node 127 already, and no other sub-index may (CiA 301)",
        changes=array(0x1016, [0, 127 << 16 | 5000], size=4),
    ),
    "one-supervision": Variant(
        "guarding or heartbeats, not both at once; guarding as delivered (ifm)",
        changes=_GUARDING,
        stored={(0x100C, 0): 500, (0x100D, 0): 3},
        one_supervision=True,
    ),
    "unsupervised": Variant(
        "neither guarding nor a consumer of heartbeats", absent=frozenset({0x1016, 0x1029}), error_state="hold"
    ),
    "outputs-in-rpdo5": Variant(
        "outputs in RPDO5, which is disabled as delivered, fixed mapping; RPDO1 to 4 are analog (AVENTICS)",
        changes={
            **_ANALOG,
            **pdo(0x1400, 0x200, [], fixed=True),
            **pdo(0x1404, _DISABLED, _entries(0x6200, 1, 8), fixed=True),
        },
    ),
    "many-outputs": Variant(
        "128 outputs and inputs: the first 64 in RPDO1 and TPDO1, the others in RPDO5 and TPDO5, disabled (WAGO)",
        changes={
            **_ANALOG,
            **_SIXTEEN_BYTES,
            **pdo(0x1404, _DISABLED, _entries(0x6200, 9, 8)),
            **pdo(0x1804, _DISABLED | _NO_REMOTE, _entries(0x6000, 9, 8)),
        },
    ),
    "fixed-mapping": Variant("mappings are read-only", read_only=_MAPPINGS),
    "short-mapping": Variant("mappings have 4 entries, not 8", changes=_SHORT),
    "no-sync": Variant("refuses synchronous transmission types: outputs follow each RPDO at once", synchronous=False),
    "saves-writes": Variant("each SDO write goes to the flash memory (ifm)", saves=True),
    "no-output-bit": Variant(
        "1000h without the bit of digital outputs (Beckhoff with special terminals)", changes=_device_type(0x0000_0191)
    ),
    "no-device-type": Variant("1000h is 0, though 6200h is there", changes=_device_type(0)),
    "many-profiles": Variant("1000h is 0000FFFFh: several profiles, 6200h is there", changes=_device_type(0xFFFF)),
    "all-bits": Variant("1000h with all bits (Festo CPX, ifm)", changes=_device_type(0x000F_0191)),
    "maker-object": _maker_object(0x2201, "off"),
    "no-error-mode": Variant(
        "no 6206h and 6207h: outputs hold in the error state", absent=_ERROR_MODES, error_state="hold"
    ),
    "no-error-mode-off": Variant(
        "no 6206h and 6207h: outputs go off in the error state", absent=_ERROR_MODES, error_state="off"
    ),
    "no-error-behaviour": Variant("no 1029h: pre-operational in the error state", absent=frozenset({0x1029})),
    "canopennode": Variant(
        "no 6206h, 6207h and 1029h: outputs go off in the error state, 1003h has the ends of errors, no start while"
        " 1001h is not 0 (CANopenNode)",
        absent=_ERROR_MODES | {0x1029},
        error_state="off",
        logs_ends=True,
        starts=False,
    ),
    "absent-unsupported": Variant("answers 06010000h for absent objects", no_object=0x0601_0000),
    "absent-general": Variant("answers 08000000h for absent objects", no_object=0x0800_0000),
    "logged-ends": Variant("1003h has the ends of errors too (CANopenNode)", logs_ends=True),
    "deaf-error-mode": Variant("confirms writes of 6206h and 6207h, and ignores them", deaf=_ERROR_MODES),
    "shows-error-state": Variant(
        "6200h shows the outputs in the error state, and keeps the last command for the start", shows_error_state=True
    ),
    "off-in-preoperational": Variant(
        "no 6206h and 6207h: outputs are off in each state but operational",
        absent=_ERROR_MODES,
        error_state="off",
        off_outside_operational=True,
    ),
    "resets-outputs": Variant("an NMT reset of communication switches the outputs off", keeps_outputs=False),
    "slow-answers": Variant("SDO answers take 0.6 s", answer_delay=0.6),
    "late-boot": Variant("boots 5 s after power-on", boot_time=5.0),
    "foreign-sync": Variant("another SYNC identifier is stored: 1005h = 85h", stored={(0x1005, 0): 0x85}),
    "sync-counter": Variant(
        "a SYNC counter is stored: 1019h = 10", changes={(0x1019, 0): number(1)}, stored={(0x1019, 0): 10}
    ),
    "sync-period": Variant(
        "a SYNC period is stored: 1006h = 100 ms; if SYNCs stop, that is an error state (CANopenNode)",
        stored={(0x1006, 0): 100_000},
    ),
    "sync-window": Variant(
        "a synchronous window is stored, 1007h = 10 ms; RPDOs later after a SYNC are dropped",
        changes={(0x1007, 0): number(4)},
        stored={(0x1007, 0): 10_000},
    ),
    "no-emergencies": Variant(
        "1014h is disabled: no emergencies", changes={(0x1014, 0): number(4, _DISABLED | 0x80, relative=True)}
    ),
    "padded-tpdo": Variant("TPDOs have 8 bytes, whatever is mapped (zencan, c-open)", pads=True),
    "kept-loss": Variant(
        "1001h = 11h stands after the loss of the master, also when its heartbeats return (Lely)", keeps_loss=True
    ),
    "kept-loss-without-history": Variant(
        "1001h = 11h stands after the loss of the master, and there is no 1003h",
        absent=frozenset({0x1003}),
        keeps_loss=True,
    ),
    "valve-supply": Variant(
        "bit 0 of 2102h is the supply of the valves, in no PDO and without an emergency",
        changes={(0x2102, 0): number(1, writable=False)},
    ),
    "mapped-supply": Variant(
        "bit 0 of 2102h is the supply of the valves, in TPDO2 every 100 ms",
        changes={
            (0x2102, 0): number(1, writable=False, mappable=True),
            **pdo(0x1801, _NO_REMOTE | 0x280, [0x2102_0008], fixed=True),
        },
        stored={(0x1801, 5): 100},
    ),
    "inverted-outputs": Variant(
        "an inverted polarity is stored: 6202h = FFh", stored={(0x6202, sub): 0xFF for sub in range(1, 9)}
    ),
    "masked-inputs": Variant("TPDOs on changes of inputs are masked off: 6006h = 0", changes=array(0x6006, [0] * 8)),
    "standing-error": Variant("1001h = 80h stands, of the maker: FF00h", errors=(StandingError(0xFF00, 0x80),)),
    "generic-error": Variant("1001h = 01h stands: 1000h", errors=(StandingError(0x1000, 0x01),)),
    "blocking-error": Variant(
        "1001h = 01h stands, 5000h, and keeps it pre-operational", errors=(StandingError(0x5000, 0x01),), starts=False
    ),
}


def as_wired(variant: Variant, node: NodeWiring, error_state: str | None, locks: Iterable[Interlock]) -> Variant:
    """Returns a board with the identity and the object of its outputs that its entry in the arm's file asks for.

    Objects of interlocks are added as the least that their bits need: read-only, and in no PDO.

    Args:
        variant: of the board.
        node: the entry.
        error_state: of boards whose entry has none.
        locks: interlocks on the board.
    """
    if variant is STANDARD and node.object != variant.output_object:
        variant = _maker_object(node.object, "hold" if (node.error_state or error_state) == "hold" else "off")
    identity = enumerate((node.vendor, node.product, node.revision, node.serial), 1)
    own = {(0x1018, sub): value for sub, value in identity if value is not None}
    bits = {lock.watched: 0 for lock in locks if lock.watched and lock.watched.object not in variant.absent}
    bits = {
        it: max(lock.bit for lock in locks if lock.watched == it) for it in bits if it.object not in variant.objects
    }
    more: dict[tuple[int, int], Object] = {}
    for it, bit in bits.items():
        more |= {(it.object, 0): number(1, 254, writable=False)} if it.sub and (it.object, 0) not in more else {}
        more[it] = number(4 if bit > 15 else 2 if bit > 7 else 1, writable=False)
    if not (own or more):
        return variant
    return replace(variant, stored={**variant.stored, **own}, changes={**variant.changes, **more})


def choose(words: Iterable[str], boards: Iterable[str]) -> dict[str, Variant]:
    """Returns the variants that words name: "NAME" for all boards, or "can0/5=NAME" for one.

    A word for one board overrides a word for all boards; a later word overrides an earlier one. Raises ValueError for
    an unknown board or variant.
    """
    named = [word.rpartition("=")[::2] for word in words]
    names = list(boards)
    chosen: dict[str, Variant] = {}
    for board, name in sorted(named, key=lambda pair: pair[0] != ""):
        if name not in VARIANTS:
            raise ValueError(f"no variant {name} of boards, there are {', '.join(VARIANTS)}")
        if board and board not in names:
            raise ValueError(f"no board {board}, there are {', '.join(names)}")
        chosen.update(dict.fromkeys([board] if board else names, VARIANTS[name]))
    return chosen
