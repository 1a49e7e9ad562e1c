"""PDOs of different boards: found, changed in order, used unchanged, or refused with a sentence; and quirks."""

from __future__ import annotations

import dataclasses

import pytest

from hyperbit.drivers.canopen.boot import quirks
from hyperbit.drivers.canopen.boot.quirks import Quirk, quirk_of
from hyperbit.drivers.canopen.wiring import Channel, NodeWiring
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World

FIVE = [Channel("5.left", "can0", 5, 0, 0), Channel("5.right", "can0", 5, 1, 1)]


def writes(world: World) -> list[str]:
    """Returns the SDO writes to board 5: index, sub-index and data."""
    requests = [data.split() for cob_id, data in world.frames(sdo=True) if cob_id == 0x605]
    return [
        f"{d[2]}{d[1]}:{int(d[3], 16)}={''.join(reversed(d[4:8]))}"
        for d in requests
        if d[0] in ("23", "2b", "27", "2f")
    ]


def test_a_fixed_mapping_is_used_as_it_is_and_other_outputs_keep_their_values():
    world = World(FIVE, variants={"can0/5": VARIANTS["fixed-mapping"]})
    world.boards.board("can0/5").objects.set_number(0x6206, 3, 0x00)  # its outputs hold in the error state
    world.boards.board("can0/5").objects.set_number(0x6200, 3, 0x40)
    world.up()
    world.commit(1, 0)
    assert world.frames()[:2] == [(0x205, "01 00 40 00 00 00 00 00"), (0x080, "")]
    world.run(0.2)
    assert world.measured() == [1, 0]


def many(count: int) -> list[Channel]:
    """One actuator on each byte of outputs, the first two with end-stops."""
    return [Channel(f"{k}", "can0", 5, 8 * k, 64 * k if k < 2 else None) for k in range(count)]


@pytest.mark.parametrize("read_only", [(), (0x1600, 0x1604, 0x1A00, 0x1A04)])
@pytest.mark.parametrize("count", [2, 10])
def test_outputs_beyond_the_first_64_switch_with_the_same_sync(count, read_only):
    """With fixed mappings both RPDO1 and RPDO5 are needed unchanged."""
    channels = many(10) if count == 10 else [many(10)[k] for k in (0, 9)]
    variant = dataclasses.replace(VARIANTS["many-outputs"], read_only=frozenset(read_only))
    world = World(channels, variants={"can0/5": variant}).up()
    world.commit(*[1] * count)
    frames = world.frames()
    sync = frames.index((0x080, ""))
    assert sync == (2 if read_only or count == 10 else 1)
    assert all(cob_id in (0x205, 0x305) for cob_id, _ in frames[:sync])
    world.run(2.5)
    assert world.positions() == [1.0] * count
    assert world.faults == []
    if sync == 2:
        objects = world.boards.board("can0/5").objects
        assert objects.number(0x1404, 1) == 0x305
        assert objects.number(0x1401, 1) >> 31  # RPDO2 had 305h for analog outputs
    world.commit(*[1] * (count - 1), 0)
    world.run(0.2)
    assert world.positions() == [1.0] * (count - 1) + [0.0]
    world.new_master()
    world.frames()
    world.boot()
    assert world.master.boot_faults == []
    assert world.positions() == [1.0] * (count - 1) + [0.0]


@pytest.mark.parametrize(
    ("named", "words"),
    [
        ({"vendor": 0x22}, "1018h sub 1 (vendor)"),
        ({"product": 7}, "1018h sub 2 (product)"),
        ({"revision": 7}, "1018h sub 3 (revision)"),
        ({"serial": 7}, "1018h sub 4 (serial number)"),
    ],
)
def test_another_device_than_the_arms_file_names_is_refused(named, words):
    world = World(FIVE, nodes=(NodeWiring("can0", 5, **named),))
    world.boards.board("can0/5").objects.set_number(0x1018, int(words[10]), 1)
    world.boot()
    [fault] = world.master.boot_faults
    assert fault.code == "wrong-device"
    assert words in fault.message
    assert f"{next(iter(named.values())):08X}h is needed" in fault.message


def test_the_named_device_is_taken():
    world = World(FIVE)
    held = [world.boards.board("can0/5").objects.number(0x1018, sub) for sub in (1, 2, 3, 4)]
    names = dict(zip(("vendor", "product", "revision", "serial"), held, strict=True))
    World(FIVE, nodes=(NodeWiring("can0", 5, **names),)).up()


def test_quirks_are_found_by_vendor_and_product(monkeypatch):
    special = Quirk("special", "made up", ignored_errors=0x80)
    monkeypatch.setattr(quirks, "QUIRKS", {(1, 2): special, (1, None): Quirk("other", "made up")})
    assert quirk_of(1, 2) is special
    assert quirk_of(1, 3).device == "other"
    assert quirk_of(2, 2) is quirk_of(None, None) is quirks.NONE


def test_a_quirk_takes_a_bit_of_the_error_register_as_no_fault(monkeypatch):
    world = World(FIVE, variants={"can0/5": VARIANTS["standing-error"]})
    vendor = world.boards.board("can0/5").objects.number(0x1018, 1)
    monkeypatch.setitem(quirks.QUIRKS, (vendor, None), Quirk("special", "made up", ignored_errors=0x80))
    world.up()
    world.run(3.0)
    assert world.faults == []


def test_every_quirk_names_its_device_and_source():
    assert all(quirk.device and quirk.source for quirk in quirks.QUIRKS.values())


def test_a_pair_in_two_rpdos_needs_sync():
    far = [Channel("5.left", "can0", 5, 0, None, output_off=64)]
    assert World(far, variants={"can0/5": VARIANTS["many-outputs"]}).boot() == []
    variant = dataclasses.replace(VARIANTS["many-outputs"], synchronous=False, read_only=frozenset({0x1600, 0x1604}))
    [fault] = World(far, variants={"can0/5": variant}).boot()
    assert "outputs 0 and 64 of one actuator are in RPDO1 and RPDO5, which do not wait for SYNC" in fault.message
