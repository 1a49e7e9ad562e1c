"""Two boards with one node id are noticed; a bus that doubles frames now and then is not taken for them."""

from __future__ import annotations

from drivers.canopen.wire import cia301
from tests.drivers.canopen.world import World


def doubling(world: World, every: int) -> World:
    """Has each `every`-th SDO answer sent twice."""
    count = 0

    def twice(bus: str, node: int, frame: cia301.Frame) -> bool:
        nonlocal count
        if frame.id == cia301.SDO_ANSWER + 5:
            count += 1
            if count % every == 0:
                world.buses[bus].put(world.boards[bus, node], frame)
        return False

    world.lost = twice
    return world


def test_two_boards_that_answer_as_one_are_noticed_and_the_board_stays_not_ready() -> None:
    world = doubling(World(), 1)
    for _ in range(2):
        world.faults.clear()
        world.boot()
        world.run(1.0)
        assert world.codes() == ["duplicate-node"]
        assert world.faults[0].message == "two boards answer as can0/5: give each its own node id, then reset"
        assert not world.master.ready


def test_a_bus_that_doubles_some_frames_is_no_fault() -> None:
    world = doubling(World(), 3).up()
    world.run(20.0)
    assert world.faults == []
