"""Release: outputs go off also while boards are silent, and nothing else switches."""

from __future__ import annotations

import pytest

from drivers.canopen.faults import Busy
from drivers.canopen.wiring import Channel
from tests.drivers.canopen.world import World


def pairs() -> list[Channel]:
    return [Channel(f"{node}", "can0", node, 0, None, 1, pulse=0.05) for node in (1, 2)]


def lost(*nodes: int) -> World:
    """A world in which both actuators have an output on, and the boards are silent."""
    world = World(pairs()).up()
    world.master.commit(0b1001, world.now)  # the first extends, the second contracts
    world.flush()
    world.run(0.05)
    assert [actuator.coils for actuator in world.actuators.values()] == [(1, 0), (0, 1)]
    world.lost = lambda bus, node, frame: node in nodes
    world.run(1.0)
    assert [fault.source for fault in world.faults] == [f"can0/{node}" for node in nodes]
    world.frames()
    return world


@pytest.mark.parametrize("nodes", [(1,), (2,), (1, 2)])
def test_outputs_go_off_on_boards_that_are_not_heard_but_hear(nodes: tuple[int, ...]) -> None:
    world = lost(*nodes)
    with pytest.raises(Busy):
        world.master.commit(0, world.now)
    world.master.commit(0, world.now, release=True)
    world.flush()
    world.run(0.05)
    assert [actuator.coils for actuator in world.actuators.values()] == [(0, 0), (0, 0)]
    assert world.master.outputs == 0


def test_a_release_of_one_board_leaves_the_other_alone() -> None:
    world = lost(2)
    world.master.commit(0b1000, world.now, release=True)
    world.flush()
    world.run(0.05)
    assert [actuator.coils[0] for actuator in world.actuators.values()] == [0, 0]
    assert world.master.outputs == 0b1000


def test_nothing_is_released_while_boards_are_booted() -> None:
    world = lost(2)
    world.lost = lambda bus, node, frame: False
    world.master.boot(world.now)
    with pytest.raises(Busy, match="being booted"):
        world.master.commit(0, world.now, release=True)
