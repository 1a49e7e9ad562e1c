"""The watch of inputs: a lost TPDO is noticed within two seconds, with little of the bus."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.boards.board import Board, StateImage
from hyperbit.drivers.canopen.layout import lay_out
from hyperbit.drivers.canopen.pdo import Pdo
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.events import BusOverrun
from hyperbit.drivers.canopen.wire.link import Link
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Interlock, Wiring
from tests.drivers.rig import World


def lose_one_tpdo(world: World, node: int) -> None:
    lost: list[int] = []

    def loses(bus: str, frame: cia301.Frame) -> bool:
        if frame.id != cia301.TPDO1 + node or lost:
            return False
        lost.append(frame.id)
        return True

    world.lost = loses
    board = world.boards.board(f"can0/{node}")
    board.contacts[8] = 0
    board.step(world.now)
    assert lost


def guarded(nodes: int, bitrate: int) -> World:
    channels = [Channel(f"{node}.a", "can0", node, 0, 0) for node in range(1, nodes + 1)]
    world = World(channels, bitrate=bitrate, interlocks=(Interlock("gate", "can0", nodes, 8),))
    world.boards.board(f"can0/{nodes}").contacts[8] = 1
    return world.up()


@pytest.mark.parametrize(("nodes", "bitrate"), [(1, 125_000), (20, 125_000), (60, 1_000_000)])
def test_an_interlock_whose_one_tpdo_is_lost_is_seen_open_within_two_seconds(nodes: int, bitrate: int) -> None:
    world = guarded(nodes, bitrate)
    world.run(3.0)
    gate = 1 << nodes
    assert world.master.ends & gate
    lose_one_tpdo(world, nodes)
    assert world.until(lambda: not world.master.ends & gate) < 2.0
    assert world.faults == []


def test_interlocks_on_all_boards_of_a_slow_bus_are_read_within_two_seconds() -> None:
    channels = [Channel(f"{node}.a", "can0", node, 0, None) for node in range(1, 31)]
    interlocks = tuple(Interlock(f"{node}", "can0", node, 8) for node in range(1, 31))
    world = World(channels, bitrate=125_000, interlocks=interlocks)
    for node in range(1, 31):
        world.boards.board(f"can0/{node}").contacts[8] = 1
    world.boot()
    world.run(3.0)
    lose_one_tpdo(world, 17)
    assert world.until(lambda: world.master.ends.bit_count() == 29) < 2.0


def test_an_end_stop_whose_one_tpdo_is_lost_is_noticed() -> None:
    world = World([Channel("5.left", "can0", 5, 0, 8)])
    world.boards.board("can0/5").contacts[8] = 1
    world.up()
    lose_one_tpdo(world, 5)
    assert world.until(lambda: not world.master.ends) < 2.0


def test_end_stops_of_many_boards_take_one_hundredth_of_a_slow_bus() -> None:
    world = World([Channel(f"{node}.a", "can0", node, 0, 0) for node in range(1, 31)], bitrate=125_000).up()
    world.run(1.0)
    world.frames(sdo=True)
    world.run(20.0)
    reads = [data for cob_id, data in world.frames(sdo=True) if cob_id & 0x780 == 0x600 and data[:8] == "40 00 60"]
    assert 60 < len(reads) < 100  # two frames of 135 bits each: 1 % is 4.6 reads a second
    assert world.faults == []


def test_inputs_are_read_at_once_after_an_overrun_of_the_controller() -> None:
    world = World([Channel("5.left", "can0", 5, 0, 8)])
    world.boards.board("can0/5").contacts[8] = 1
    world.up()
    lose_one_tpdo(world, 5)
    world.master.receive_event(BusOverrun("can0"), world.now)
    assert world.until(lambda: not world.master.ends) < 0.1
    assert world.master.status().buses[0].overruns == 1


def test_the_buses_work_on_when_echoes_are_lost_in_an_overrun() -> None:
    world = World([Channel("5.left", "can0", 5, 0, 0)]).up()
    bus = world.buses["can0"]
    bus.echoes = False
    world.until(lambda: world.master.links["can0"].pending.count > 0)
    world.run(0.02)
    bus.echoes = True
    world.master.receive_event(BusOverrun("can0"), world.now)
    world.run(1.0)
    assert world.faults == []
    world.commit(1)
    assert world.master.outputs == 1


def test_an_answer_is_newer_than_what_came_before_and_older_than_a_tpdo_after_its_question() -> None:
    """Another TPDO of the board tells nothing of the byte that is asked for."""
    wiring = Wiring(
        (BusWiring("can0", "virtual", "x"),), (Channel("a", "can0", 5, 0, 0), Channel("b", "can0", 5, 1, 8))
    )
    image, layout = StateImage(), lay_out(wiring).boards[0]
    board = Board(0, layout, Link(wiring.buses[0], lambda *_: None, 1.0), image, lambda _: None)
    board.set_tpdos([Pdo(0x1800, 0x185, (0x6000_0108,)), Pdo(0x1801, 0x285, (0x6000_0208,))])
    board.receive_frame(0x185, b"\x01", 0.0)
    board.begin_input_read()
    board.receive_frame(0x285, b"\x01", 0.0)
    board.set_input(1, 0)
    board.set_input(2, 0)
    assert image.ends == 0b10
    board.begin_input_read()
    board.set_input(2, 0)
    assert image.ends == 0
