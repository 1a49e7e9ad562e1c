"""Two boards with one node id are noticed; a bus that doubles frames now and then is not taken for them."""

from __future__ import annotations

from hyperbit.drivers.canopen.wire import cia301
from tests.drivers.rig import World


def doubling(world: World, every: int) -> World:
    count = 0

    def twice(bus: str, frame: cia301.Frame) -> bool:
        nonlocal count
        if frame.id == cia301.SDO_ANSWER + 5:
            count += 1
            if count % every == 0:
                world.buses[bus].from_other(frame)
        return False

    world.lost = twice
    return world


def test_two_boards_that_answer_as_one_are_noticed_and_the_board_stays_not_ready() -> None:
    world = doubling(World(), 1)
    for _ in range(2):
        world.faults.clear()
        world.boot()
        world.run(1.0)
        assert world.told() == ["duplicate-node"]
        assert world.faults[0].message == "two boards answer as can0/5: give each its own node id, then reset"
        assert not world.master.outputs_known


def test_a_bus_that_doubles_some_frames_is_no_fault() -> None:
    world = doubling(World(), 3).up()
    world.run(20.0)
    assert world.faults == []


def test_two_boards_that_send_heartbeats_with_one_node_id_are_noticed() -> None:
    world = World().up()
    period = world.timing.heartbeat

    def beat() -> None:  # of another board with the same node id, half a period later
        world.say(0x705, b"\x05")
        world.after(period, beat)

    world.after(period / 2, beat)
    world.run(21 * period)
    assert world.told() == ["duplicate-node"]
    assert not world.master.outputs_known


def test_heartbeats_that_come_late_and_at_once_are_of_one_board() -> None:
    world = World().up()
    world.run(0.5)
    for _ in range(12):
        world.say(0x705, b"\x05")
    world.run(3.0)
    world.stall(0.2)
    world.run(3.0)
    assert world.told() == []
