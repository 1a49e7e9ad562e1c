"""Errors of boards are read while they run, and disturb nothing."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.sdo.errors import Errors
from hyperbit.drivers.canopen.wire.cia301 import Command
from hyperbit.drivers.canopen.wire.events import BusChanged
from hyperbit.drivers.canopen.wiring import Channel
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World


def read(world: World) -> Errors | ArmFault:
    world.master.read_errors(0)
    told = []
    world.until(lambda: told or told.extend(world.master.drain_errors()), 60)
    [(board, found)] = told
    assert board == 0
    return found


def test_errors_are_read_while_the_arm_is_ready_and_in_fault():
    world = World().up()
    assert read(world) == Errors(0, ())
    world.fault("error", "can0/5", 5000)
    world.run(0.1)
    assert read(world) == Errors(0x01, (0x5000,))
    world.boot()
    assert world.master.boot_faults
    assert read(world) == Errors(0x01, (0x5000,))


def test_errors_of_a_board_that_boots_are_read_after_the_boot():
    world = World()
    world.run(0.05)
    world.frames(sdo=True)
    world.master.boot(world.now)
    booting = []
    world.master.read_errors(0)
    world.until(lambda: booting.append(world.master.booting) or world.master.drain_errors(), 60)
    assert world.master.boot_faults == []
    assert booting[-2:] == [False, False] or not booting[-1]


@pytest.mark.parametrize(
    ("variant", "words"), [("standard", "does not answer to 1001h"), ("guarding-only", "does not")]
)
def test_a_silent_board_is_said_to_be_silent(variant, words):
    world = World(variants={"can0/5": VARIANTS[variant]}).up()
    world.boards.board("can0/5").silent = True
    assert words in read(world).message


def test_a_stopped_board_and_a_lost_bus_are_told_at_once():
    world = World().up()
    world.say(0, bytes([Command.STOP, 5]))
    world.until(lambda: world.master.status().boards[0].state == "stopped")
    assert read(world).code == "board-stopped"
    world.master.receive_event(BusChanged("can0", "down", "it is down", None), world.now)
    assert read(world).code == "bus-down"


def test_a_pulse_is_read_back_while_errors_are_read():
    pulsed = Channel("5.left", "can0", 5, 0, None, output_off=1, pulse=0.05)
    world = World([pulsed]).up()
    objects = world.boards.board("can0/5").objects
    for sub in range(1, 9):
        objects.set_number(0x1003, sub, 0x8130)
    objects.set_number(0x1003, 0, 8)
    for states in (0b01, 0b10) * 5:
        world.master.read_errors(0)
        world.run(0.001)
        world.master.commit(states, world.now)
        world.until(lambda: not world.master.committing)
        world.run(0.05)
        world.master.commit(0, world.now)
        world.until(lambda: not world.master.committing)
        world.run(0.5)
        assert world.master.drain_missed() == 0
        assert [len(found.history) for _, found in world.master.drain_errors()] == [8]
