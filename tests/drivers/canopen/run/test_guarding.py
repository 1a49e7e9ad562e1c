"""Node guarding: polls, the toggle bit, and timeouts on both sides."""

from __future__ import annotations

from hyperbit.drivers.canopen.wire.cia301 import REMOTE, Command, Frame, State
from hyperbit.drivers.canopen.wiring import Channel, Timing
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World, one_board

POLL = Frame(REMOTE | 0x705)


def guarded(**options: object) -> World:
    return World(one_board(), variants={"can0/5": VARIANTS["guarding-only"]}, **options)


def test_a_guarded_board_is_polled_and_its_answers_alternate():
    world = guarded().up()
    world.buses["can0"].log.clear()
    world.run(1.0)
    log = [frame for frame in world.buses["can0"].log if frame.id & 0x7FF == 0x705]
    assert log[0::2] == [POLL] * 10
    assert [frame.data for frame in log[1::2]] in ([b"\x05", b"\x85"] * 5, [b"\x85", b"\x05"] * 5)
    assert world.master.status().boards[0].state == "operational"
    assert world.faults == []


def test_the_life_time_is_the_heartbeat_time_out_rounded_up():
    world = World(variants={"can0/5": VARIANTS["guarding-only"]}, timing=Timing(heartbeat=0.1, heartbeat_timeout=0.35))
    objects = world.up().boards.board("can0/5").objects
    assert (objects.number(0x100C), objects.number(0x100D)) == (88, 4)


def test_a_guarded_board_that_falls_silent_is_lost():
    world = guarded().up()
    world.boards.board("can0/5").silent = True
    took = world.until(world.told)
    assert world.told() == ["board-lost"]
    assert "no answer to node guarding for 0.35 s" in world.faults[0].message
    assert 0.2 < took < 0.5
    world.boards.board("can0/5").silent = False
    world.run(0.2)
    assert world.master.back
    world.up()


def test_answers_whose_bit_does_not_alternate_do_not_count():
    world = guarded().up()
    board = world.boards.board("can0/5")
    board.silent = True
    for _ in range(5):
        world.say(0x705, b"\x05")
        world.run(0.1)
    assert world.told() == ["board-lost"]


def test_forty_guarded_boards_are_polled_in_time():
    channels = [Channel(f"{n}", "can0", n, 0, 0) for n in range(1, 41)]
    variants = {f"can0/{n}": VARIANTS["guarding-only"] for n in range(1, 41)}
    world = World(channels, variants=variants, bitrate=125_000).up()
    world.run(2.0)
    assert world.faults == []
    assert world.master.status().buses[0].dropped == 0


def test_a_guarded_board_keeps_its_outputs_while_it_is_booted_again_on_a_slow_bus() -> None:
    variants = {"can0/5": VARIANTS["guarding-with-1029h"]}
    timing = Timing(heartbeat=0.02, heartbeat_timeout=0.07)
    world = World(one_board(), timing, variants=variants, bitrate=125_000, latency=0.02, on_loss="contract").up()
    world.commit(1, 1)
    world.boot()
    assert world.master.boot_faults == []
    assert world.master.outputs == 0b11
    assert world.told() == []


def test_a_stopped_board_boots_also_if_the_boot_timeout_is_as_short_as_the_first_question():
    timing = Timing(boot_timeout=0.5)
    world = World(one_board(), variants={"can0/5": VARIANTS["guarding-with-1029h"]}, timing=timing)
    world.boards.board("can0/5").obey(Command.STOP)
    world.up()
    assert world.boards.board("can0/5").state is State.OPERATIONAL


def test_a_refused_board_is_polled_on_so_that_its_outputs_stay():
    world = guarded().up()
    world.commit(1, 1, then=0.1)
    board = world.boards.board("can0/5")
    board.objects.refused[0x6000, 1] = 0x08000022
    world.master.boot(world.now)
    world.until(lambda: not world.master.booting)
    assert world.master.boot_faults != []
    world.buses["can0"].log.clear()
    world.run(1.0)
    assert world.buses["can0"].log.count(POLL) >= 9
    assert world.positions() == [1.0, 1.0]


def test_a_board_whose_answers_show_its_polls_is_polled_on_while_echoes_are_lost():
    world = World(one_board(), variants={"can0/5": VARIANTS["guarding-with-1029h"]}, on_loss="contract").up()
    world.commit(1, 1, then=0.1)
    world.buses["can0"].echoes = False
    world.buses["can0"].log.clear()
    world.run(0.8)
    assert world.buses["can0"].log.count(POLL) >= 7
    assert world.positions() == [1.0, 1.0]
