"""Interlocks on bits of a board's objects: brought by a TPDO or polled, and open when no answer comes."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wiring import Channel, Interlock, WatchedObject
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World

SUPPLY = WatchedObject(0x2102, 0)
GATE = 1 << 2  # line of the interlock, after those of two end-stops


def island(variant: str = "valve-supply", *, inverted: bool = False, it: WatchedObject = SUPPLY, bit: int = 0) -> World:
    channels = [Channel("5.left", "can0", 5, 0, 0), Channel("5.right", "can0", 5, 1, 1)]
    lock = Interlock("supply", "can0", 5, bit, inverted, it)
    return World(channels, variants={"can0/5": VARIANTS[variant]}, interlocks=(lock,))


def polls(world: World, seconds: float) -> int:
    world.frames(sdo=True)
    world.run(seconds)
    return sum(cob_id == 0x605 and data.startswith("40 02 21") for cob_id, data in world.frames(sdo=True))


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("variant", ["standard", "valve-supply", "mapped-supply"])
def test_a_supply_that_is_lost_is_seen_within_half_a_second_and_its_return_as_well(variant: str, inverted) -> None:
    world = island(variant, inverted=inverted).up()
    assert world.master.ends & GATE
    world.fault("open", "supply")
    assert world.until(lambda: not world.master.ends & GATE) < 0.5
    world.fault("close", "supply")
    assert world.until(lambda: world.master.ends & GATE) < 0.5
    assert (world.faults, world.master.unanswered(world.wiring.interlocks[0])) == ([], None)


def test_a_mapped_object_is_asked_as_seldom_as_inputs() -> None:
    assert 14 <= polls(island("valve-supply").up(), 4.0) <= 17
    assert 2 <= polls(island("mapped-supply").up(), 4.0) <= 3


def test_an_object_in_the_tpdo_of_the_inputs_keeps_its_place() -> None:
    world = island("mapped-supply")
    objects = world.boards.board("can0/5").objects
    objects.set_number(0x1801, 1, 1 << 31)
    objects.set_number(0x1A00, 0, 2)
    objects.set_number(0x1A00, 2, 0x2102_0008)
    world.boards.board("can0/5").pdos.configure()
    world.up()
    assert objects.number(0x1A00, 0) == 2
    assert not world.master._boards[0].polled


@pytest.mark.parametrize("it", [WatchedObject(0x2103, 0), WatchedObject(0x2102, 1)], ids=str)
def test_a_board_without_the_object_is_refused(it: WatchedObject) -> None:
    world = island(it=it)
    world.boards.board("can0/5").objects.described = VARIANTS["valve-supply"].objects  # not what the wiring asks for
    world.boot()
    text = f"board can0/5 has no {it}; an interlock of the arm's file needs its bit 0"
    assert [(fault.code, fault.message) for fault in world.master.boot_faults] == [("wrong-device", text)]


def test_an_object_that_is_gone_or_does_not_answer_counts_as_open() -> None:
    world = island(inverted=True).up()
    (lock,), objects = world.wiring.interlocks, world.boards.board("can0/5").objects
    objects.refused[SUPPLY] = 0x0602_0000
    world.until(lambda: not world.master.ends & GATE)
    text = "board can0/5 has no 2102h sub 0; an interlock of the arm's file needs its bit 0"
    assert world.master.unanswered(lock) == text
    objects.refused.clear()
    world.until(lambda: world.master.ends & GATE)
    world.lost = lambda bus, frame: frame.id == cia301.SDO_ANSWER + 5
    world.until(lambda: not world.master.ends & GATE)
    assert "does not answer to 2102h sub 0: no SDO answer within 0.3 s" in world.master.unanswered(lock)
    world.lost = lambda bus, frame: False
    world.until(lambda: world.master.ends & GATE)
    assert (world.faults, world.master.unanswered(lock)) == ([], None)


def test_late_answers_do_not_open_it_and_an_old_one_does_not_close_it() -> None:
    world = island("valve-supply")
    board = world.boards.board("can0/5")
    world.up()
    object.__setattr__(board, "variant", VARIANTS["slow-answers"])
    world.run(5.0)
    assert world.master.ends & GATE
    world.fault("open", "supply")
    world.until(lambda: not world.master.ends & GATE)
    world.run(5.0)
    assert not world.master.ends & GATE


def test_an_emergency_brings_the_error_register_before_its_poll() -> None:
    world = island("standard", it=WatchedObject(0x1001, 0), bit=2, inverted=True).up()
    world.fault("open", "supply")
    assert world.until(lambda: not world.master.ends & GATE) < 0.01
    world.fault("close", "supply")
    assert world.until(lambda: world.master.ends & GATE) < 0.01
