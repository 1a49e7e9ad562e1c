"""Commits: their frames, the times of these, and the results."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.faults import ArmFault, Busy
from hyperbit.drivers.canopen.wiring import Channel
from tests.drivers.rig import World, bits, two_boards, two_buses


def test_more_than_eight_outputs_on_a_board():
    places = [(0, 1), (3, 0), (8, 13), (17, 9), (63, 63)]
    world = World([Channel(f"{o}", "can0", 3, o, i) for o, i in places]).up()
    world.commit(1, 0, 1, 0, 1, then=0.1)
    assert world.measured() == [1, 0, 1, 0, 1]
    assert world.frames()[:2] == [(0x203, "01 01 00 80"), (0x080, "")]  # subs 1, 2, 3 and 8
    world.commit(0, 1, 0, 1, 0, then=0.1)
    assert world.measured() == [0, 1, 0, 1, 0]
    assert world.positions() == [0, 1, 0, 1, 0]


def test_shared_frames_hold_eight_bytes_and_no_board_is_in_two():
    channels = [Channel(f"{n}.{o}", "can0", n, o, o) for n in (1, 2, 3) for o in (0, 8, 16)]
    world = World(channels, shared_rpdo=True).up()
    world.commit(*[1] * 9)
    assert world.frames()[:3] == [(0x201, "01 01 01 01 01 01"), (0x203, "01 01 01"), (0x080, "")]


@pytest.mark.parametrize("room", [0, 1])
def test_a_full_bus_gets_no_sync_and_later_the_latest_states_only(room):
    world = World(two_boards()).up()
    world.commit(0, 1, then=0.1)
    world.frames()
    world.buses["can0"].room = room
    world.commit(1, 0)
    assert "not sent" in world.master.commit_failed
    assert (0x080, "") not in world.frames()
    world.buses["can0"].room = None
    world.commit_when_possible(1, 1)
    world.run(0.1)
    frames = world.frames()
    assert (0x209, "00") not in frames
    assert frames.count((0x080, "")) == 1
    assert world.switches() == [1, 1]
    assert world.master.status().buses[0].dropped > 0


def test_a_sync_that_fails_on_one_bus_is_sent_with_the_next_commit():
    world = World(two_buses()).up()
    world.buses["can1"].room = 1
    world.commit(1, 1)
    assert "SYNC" in world.master.commit_failed
    assert world.switched == [(0b01, world.switched[0][1])]
    world.buses["can1"].room = None
    world.run(0.1)
    assert world.measured() == [1, 0]
    assert world.faults == []
    for bus in ("can0", "can1"):
        world.frames(bus)
    world.commit(1, 1, then=0.1)
    assert world.frames("can0") == []
    assert world.frames("can1") == [(0x080, ""), (0x185, "01")]
    assert world.master.outputs == 0b11


def test_a_commit_back_to_the_old_states_overwrites_what_is_latched():
    world = World(two_boards()).up()
    world.commit(1, 1, then=0.1)
    world.buses["can0"].room = 1
    world.commit(0, 0)
    assert world.master.commit_failed
    world.buses["can0"].room = None
    world.run(0.01)
    world.frames()
    world.commit(1, 1, then=0.01)
    assert world.frames()[-3:] == [(0x205, "01"), (0x209, "08"), (0x080, "")]
    assert world.switches() == [1, 1]


def test_a_commit_during_another_is_refused():
    world = World().up()
    world.master.commit(1, world.now)
    with pytest.raises(Busy, match="not sent yet"):
        world.master.commit(2, world.now)


def test_an_rpdo_waits_until_no_older_one_with_its_cob_id_is_pending():
    world = World().up()
    world.buses["can0"].stuck = True  # as a congested bus is
    world.master.commit(0b01, world.now)
    world.master.give_up("canceled")
    for states in (0b10, 0b01):
        with pytest.raises(Busy, match="an older frame 205h was not sent yet"):
            world.master.commit(states, world.now)
    world.buses["can0"].stuck = False
    world.buses["can0"].begin()
    world.frames()
    world.commit_when_possible(1, 0)
    assert world.frames()[-2:] == [(0x205, "01"), (0x080, "")]
    assert world.switches() == [1, 0]


def test_a_commit_before_boot_is_refused():
    world = World()
    with pytest.raises(Busy, match="booted"):
        world.master.commit(1, world.now)
    world.run(0.1)
    assert world.frames() == []


@pytest.mark.parametrize("states", [-1, 4])
def test_wrong_states_are_refused(states):
    with pytest.raises(ValueError, match="2 lines"):
        World().up().master.commit(states, 0.06)


def test_rpdos_that_do_not_leave_in_time_end_the_commit():
    world = World().up()
    world.buses["can0"].stuck = True
    world.commit(1, 0)
    assert "were not sent" in world.master.commit_failed
    world.buses["can0"].stuck = False
    world.buses["can0"].begin()
    world.run(0.1)
    assert (0x080, "") not in world.frames()
    assert world.switches() == [0, 0]
    world.commit(0, 1)
    assert world.frames()[-2:] == [(0x205, "02"), (0x080, "")]


def test_no_sync_follows_a_stall_of_the_loop():
    world = World().up()
    world.master.commit(1, world.now)
    world.stall(0.2)
    assert not world.master.committing
    assert "halted" in world.master.commit_failed or "not sent" in world.master.commit_failed
    world.run(0.1)
    assert (0x080, "") not in world.frames()
    assert world.faults == []


def test_a_stuck_bus_is_lost_before_its_boards_lose_the_master():
    world = World().up()
    world.buses["can0"].stuck = True
    took = world.until(lambda: world.told())
    why = "no frame was sent for 0.2 s: is the bus full, and does another node acknowledge?"
    assert world.faults == [ArmFault("bus-busy", "can0", f"can0: {why}")]
    assert took < world.timing.heartbeat_timeout


def test_a_commit_whose_bus_is_lost_names_it():
    world = World(two_buses()).up()
    world.buses["can1"].stuck = True
    world.master.commit(bits(1, 1), world.now)
    world.run(0.005)
    assert world.master.collecting
    world.buses["can1"].go_off()
    assert world.master.commit_failed == "can1 was lost"
    assert not world.master.committing


def test_a_sync_on_its_way_when_the_bus_is_lost_is_read_back():
    world = World().up()
    bus = world.buses["can0"]
    world.master.commit(bits(1, 0), world.now)
    world.until(lambda: not world.master.outputs_known)  # its SYNC was handed out
    world.buses["can0"].go_off()
    assert not world.master.committing
    assert "lost" in world.master.commit_failed
    assert not world.master.outputs_known
    world.run(0.1)
    assert bus.log
    world.buses["can0"].restore()
    world.up()
    assert (world.master.outputs, world.switches()) == (0b01, [1, 0])
