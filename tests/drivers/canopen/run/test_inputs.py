"""Inputs and interlocks: brought by TPDOs, read again when one is lost, polled; open when no answer comes."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.boards.board import Board, InputLines
from hyperbit.drivers.canopen.layout import lay_out
from hyperbit.drivers.canopen.pdo import Pdo
from hyperbit.drivers.canopen.wire.cia301 import TPDO1
from hyperbit.drivers.canopen.wire.events import BusOverrun
from hyperbit.drivers.canopen.wire.link import Link
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Interlock, WatchedObject, Wiring
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World, each_node

GATE_BIT = 8


def closed(world: World, *nodes: int) -> World:
    """The contacts at bit 8 of these boards are closed; the master boots."""
    for node in nodes:
        world.board(f"can0/{node}").contacts[GATE_BIT] = 1
    world.up()
    world.run(3.0)
    return world


def open_without_tpdo(world: World, node: int) -> None:
    world.lose(TPDO1 + node)
    world.board(f"can0/{node}").contacts[GATE_BIT] = 0
    world.board(f"can0/{node}").step(world.now)
    world.lose()


@pytest.mark.parametrize(("nodes", "bitrate"), [(1, 125_000), (20, 125_000), (60, 1_000_000)])
def test_an_interlock_whose_one_tpdo_is_lost_is_seen_open_within_two_seconds(nodes: int, bitrate: int) -> None:
    gate = Interlock("gate", "can0", nodes, GATE_BIT)
    world = closed(World(each_node(nodes), bitrate=bitrate, interlocks=(gate,)), nodes)
    assert world.master.inputs.ends & 1 << nodes
    open_without_tpdo(world, nodes)
    assert world.until(lambda: not world.master.inputs.ends & 1 << nodes) < 2.0
    assert world.faults == []


def test_end_stops_of_many_boards_take_one_hundredth_of_a_slow_bus() -> None:
    world = World(each_node(30), bitrate=125_000).up()
    world.run(1.0)
    world.frames()
    world.run(10.0)
    reads = [data for cob_id, data in world.frames(sdo=True) if cob_id & 0x780 == 0x600 and data[:8] == "40 00 60"]
    assert 30 < len(reads) < 50  # two frames of 135 bits each: 1 % is 4.6 reads a second
    assert world.faults == []


def test_the_buses_work_on_when_echoes_are_lost_in_an_overrun() -> None:
    world = World([Channel("5.left", "can0", 5, 0, 0)]).up()
    bus = world.buses["can0"]
    bus.echoes = False
    world.until(lambda: world.master.links["can0"].pending.count > 0)
    world.run(0.02)
    bus.echoes = True
    world.master.receive_event(BusOverrun("can0"), world.now)
    world.run(1.0)
    world.commit(1)
    assert (world.faults, world.master.outputs.commanded) == ([], 1)


def test_an_answer_is_newer_than_what_came_before_and_older_than_a_tpdo_after_its_question() -> None:
    """Another TPDO of the board tells nothing of the byte that is asked for."""
    buses, channels = (
        (BusWiring("can0", "virtual", "x"),),
        (Channel("a", "can0", 5, 0, 0), Channel("b", "can0", 5, 1, 8)),
    )
    inputs, layout = InputLines(), lay_out(Wiring(buses, channels)).boards[0]
    board = Board(0, layout, Link(buses[0], lambda *_: None, 1.0), inputs, lambda _: None)
    board.set_tpdos([Pdo(0x1800, 0x185, (0x6000_0108,)), Pdo(0x1801, 0x285, (0x6000_0208,))])
    board.receive_frame(0x185, b"\x01", 0.0)
    board.begin_input_read()
    board.receive_frame(0x285, b"\x01", 0.0)
    board.set_input(1, 0)
    board.set_input(2, 0)
    assert inputs.levels == 0b10
    board.begin_input_read()
    board.receive_frame(0x185, b"\x00", 0.0)
    board.set_input(2, 0)
    assert inputs.levels == 0


# Interlocks on bits of other objects.

SUPPLY = WatchedObject(0x2102, 0)
GATE = 1 << 2  # line of the interlock, after those of two end-stops


def island(variant: str = "valve-supply", inverted: bool = False, it: WatchedObject = SUPPLY, bit: int = 0) -> World:
    return World(variant=variant, interlocks=(Interlock("supply", "can0", 5, bit, inverted, it),))


def told(world: World, closed: bool) -> float:
    """Waits until the master has the interlock open or closed; returns the time [s]."""
    return world.until(lambda: bool(world.master.inputs.ends & GATE) is closed)


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("variant", ["standard", "valve-supply", "mapped-supply"])
def test_a_supply_that_is_lost_is_seen_within_half_a_second_and_its_return_as_well(
    variant: str, inverted: bool
) -> None:
    world = island(variant, inverted).up()
    assert world.master.inputs.ends & GATE
    world.fault("open", "supply")
    assert told(world, closed=False) < 0.5
    world.fault("close", "supply")
    assert told(world, closed=True) < 0.5
    assert (world.faults, world.master.unanswered(world.wiring.interlocks[0])) == ([], None)


def polls(world: World, seconds: float = 4.0) -> int:
    world.frames()
    world.run(seconds)
    return sum(data.startswith("40 02 21") for data in world.requests())


def test_an_object_in_a_tpdo_is_asked_as_seldom_as_inputs_and_keeps_its_place_there() -> None:
    assert 14 <= polls(island("valve-supply").up()) <= 17
    assert 2 <= polls(island("mapped-supply").up()) <= 3
    world = island("mapped-supply")
    for index, sub, value in ((0x1801, 1, 1 << 31), (0x1A00, 0, 2), (0x1A00, 2, 0x2102_0008)):
        world.objects.set_number(index, sub, value)
    world.board().pdos.configure()
    world.up()
    assert world.objects.number(0x1A00, 0) == 2
    assert polls(world) <= 3


@pytest.mark.parametrize("it", [WatchedObject(0x2103, 0), WatchedObject(0x2102, 1)], ids=str)
def test_a_board_without_the_object_is_refused(it: WatchedObject) -> None:
    world = island(it=it)
    world.objects.described = VARIANTS["valve-supply"].objects  # not what the wiring asks for
    text = f"board can0/5 has no {it}; an interlock of the arm's file needs its bit 0"
    assert [(fault.code, fault.message) for fault in world.boot()] == [("wrong-device", text)]


def test_an_object_that_is_gone_or_does_not_answer_counts_as_open() -> None:
    world = island(inverted=True).up()
    [lock] = world.wiring.interlocks
    world.objects.refused[SUPPLY] = 0x0602_0000
    told(world, closed=False)
    text = "board can0/5 has no 2102h sub 0; an interlock of the arm's file needs its bit 0"
    assert world.master.unanswered(lock) == text
    world.objects.refused.clear()
    told(world, closed=True)
    world.lose(0x585)
    told(world, closed=False)
    assert "does not answer to 2102h sub 0: no SDO answer within 0.3 s" in world.master.unanswered(lock)
    world.lose()
    told(world, closed=True)
    assert (world.faults, world.master.unanswered(lock)) == ([], None)


def test_late_answers_do_not_open_it_and_an_old_one_does_not_close_it() -> None:
    world = island().up()
    world.board().variant = VARIANTS["slow-answers"]
    world.run(5.0)
    assert world.master.inputs.ends & GATE
    world.fault("open", "supply")
    told(world, closed=False)
    world.run(5.0)
    assert not world.master.inputs.ends & GATE


def test_an_emergency_brings_the_error_register_before_its_poll() -> None:
    world = island("standard", True, WatchedObject(0x1001, 0), bit=2).up()
    for verb, closed in (("open", False), ("close", True)):
        world.fault(verb, "supply")
        assert told(world, closed) < 0.01
