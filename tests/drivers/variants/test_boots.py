"""Each variant boots, gets the objects it needs, and switches, or is refused with a sentence and stays as it was.

No START changes a pin, also after the boards have lost their master. The frames of the standard board are in
standard.txt.
"""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from hyperbit.drivers.canopen.wire.cia301 import INVALID, Command, State
from hyperbit.drivers.canopen.wiring import Channel, NodeWiring, Timing
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World, bits, spoken
from tests.drivers.variants.cases import CASES, Case, case_of

# What the boot may write twice, or without need: disabled and mapped PDOs, and outputs, which are written to be known.
IN_STEPS = (*range(0x1400, 0x1C00), 0x6200, 0x2201)
OF_THE_BOARD = (0x1001, 0x1003, 0x6000)  # values that a board sets itself
STANDARD = Path(__file__).with_name("standard.txt")
READY = [case for case in CASES if not case.refused]

all_cases = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)


def booted(name: str) -> World:
    return case_of(name).world().up()


def values(world: World) -> dict[tuple[int, int], bytes]:
    board = world.board()
    places = [(index, sub) for index, subs in board.objects.described.items() for sub in subs]
    return {place: board.objects.value(*place) for place in places if place[0] not in OF_THE_BOARD}


def writes(requests: list[str]) -> list[tuple[int, int, int]]:
    """Returns index, sub-index and value of each SDO download in one step."""
    raw = [bytes.fromhex(request) for request in requests if request[0] == "2" and request[1] != "1"]
    return [(data[1] | data[2] << 8, data[3], int.from_bytes(data[4:], "little")) for data in raw]


def test_each_variant_has_a_case() -> None:
    assert {case.variant for case in CASES} == set(VARIANTS)


@all_cases
def test_a_variant_boots_and_switches_or_is_refused_with_a_sentence(case: Case) -> None:
    world = case.world()
    world.run(0.05)
    before, at_rest = values(world), world.switches()
    faults = [fault.message for fault in world.boot()]
    requests = world.requests()
    assert world.master.outputs_known == (not case.refused), faults
    assert world.switches() == at_rest, "a boot switches nothing"
    assert all(pins == after for pins, after in world.board().started)
    if case.refused:
        [sentence] = faults
        assert sentence.startswith("board can0/5 ")
        assert all(words in sentence for words in case.refused), sentence
        assert (values(world), world.board().state) == (before, State.PRE_OPERATIONAL)
        return
    warnings = [warning.message for warning in world.master.warnings()]
    assert len(warnings) == bool(case.warned), warnings  # one for a board
    assert all(words in warnings[0] for words in case.warned), warnings
    check_writes(requests, before)
    check_needs(world, case)
    for states in ((1, 1), (0, 1), (1, 0), (0, 0)):
        world.commit(*states)
        assert world.master.switching.failed is None
        world.run(1.0)
        assert (world.positions(), world.measured()) == (list(states), list(states))
    assert world.switches() == [4, 2]
    assert world.faults == []


def check_writes(requests: list[str], before: dict[tuple[int, int], bytes]) -> None:
    """Only values that differ are written, and each one is read afterwards."""
    for index, sub, value in writes(requests):
        name = f"{index:04X}h sub {sub}"
        last = max(
            k
            for k, request in enumerate(requests)
            if writes([request])[:1] and writes([request])[0][:2] == (index, sub)
        )
        place = bytes([0x40, index & 0xFF, index >> 8, sub]).hex(" ")
        assert any(request.startswith(place) for request in requests[last:]), f"{name} is not read back"
        if index not in IN_STEPS:
            assert value != int.from_bytes(before[index, sub], "little"), f"{name} had its value"


def check_needs(world: World, case: Case) -> None:
    """The board has what the arm needs of it."""
    objects, timing = world.objects, world.timing
    heartbeat, timeout = round(1000 * timing.heartbeat), round(1000 * timing.heartbeat_timeout)
    guarding = objects.number(0x100C) * objects.number(0x100D)
    if objects.has(0x1017):
        assert heartbeat - 10 < objects.number(0x1017) <= heartbeat
        entries = [objects.number(0x1016, sub) for sub in objects.subs(0x1016)]
        [own] = [entry & 0xFFFF for entry in entries if entry >> 16 == 127 and entry & 0xFFFF]
        assert timeout - 10 < own <= timeout
        assert guarding == 0
    else:
        assert timeout - 10 * objects.number(0x100D) < guarding < timeout + 100, "it may be rounded down"
    contract = world.wiring.on_loss == "contract"
    wanted = {(0x1005, 0): 0x80, (0x1006, 0): 0, (0x1007, 0): 0, (0x1014, 0): 0x85, (0x1019, 0): 0}
    wanted |= {(0x1029, 1): 2 * contract, (0x6005, 0): 1, (0x6006, 1): 0b11}
    assert {it: objects.number(*it) for it in wanted if objects.has(it[0])} == {
        it: value for it, value in wanted.items() if objects.has(it[0])
    }
    for output in (channel.output for channel in world.wiring.channels):
        byte, mask = 1 + output // 8, 1 << output % 8
        if objects.has(0x6206):
            assert bool(objects.number(0x6206, byte) & mask) == contract
            assert not objects.number(0x6207, byte) & mask
        [rpdo] = carriers(world, range(0x1400, 0x1600), 0x2201 if objects.has(0x2201) else 0x6200, byte)
        assert objects.number(rpdo, 2) == (255 if case.variant == "no-sync" else 1), "it waits for SYNC"
    [tpdo] = carriers(world, range(0x1800, 0x1A00), 0x6000, 1)
    assert (objects.number(tpdo, 2), objects.number(tpdo, 5)) == (255, 1000), "sent on changes, and each second"


def carriers(world: World, pdos: range, index: int, sub: int) -> list[int]:
    """Returns the enabled PDOs that carry a byte."""
    enabled = [pdo for pdo in pdos if world.objects.has(pdo) and not world.objects.number(pdo, 1) & INVALID]
    return [pdo for pdo in enabled if (index, sub, 8) in world.objects.mapping(pdo)]


def test_the_frames_of_the_standard_board() -> None:
    """Each line was compared with CiA 301 and 401: reads, what differs is written and read back, start, reads."""
    world = case_of("standard").world()
    assert world.boot() == []
    world.commit(1, 1)
    world.until(lambda: not world.master.outputs.unproven)
    assert spoken(world) == STANDARD.read_text()


def test_a_board_that_saves_writes_is_written_only_once() -> None:
    world = booted("saves-writes")
    first = world.objects.flash_writes
    assert first > 0
    world.new_master()
    world.up()
    world.commit(1, 1)
    world.cycle_power()
    world.new_master()
    world.up()
    assert world.objects.flash_writes == first


@pytest.mark.parametrize("case", READY, ids=lambda case: case.name)
def test_after_the_loss_of_the_master_outputs_are_known_and_a_start_moves_nothing(case: Case) -> None:
    world = case.world().up()
    options = case.options
    off = "contract" in options.values() or options.get("error_state", "hold") != "hold" or "nodes" in options
    left = [0, 0] if off else [1, 1]
    world.commit(1, 1, then=1.0)
    world.lose_master()
    assert (world.positions(), world.board().state is State.OPERATIONAL) == (left, False)
    before = world.switches()
    world.up()
    world.run(1.0)
    assert (world.positions(), world.switches(), world.master.outputs.commanded) == (left, before, bits(*left))
    assert all(pins == after for pins, after in world.board().started)
    world.commit(0, 1, then=1.0)
    assert world.positions() == [0, 1]


@pytest.mark.parametrize(("name", "left"), [("standard", [1, 1]), ("resets-outputs", [0, 0])])
def test_outputs_after_a_reset_of_communication_are_read(name: str, left: list[int]) -> None:
    world = booted(name)
    world.commit(1, 1, then=1.0)
    world.nmt(Command.RESET_COMMUNICATION)
    world.run(1.0)
    assert (world.positions(), world.master.outputs_known) == (left, False)
    before = world.switches()
    world.up()
    world.run(1.0)
    assert (world.positions(), world.switches(), world.master.outputs.commanded) == (left, before, bits(*left))


BOOTING = sorted({case.variant for case in READY if not case.options})
SLOW = ["slow-answers", "late-boot"]


def mixed(variants: list[str], each: int) -> World:
    """Boards of all these variants on two buses, of which each has `each` boards."""
    random, names = Random(1), [*variants, "no-error-mode", "canopennode", "maker-object"]
    places = [(bus, node) for bus in ("can0", "can1") for node in range(1, each + 1)]
    chosen = {place: names[i] if i < len(names) else random.choice(names) for i, place in enumerate(places)}
    channels = [
        Channel(f"{bus}/{node}.{bit}", bus, node, bit, bit)
        for (bus, node), name in chosen.items()
        for bit in (0, 64 if name == "many-outputs" else 1)
    ]
    makers = tuple(NodeWiring(*place, object=0x2201) for place, name in chosen.items() if name == "maker-object")
    variants_of = {f"{bus}/{node}": VARIANTS[name] for (bus, node), name in chosen.items()}
    return World(channels, Timing(boot_timeout=8.0), variants=variants_of, error_state="device", nodes=makers)


def test_a_hundred_boards_boot_in_parallel_and_switch_together() -> None:
    world = mixed([name for name in BOOTING if name not in SLOW], each=50)
    for bus in world.buses.values():
        bus.capacity = 128  # frames, as README asks of interfaces
    begun = world.now
    world.up()
    assert world.now - begun < 3.0
    assert not any(world.switches())
    ones = [1] * len(world.wiring.channels)
    world.commit(*ones, then=1.0)
    assert (world.positions(), world.measured(), world.faults) == (ones, ones, [])


def test_slow_and_late_boards_do_not_hold_up_each_other() -> None:
    world = mixed([*SLOW, *(name for name in BOOTING if name not in SLOW)], each=8)
    begun = world.now
    world.up()
    assert world.now - begun < 45.0
