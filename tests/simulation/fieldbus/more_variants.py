"""Further variants of boards: other PDOs, foreign objects in them, and objects that are missing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from random import Random

from hyperbit.drivers.simulation.dictionary import Object, array, number, pdo, standard
from hyperbit.drivers.simulation.variants import STANDARD, VARIANTS, Variant

ANALOG = array(0x6411, [0x1234, 0x5678, 0x0BAD, 0xFACE], size=2, mappable=True)
DISABLED, NO_REMOTE = 1 << 31, 1 << 30


def entries(index: int, subs: range, bits: int = 8) -> list[int]:
    return [index << 16 | sub << 8 | bits for sub in subs]


def _without(index: int, *subs: int) -> Mapping[tuple[int, int], Object]:
    return {(index, sub): entry for sub, entry in standard()[index].items() if sub not in subs}


def _fixed(index: int, *subs: int) -> Mapping[tuple[int, int], Object]:
    return {
        (index, sub): entry._replace(writable=entry.writable and sub not in subs)
        for sub, entry in standard()[index].items()
    }


MORE: Mapping[str, Variant] = {
    "foreign objects in RPDO1": Variant(
        "RPDO1 also carries analog outputs, read-only",
        changes={
            **ANALOG,
            **pdo(
                0x1400,
                0x200,
                [*entries(0x6411, range(1, 2), 16), *entries(0x6200, range(1, 5)), *entries(0x6411, range(2, 3), 16)],
                fixed=True,
            ),
        },
    ),
    "outputs in two RPDOs": Variant(
        "RPDO1 carries bytes 5 to 8, RPDO2 bytes 1 to 4, read-only; RPDO3 has the COB-ID of RPDO2",
        changes={
            **ANALOG,
            **pdo(0x1402, 0x300, entries(0x6411, range(1, 5), 16)),
            **pdo(0x1400, 0x200, entries(0x6200, range(5, 9)), fixed=True),
            **pdo(0x1401, DISABLED | 0x300, entries(0x6200, range(1, 5)), fixed=True),
        },
    ),
    "inputs in two TPDOs": Variant(
        "TPDO1 carries bytes 3 to 8, TPDO3 bytes 1 and 2, read-only",
        changes={
            **pdo(0x1800, NO_REMOTE | 0x180, entries(0x6000, range(3, 9)), fixed=True),
            **pdo(0x1802, DISABLED | NO_REMOTE | 0x380, entries(0x6000, range(1, 3)), fixed=True),
        },
    ),
    "inputs in TPDO3": Variant(
        "inputs in TPDO3, disabled, read-only; TPDO1 is analog",
        changes={
            **array(0x6401, [0] * 4, size=2, writable=False, mappable=True),
            **pdo(0x1800, NO_REMOTE | 0x180, entries(0x6401, range(1, 5), 16), fixed=True),
            **pdo(0x1802, DISABLED | NO_REMOTE | 0x380, entries(0x6000, range(1, 9)), fixed=True),
        },
    ),
    "COB-ID is taken": Variant(
        "RPDO3 has the COB-ID that RPDO1 needs, and RPDO1 another one",
        changes={
            **ANALOG,
            **pdo(0x1400, 0x280, entries(0x6200, range(1, 9))),
            **pdo(0x1401, DISABLED, entries(0x6411, range(1, 5), 16)),
            **pdo(0x1402, 0x200, entries(0x6411, range(1, 5), 16)),
        },
    ),
    "no SYNC": Variant("no 1005h, 1006h", absent=frozenset({0x1005, 0x1006})),
    "fixed COB-IDs": Variant("COB-IDs of PDOs are read-only", changes={**_fixed(0x1400, 1), **_fixed(0x1800, 1)}),
    "fixed entries": Variant(
        "entries of mappings are read-only, but not their number",
        changes={**_fixed(0x1600, *range(1, 9)), **_fixed(0x1A00, *range(1, 9))},
    ),
    "fixed types": Variant("the type of RPDO1 is read-only: 255", changes={**_fixed(0x1400, 2)}, synchronous=False),
    "no inhibit time": Variant("no inhibit times", changes={**_without(0x1800, 3)}),
    "both supervisions": Variant(
        "heartbeats and node guarding", changes={(0x100C, 0): number(2, 500), (0x100D, 0): number(1, 3)}
    ),
    "mapped otherwise": Variant(
        "RPDO1 and TPDO1 map other bytes",
        changes={
            **pdo(0x1400, 0x200, entries(0x6200, range(8, 0, -1))),
            **pdo(0x1800, NO_REMOTE | 0x180, [0x6000_0808, 0x6000_0108]),
        },
    ),
    "unmapped": Variant(
        "RPDO1 and TPDO1 are disabled and empty",
        changes={**pdo(0x1400, DISABLED | 0x200, []), **pdo(0x1800, DISABLED | NO_REMOTE | 0x180, [])},
    ),
    "WAGO": replace(
        VARIANTS["many-outputs"],
        changes={
            **VARIANTS["many-outputs"].changes,
            **pdo(0x1401, DISABLED | 0x300, []),
            (0x1018, 0): number(1, 4),
            (0x1018, 1): number(4, 0x21),
            (0x1018, 2): number(4, 750),
            (0x1018, 3): number(4),
            (0x1018, 4): number(4),
        },
    ),
    "many without SYNC": replace(VARIANTS["many-outputs"], synchronous=False),
    "only outputs": Variant(
        "1000h with the bit of outputs alone", changes={(0x1000, 0): number(4, 0x0002_0191, writable=False)}
    ),
    "only inputs": Variant(
        "1000h with the bit of inputs alone", changes={(0x1000, 0): number(4, 0x0001_0191, writable=False)}
    ),
    "slow": replace(STANDARD, answer_delay=0.06),
    "late": replace(STANDARD, boot_time=0.3),
}


def enriched(random: Random, variant: Variant) -> Variant:
    """Returns a variant with further optional objects, and with values that another program has stored."""
    objects, changes, stored = variant.objects, dict(variant.changes), dict(variant.stored)

    def add(share: float, index: int, entries: Mapping[tuple[int, int], Object]) -> None:
        if random.random() < share and index not in {i for i, _ in variant.changes} and index not in variant.absent:
            changes.update(entries)

    def store(share: float, index: int, sub: int, *values: int) -> None:
        entry = objects.get(index, {}).get(sub)
        if random.random() < share and entry is not None and entry.writable and (index, sub) not in changes:
            stored[index, sub] = random.choice(values)

    count = objects.get(0x6200, objects[0x6000])[0].default[0]
    add(0.4, 0x1007, {(0x1007, 0): number(4, random.choice([0, 10_000]))})
    add(0.4, 0x1019, {(0x1019, 0): number(1, random.choice([0, 10]))})
    add(0.4, 0x6208, array(0x6208, [random.choice([0, 0xFF, 0x5A]) for _ in range(count)]))
    add(0.4, 0x6006, array(0x6006, [random.choice([0, 0xFF, 0x5A]) for _ in range(count)]))
    add(0.3, 0x1014, {(0x1014, 0): number(4, random.choice([0x80, DISABLED | 0x80]), relative=True)})
    watched = [random.choice([0, 0, 3 << 16 | 500, 5 << 16 | 300]) for _ in range(random.choice([1, 2, 3]))]
    add(0.3, 0x1016, array(0x1016, watched if len(set(watched) - {0}) == sum(map(bool, watched)) else [0, 0], size=4))
    store(0.15, 0x1005, 0, 0x85, 1 << 30 | 0x80)
    store(0.15, 0x1006, 0, 100_000)
    store(0.15, 0x6005, 0, 0)
    store(0.15, 0x1029, 1, 1, 2)
    store(0.15, 0x1400, 5, 300)
    store(0.15, 0x1800, 3, 500)
    store(0.15, 0x1800, 5, 77)
    return replace(variant, changes=changes, stored=stored)
