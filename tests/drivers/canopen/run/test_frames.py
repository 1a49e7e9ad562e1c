"""Exact frames on the wire. Frames are written as COB-ID and data: sent ones, then answers."""

from __future__ import annotations

from hyperbit.drivers.canopen.wiring import Timing
from tests.drivers.rig import World, two_boards, two_buses


def spoken(world: World) -> str:
    """The frames of a world in lines: what the master sends, and the answer of the board to it."""
    lines: list[str] = []
    for cob_id, data in world.frames(sdo=True):
        frame = f"{cob_id:03x} {data}".strip()
        if cob_id & 0x780 == 0x580 and lines:
            lines[-1] = f"{lines[-1]:40}| {frame}"
        else:
            lines.append(frame)
    return "".join(f"{line}\n" for line in lines)


def test_a_commit_sends_all_rpdos_then_one_sync(monkeypatch):
    world = World(two_boards()).up()
    world.commit(1, 1, then=0.1)
    assert world.frames() == [(0x205, "01"), (0x209, "08"), (0x080, ""), (0x185, "01"), (0x189, "04")]
    assert world.measured() == [1, 1]


def test_a_commit_sends_only_what_changes():
    world = World(two_boards()).up()
    world.commit(1, 1, then=0.1)
    world.frames()
    world.commit(1, 0, then=0.1)
    assert world.frames() == [(0x209, "00"), (0x080, ""), (0x189, "00")]
    assert [mask for mask, _ in world.switched] == [0b11, 0b10]


def test_the_first_sync_comes_after_frames_to_all_boards():
    world = World(two_boards()).up()
    world.say(0x209, b"\x08")  # an RPDO of a master that died before its SYNC
    world.run(0.01)
    world.frames()
    world.commit(1, 0, then=0.1)
    assert world.frames() == [(0x205, "01"), (0x209, "00"), (0x080, ""), (0x185, "01")]
    assert world.switches() == [1, 0]


def test_commit_with_a_shared_rpdo():
    world = World(two_boards(), shared_rpdo=True)
    assert world.boot() == []
    frames = world.frames(sdo=True)
    left, right = ([data for cob_id, data in frames if cob_id == 0x600 + node] for node in (5, 9))
    assert "40 00 16 01 00 00 00 00" in left  # the first object is mapped already
    assert "23 00 16 02 08 00 05 00" in left  # the second byte is for another board
    assert "23 00 16 01 08 00 05 00" in right  # the first byte is for another board
    assert "23 00 16 02 08 01 00 62" in right
    assert "23 00 14 01 05 02 00 00" in right  # both take 205h
    world.commit(1, 1, then=0.1)
    assert world.frames() == [(0x205, "01 08"), (0x080, ""), (0x185, "01"), (0x189, "04")]
    world.commit(0, 1, then=0.1)
    assert world.frames() == [(0x205, "00 08"), (0x080, ""), (0x185, "00")]


def test_nothing_is_sent_if_nothing_changes():
    world = World().up()
    world.commit(0, 0)
    world.commit(1, 0, then=0.1)
    world.frames()
    world.commit(1, 0)
    world.master.status()
    world.run(0.1)
    assert world.frames() == []


def test_sync_waits_for_the_rpdos_of_all_buses():
    world = World(two_buses()).up()
    world.frames("can1")
    world.buses["can1"].stuck = True
    world.master.commit(3, world.now)
    world.run(0.02)
    assert (world.frames(), world.frames("can1")) == ([(0x205, "01")], [])
    assert world.master.committing
    assert world.master.outputs == 0
    world.buses["can1"].stuck = False
    world.buses["can1"].begin()
    world.run(0.1)
    assert world.frames()[0] == (0x080, "")
    assert world.frames("can1")[:2] == [(0x205, "01"), (0x080, "")]
    assert world.measured() == [1, 1]


def test_the_heartbeat_is_sent_by_ticks_only_and_in_time():
    world = World(timing=Timing(heartbeat=0.02, heartbeat_timeout=1.0)).up()
    world.buses["can0"].log.clear()
    world.run(0.2)
    beats = [frame for frame in world.buses["can0"].log if frame.id == 0x77F]
    assert beats == [(0x77F, b"\x05")] * 10
    world.stalled = True
    world.buses["can0"].log.clear()
    for _ in range(100):
        world.say(0x300, b"\x01")
    world.run(0.1)
    assert not [frame for frame in world.buses["can0"].log if frame.id == 0x77F]
