"""Random wirings of few boards, with all variants of boards, also those that are refused."""

from __future__ import annotations

from collections.abc import Mapping
from random import Random
from typing import Any, NamedTuple

from hyperbit.drivers.canopen.wiring import BoardId, BusWiring, Channel, Interlock, NodeWiring, Timing, Wiring
from hyperbit.drivers.simulation.variants import VARIANTS, Variant
from tests.simulation.fieldbus.more_variants import MORE, enriched

SLOW = ("slow-answers", "late-boot")  # they take 40 s and 5 s; `MORE` has quicker ones
ALL: Mapping[str, Variant] = {name: v for name, v in VARIANTS.items() if name not in SLOW} | MORE


def _names(text: str) -> list[str]:
    names = text.split(", ")
    assert ALL.keys() >= {*names}
    return names


REFUSED = _names("unsupervised, inverted-outputs, deaf-error-mode, standing-error, generic-error, blocking-error")
HOLDING = _names(  # boards whose outputs nobody can tell to go off
    "guarding-only, rounded-guarding, no-error-behaviour, canopennode, no-error-mode, no-error-mode-off, maker-object, "
    "off-in-preoperational"
)
TRUTHS = {
    "hold": ("hold", "hold", "device", "device", None),
    "off": ("off", "off", "off", "device", None),
    "modes": (None, None, "device", "off"),
}
BYTES = {  # used bytes of outputs, of variants that carry fewer or more than 8
    **dict.fromkeys(_names("many-outputs, WAGO, many without SYNC"), 16),
    **dict.fromkeys(_names("short-mapping, foreign objects in RPDO1"), 4),
}
SHARED = _names(  # variants for shared RPDOs; those with fixed mappings cannot map dummies, and are refused
    "standard, guarding-only, guarding-with-1029h, rounded-heartbeats, one-supervision, all-bits, logged-ends, "
    "foreign-sync, no-emergencies, both supervisions, mapped otherwise, unmapped, "
    "fixed-mapping, fixed entries"
)
RICH = _names(  # variants with much to judge, drawn more often
    "many-outputs, many-outputs, many-outputs, WAGO, many without SYNC, no-sync, foreign objects in RPDO1, "
    "outputs in two RPDOs, COB-ID is taken, fixed entries, guarding-with-1029h, kept-loss, no-error-mode, "
    "maker-object, no-device-type, many-profiles, only outputs, only inputs, no SYNC, no-error-behaviour, "
    "inputs in two TPDOs, inputs in two TPDOs, inputs in TPDO3, outputs-in-rpdo5, mapped otherwise"
)


class Drawn(NamedTuple):
    wiring: Wiring
    timing: Timing
    variants: dict[str, Variant]
    names: dict[str, str]  # of the variants


def draw(random: Random) -> Drawn:
    """Returns one to three boards on one or two buses."""
    buses = [BusWiring(name, "simulated", name, random.choice([500_000, 1_000_000])) for name in ("can0", "can1")]
    del buses[random.choice([1, 2]) :]
    shared = random.random() < 0.15
    places = [
        BoardId(buses[k % len(buses)].name, node)
        for k, node in enumerate(random.sample([1, 2, 5, 9, 64, 126], random.choice([1, 1, 2, 2, 2, 3])))
    ]
    heartbeat = random.choice([0.02, 0.05, 0.1, 0.1, 0.1])
    falls, unfit = random.random() < 0.5, random.random() < 0.1  # whether outputs go off without the master
    pool = [
        name
        for name in (sorted(SHARED) if shared else (*ALL, *RICH))
        if (name != "rounded-guarding" or heartbeat == 0.1) and (not falls or unfit or name not in HOLDING)
    ]
    names = {place: _variant(random, pool) for place in places}
    channels: list[Channel] = []
    taken: set[tuple[object, ...]] = set()
    for place in places:
        for _ in range(random.choice([1, 2, 2, 3])):
            channels.append(_channel(random, place, places, names, taken, len(channels), falls))
    nodes = tuple(node for place in places if (node := _node(random, place, names[place])) is not None)
    sensors = random.random() < 0.2
    locks = ()
    if random.random() < 0.35:
        place = BoardId(buses[0].name, 77) if sensors else random.choice(places)
        locks = (Interlock("door", place.bus, place.node, _free(random, taken, place, "in", 4), random.random() < 0.5),)
    used = {line.bus for c in channels for line in c.lines.values()} | {lock.bus for lock in locks}
    wiring = Wiring(
        buses=tuple(bus for bus in buses if bus.name in used),
        channels=tuple(channels),
        on_loss="hold"
        if any(c.pulse is not None for c in channels) or not falls
        else random.choice(["hold", "contract"]),
        shared_rpdo=shared,
        error_state=random.choice([None, None, "device"]),
        nodes=nodes,
        interlocks=locks,
    )
    timing = Timing(
        heartbeat=heartbeat,
        heartbeat_timeout=round(random.choice([3.5, 5.0] if heartbeat < 0.05 else [2.5, 3.5, 5.0]) * heartbeat, 3),
        boot_timeout=random.choice([0.5, 1.0]),
        travel_time=random.choice([0.02, 0.05]),
        settle_margin=0.03,
    )
    named = {str(place): names.get(place, "standard") for place in wiring.boards}
    variants = {name: enriched(random, ALL[variant]) for name, variant in named.items()}
    return Drawn(wiring, timing, variants, named)


def _variant(random: Random, pool: list[str]) -> str:
    if random.random() < 0.1:
        return "standard"
    refused = random.random() < 0.1
    some = [name for name in pool if (name in REFUSED) == refused]
    return random.choice(some or pool)


def _channel(
    random: Random,
    place: BoardId,
    places: list[BoardId],
    names: Mapping[BoardId, str],
    taken: set[tuple[object, ...]],
    count: int,
    falls: bool,
) -> Channel:
    size = BYTES.get(names[place], 8)
    fields: dict[str, Any] = {}
    inverted: set[str] = set()
    if random.random() < 0.4:
        fields["output_off"] = _free(random, taken, place, "out", size)
        if falls and random.random() < 0.6:
            fields["pulse"] = random.choice([0.05, 0.1, 0.2])
    elif random.random() < 0.3 and names[place] != "off-in-preoperational":  # whose START would switch it to off
        inverted.add("output")
    for name, share in (("input", 0.6), ("input_contracted", 0.3)):
        if random.random() < share:
            where = random.choice(places) if random.random() < 0.2 else place
            fields[name] = _free(random, taken, where, "in", 4 if BYTES.get(names[where]) == 4 else size)
            if where != place:
                fields[f"{name}_board"] = where
            if random.random() < 0.3:
                inverted.add(name)
    fields.setdefault("input", None)
    if falls and "pulse" not in fields and random.random() < 0.2:
        fields["on_loss"] = random.choice(["hold", "contract"])
    return Channel(
        f"{count}.x",
        place.bus,
        place.node,
        _free(random, taken, place, "out", size),
        inverted=frozenset(inverted),
        **fields,
    )


def _free(random: Random, taken: set[tuple[object, ...]], place: BoardId, what: str, size: int) -> int:
    while True:
        byte = random.choice([0, 0, 0, 1, 1, size - 1, random.randrange(size)])
        bit = 8 * byte + random.randrange(8)
        if (place, what, bit) not in taken:
            taken.add((place, what, bit))
            return bit


def _node(random: Random, place: BoardId, variant: str) -> NodeWiring | None:
    """Returns the entry in `boards.nodes`: the truth about the board, or nothing."""
    fields: dict[str, Any] = {}
    found = ALL[variant]
    if found.output_object != 0x6200 and random.random() < 0.9:
        fields["object"] = found.output_object
    if found.error_state != "modes" or found.output_object != 0x6200:
        fields["error_state"] = random.choice(TRUTHS[found.error_state])
    if random.random() < 0.25:
        right = {1: "vendor", 2: "product", 3: "revision", 4: "serial"}
        for sub, name in right.items():
            if random.random() < 0.4:
                value = int.from_bytes(found.objects[0x1018][sub].default, "little")
                fields[name] = value ^ (random.random() < 0.03)
    fields = {name: value for name, value in fields.items() if value is not None}
    return NodeWiring(place.bus, place.node, **fields) if fields else None
