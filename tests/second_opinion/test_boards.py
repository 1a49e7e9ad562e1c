"""The executor and the CANopen master on boards of another stack: losses, ends and restarts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from hyperbit.controller.program import Snapshot, unpack
from tests.second_opinion.board import OPERATIONAL, PRE_OPERATIONAL, READY, RESET_COMMUNICATION, STOPPED
from tests.second_opinion.dictionary import MODULE, PLAIN, Kind
from tests.second_opinion.world import A, B, World

CASES: dict[str, tuple[Kind, dict[str, Any]]] = {
    "hold": (MODULE, {"on_loss": "hold"}),
    "contract": (MODULE, {"on_loss": "contract"}),
    "device": (PLAIN, {"on_loss": "hold", "error_state": "device"}),
}


@pytest.fixture(params=CASES)
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    """An arm that is ready; all changes of its pins are judged in the end."""
    kind, wiring = CASES[request.param]
    world = World(kind, **wiring).up()
    yield world
    world.causes()


def after_loss(world: World) -> int:
    """The actuators that stay driven when A was, and the boards have lost the master."""
    return A if world.arm.wiring.on_loss == "hold" and world.boards[1].kind is MODULE else 0


def kill_at_a(world: World) -> None:
    """Kills the executor while A is driven; the boards lose their master."""
    world.done(A)
    world.kill()
    world.go(1.0)
    assert world.pins == after_loss(world)
    world.causes()


def unmoved(world: World, pins: int) -> None:
    """Nothing has switched since the boards were last asked, and the arm works."""
    assert (world.causes(), world.pins, unpack(world.last(Snapshot).outputs)) == ([], pins, pins)
    world.done(B)


def test_a_boot_from_power_on_moves_nothing_and_programs_reach_their_ends(world: World) -> None:
    assert world.causes() == []
    assert {board.state for board in world.boards.values()} == {OPERATIONAL}
    for states in ((A,), (B, A, 0b111111), (0,)):
        world.done(*states)
    assert set(world.causes()) == {"SYNC"}


def test_a_killed_executor_leaves_the_error_state_and_the_next_start_changes_no_pin(world: World) -> None:
    kill_at_a(world)
    assert {board.entries.history[0] & 0xFFFF for board in world.boards.values()} == {0x8130}
    assert {board.state for board in world.boards.values()} <= {OPERATIONAL, STOPPED, READY}
    world.up()
    unmoved(world, after_loss(world))


def test_an_executor_that_returns_before_the_boards_miss_it_changes_no_pin(world: World) -> None:
    world.done(A)
    world.causes()
    world.kill()
    world.go(0.1)
    world.up()
    unmoved(world, A)


def test_a_board_that_loses_its_supply_comes_back_off_and_the_other_holds(world: World) -> None:
    world.done(0b111111)
    world.boards[2].power_off(world.now)
    world.go(1.0)
    assert (world.mode, world.pins) == ("fault", 0b000111)
    world.boards[2].power_on(world.now)
    world.go(3.0)
    world.reset()
    assert world.pins == 0b000111
    world.done(B)


def test_bus_off_in_mid_boot_and_again_changes_no_pin(world: World) -> None:
    kill_at_a(world)
    world.in_mid_boot = lambda: world.cable.go(off=True)
    world.start()
    world.go(1.0)
    assert world.in_mid_boot is None
    world.cable.go(off=False)
    world.go(0.02)
    world.cable.go(off=True)
    world.go(1.0)
    world.cable.go(off=False)
    world.until("ready")
    unmoved(world, after_loss(world))


def test_boards_that_another_tool_makes_pre_operational_before_the_start_change_no_pin(world: World) -> None:
    kill_at_a(world)
    world.foreign(0, bytes([PRE_OPERATIONAL, 0]))
    world.go(0.5)
    held = world.pins
    world.changes.clear()
    world.up()
    unmoved(world, held)


def test_a_stalled_executor_that_lost_its_boards_continues_and_moves_nothing(world: World) -> None:
    world.done(A)
    world.run(B, A, step=2.0)
    world.go(0.2)
    held = B if after_loss(world) else 0
    world.stall(3.0)
    world.go(4.0)
    world.reset()
    assert world.pins == held
    world.done(0b100001)


def test_a_boot_that_lost_the_answers_of_a_board_is_repeated_and_changes_no_pin(world: World) -> None:
    kill_at_a(world)

    def lose_answers() -> None:
        world.answers = False

    world.in_mid_boot = lose_answers
    world.start()
    world.until("fault")
    world.answers = True
    world.until("ready", 30.0)
    unmoved(world, after_loss(world))


def test_another_on_loss_at_the_next_start_changes_no_pin() -> None:
    world = World(MODULE, on_loss="contract").up()
    kill_at_a(world)
    world.arm = replace(world.arm, wiring=replace(world.arm.wiring, on_loss="hold"))
    world.up()
    unmoved(world, 0)


@pytest.mark.parametrize("case", ["hold", "device"])
def test_a_reset_of_communication_by_another_tool_is_a_fault_and_energises_nothing(case: str) -> None:
    kind, wiring = CASES[case]
    world = World(kind, **wiring).up()
    world.done(A)
    world.foreign(0, bytes([RESET_COMMUNICATION, 1]))
    world.go(0.5)
    held = world.pins
    assert world.mode == "fault"
    world.reset()
    world.causes()
    assert world.pins == held
    world.done(B)
