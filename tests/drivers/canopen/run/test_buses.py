"""Node guarding, and faults of buses: how they are found, what is told, and how the arm comes back."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire.cia301 import REMOTE, Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, FrameIgnored
from hyperbit.drivers.canopen.wiring import Timing
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World, each_node, two_boards

POLL = Frame(REMOTE | 0x705)
GUARDED = {"variant": "guarding-with-1029h", "on_loss": "contract"}


def test_a_guarded_board_is_polled_and_its_answers_alternate() -> None:
    world = World(variant="guarding-only").up()
    world.buses["can0"].log.clear()
    world.run(1.0)
    log = [frame for frame in world.buses["can0"].log if frame.id & 0x7FF == 0x705]
    assert log[0::2] == [POLL] * 10
    assert [frame.data for frame in log[1::2]] in ([b"\x05", b"\x85"] * 5, [b"\x85", b"\x05"] * 5)
    assert world.faults == []
    world.fault("silence", "can0/5")
    for _ in range(5):
        world.say(0x705, b"\x05")
        world.run(0.1)
    assert world.told() == ["board-lost"], "answers whose bit does not alternate do not count"


def test_forty_guarded_boards_are_polled_in_time() -> None:
    variants = {f"can0/{n}": VARIANTS["guarding-only"] for n in range(1, 41)}
    world = World(each_node(40), variants=variants, bitrate=125_000).up()
    world.run(1.0)
    assert (world.faults, world.master.status().buses[0].dropped) == ([], 0)


def test_a_guarded_board_keeps_its_outputs_while_it_is_booted_again_on_a_slow_bus() -> None:
    timing = Timing(heartbeat=0.02, heartbeat_timeout=0.07)
    world = World(timing=timing, bitrate=125_000, latency=0.02, **GUARDED).up()
    world.commit(1, 1)
    world.up()
    assert (world.master.outputs.commanded, world.told()) == (0b11, [])


@pytest.mark.parametrize("refused", [True, False], ids=["refused", "without echoes"])
def test_a_board_is_polled_on_so_that_its_outputs_stay(refused: bool) -> None:
    """Of a board whose answers show its polls, no echo is needed."""
    world = World(**GUARDED).up()
    world.commit(1, 1, then=0.1)
    if refused:
        world.objects.refused[0x6000, 1] = 0x08000022
        assert world.boot() != []
    else:
        world.buses["can0"].echoes = False
    world.buses["can0"].log.clear()
    world.run(0.8)
    assert world.buses["can0"].log.count(POLL) >= 7
    assert world.positions() == [1.0, 1.0]


# Buses.


def test_error_frames_change_the_state_of_the_bus_and_frames_its_counts() -> None:
    world = World().up()
    for state in ("warning", "passive", "active"):
        world.master.receive_event(BusChanged("can0", state, "", (130, 7)), world.now)
        assert world.master.status().buses[0].state == state
        assert world.warned() == (["bus-passive"] if state == "passive" else [])
    world.master.receive_event(BusChanged("can0", None, "", (1, 2)), world.now)
    before = world.master.status().buses[0]
    assert (before.state, before.tx_errors, before.rx_errors) == ("active", 1, 2)
    for _ in range(1000):
        world.say(0x300, bytes(8))
    world.run(1.1)
    world.master.receive_event(FrameIgnored("can0", 100), world.now)
    after = world.master.status().buses[0]
    assert (after.ignored, after.rx_frames >= before.rx_frames + 1001) == (before.ignored + 1001, True)
    assert 0.1 <= after.load < 0.2  # 1,000 frames of 135 bits in a second of 1 Mbit/s
    assert after.worst_case.load > 0
    assert world.master.status().boards[0].heartbeat_age < 0.2
    assert world.faults == []


def test_heartbeats_of_a_board_show_that_a_bus_is_back() -> None:
    world = World().up()
    world.buses["can0"].go_off()
    assert [fault.code for fault in world.boot()] == ["bus-off"]
    world.buses["can0"].state = "active"  # nobody tells so
    world.run(0.4)
    assert world.master.status().buses[0].state == "active"
    assert world.master.back
    world.up()


def test_questions_read_inputs_whose_tpdo_was_lost_one_after_the_other_and_time_out() -> None:
    world = World(two_boards(), timing=Timing(heartbeat_timeout=60.0)).up()
    world.lose(0x185)
    world.commit(1, 0, then=0.1)
    assert world.measured() == [0, 0]
    world.frames()
    world.master.question(0, world.now)
    world.master.question(0, world.now)
    assert (world.master.boards[0].questioning, world.master.boards[1].questioning) == (True, False)
    world.until(lambda: not world.master.boards[0].questioning)
    world.run(0.01)
    assert world.measured() == [1, 0]
    exchange = [(0x605, "40 00 60 01 00 00 00 00"), (0x585, "4f 00 60 01 01 00 00 00")]
    assert [frame for frame in world.frames(sdo=True) if frame in exchange] == exchange * 2
    world.fault("silence", "can0/5")
    world.master.question(0, world.now)
    assert 0.5 < world.until(lambda: not world.master.boards[0].questioning) < 2.0
