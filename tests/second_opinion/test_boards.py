"""The executor and the CANopen master on boards of another stack: losses, ends and restarts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from hyperbit.controller.program import Snapshot, unpack
from tests.second_opinion.board import MODULE, OPERATIONAL, PLAIN, PRE_OPERATIONAL, READY, STOPPED, Kind
from tests.second_opinion.world import A, B, World

HOLD: dict[str, Any] = {"on_loss": "hold"}
CONTRACT: dict[str, Any] = {"on_loss": "contract"}
DEVICE: dict[str, Any] = {"on_loss": "hold", "error_state": "device"}
CASES = [(MODULE, HOLD), (MODULE, CONTRACT), (PLAIN, DEVICE)]
NAMES = ["hold", "contract", "device"]


@pytest.fixture(params=CASES, ids=NAMES)
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    kind, wiring = request.param
    world = World(kind, **wiring)
    yield world
    world.check()


def after_loss(world: World) -> int:
    """The actuators that stay driven when A was, and the boards have lost the master."""
    return A if world.arm.wiring.on_loss == "hold" and world.boards[1].kind is MODULE else 0


def test_a_boot_from_power_on_moves_nothing_and_programs_reach_their_ends(world: World) -> None:
    world.up()
    assert world.causes() == []
    assert {board.state for board in world.boards.values()} == {OPERATIONAL}
    for states in ((A,), (B, A, 0b111111), (0,)):
        world.done(*states)
    assert set(world.causes()) == {"SYNC"}


def test_a_killed_executor_leaves_the_error_state_and_the_next_start_changes_no_pin(world: World) -> None:
    world.up().done(A)
    world.kill()
    world.go(1.0)
    assert world.pins == after_loss(world)
    assert {board.entries.history[0] & 0xFFFF for board in world.boards.values()} == {0x8130}
    assert {board.state for board in world.boards.values()} <= {OPERATIONAL, STOPPED, READY}
    world.causes()
    world.up()
    assert world.pins == after_loss(world)
    assert world.causes() == []
    assert unpack(world.last(Snapshot).outputs) == world.pins
    world.done(B)


def test_an_executor_that_returns_before_the_boards_miss_it_changes_no_pin(world: World) -> None:
    world.up().done(A)
    world.causes()
    world.kill()
    world.go(0.1)
    world.up()
    assert world.causes() == []
    assert world.pins == A
    world.done(B)


def test_a_board_that_loses_its_supply_comes_back_off_and_the_other_holds(world: World) -> None:
    world.up().done(0b111111)
    world.boards[2].power_off(world.now)
    world.go(1.0)
    assert (world.mode, world.pins) == ("fault", 0b000111)
    world.boards[2].power_on(world.now)
    world.go(3.0)
    if world.mode != "ready":
        world.reset()
    assert world.pins == 0b000111
    world.done(B)


def test_bus_off_in_mid_boot_and_again_changes_no_pin(world: World) -> None:
    world.up().done(A)
    world.kill()
    world.go(1.0)
    world.causes()
    world.in_mid_boot = world.bus_off
    world.start()
    world.go(1.0)
    assert world.in_mid_boot is None
    world.restart_bus()
    world.go(0.02)
    world.bus_off()
    world.go(1.0)
    world.restart_bus()
    world.until("ready")
    assert world.causes() == []
    assert world.pins == after_loss(world)
    world.done(B)


def test_boards_that_another_tool_makes_pre_operational_before_the_start_change_no_pin(world: World) -> None:
    world.up().done(A)
    world.kill()
    world.go(1.0)
    world.causes()
    world.foreign(0, bytes([PRE_OPERATIONAL, 0]))
    world.go(0.5)
    held = world.pins
    world.changes.clear()
    world.up()
    assert world.causes() == []
    assert world.pins == held


def test_a_stalled_executor_that_lost_its_boards_continues_and_moves_nothing(world: World) -> None:
    world.up().done(A)
    world.run(B, A, step=2.0)
    world.go(0.2)
    world.causes()
    held = B if after_loss(world) else 0
    world.stall(3.0)
    world.go(4.0)
    if world.mode != "ready":
        world.reset()
    assert world.pins == held
    assert "START" not in world.causes()
    world.done(0b100001)


def test_a_boot_that_lost_the_answers_of_a_board_is_repeated_and_changes_no_pin(world: World) -> None:
    world.up().done(A)
    world.kill()
    world.go(1.0)
    world.causes()
    world.in_mid_boot = world.lose_answers
    world.start()
    world.until("fault")
    world.answers = True
    world.until("ready", 30.0)
    assert world.causes() == []
    assert world.pins == after_loss(world)
    world.done(B)


def test_other_settings_on_loss_at_the_next_start_change_no_pin() -> None:
    world = World(MODULE, **CONTRACT).up()
    world.done(A)
    world.kill()
    world.go(1.0)
    world.causes()
    world.start(on_loss="hold")
    world.until("ready")
    assert world.causes() == []
    assert world.pins == 0
    world.done(B)


@pytest.mark.parametrize("kind", [MODULE, PLAIN])
def test_a_reset_of_communication_by_another_tool_is_a_fault_and_energises_nothing(kind: Kind) -> None:
    world = World(kind, **(HOLD if kind is MODULE else DEVICE)).up()
    world.done(A)
    world.foreign(0, bytes([0x82, 1]))
    world.go(0.5)
    held = world.pins
    assert world.mode == "fault"
    world.reset()
    world.check()
    assert world.pins == held
    world.done(B)
