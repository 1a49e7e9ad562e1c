"""Exact frames on the wire. Frames are written as COB-ID and data: sent ones, then answers."""

from __future__ import annotations

import pytest

from drivers.canopen.wiring import Timing
from tests.drivers.canopen.world import World, two_boards, two_buses

HOLD = """
605 40 00 10 00 00 00 00 00 | device type                      585 43 00 10 00 91 01 03 00
605 40 17 10 00 00 00 00 00 | does it send heartbeats? no      585 4b 17 10 00 00 00 00 00
605 40 00 18 01 00 00 00 00 | TPDO1, for bit 30                585 43 00 18 01 85 01 00 40
605 2f 06 62 01 00 00 00 00 | outputs hold                     585 60 06 62 01 00 00 00 00
000 80 05                   | pre-operational
605 23 06 10 00 00 00 00 00 | no SYNC period                   585 60 06 10 00 00 00 00 00
605 23 16 10 01 5e 01 7f 00 | master 127 within 350 ms         585 60 16 10 01 00 00 00 00
605 2f 29 10 01 00 00 00 00 | pre-operational without it       585 60 29 10 01 00 00 00 00
605 2b 17 10 00 64 00 00 00 | heartbeat every 100 ms           585 60 17 10 00 00 00 00 00
605 23 00 14 01 05 02 00 80 | RPDO1 off                        585 60 00 14 01 00 00 00 00
605 2f 00 14 02 01 00 00 00 | on SYNC                          585 60 00 14 02 00 00 00 00
605 2b 00 14 05 00 00 00 00 | no deadline                      585 60 00 14 05 00 00 00 00
605 2f 00 16 00 00 00 00 00 | unmapped                         585 60 00 16 00 00 00 00 00
605 23 00 16 01 08 01 00 62 | 6200h sub 1                      585 60 00 16 01 00 00 00 00
605 2f 00 16 00 01 00 00 00 | one object                       585 60 00 16 00 00 00 00 00
605 23 00 14 01 05 02 00 00 | RPDO1 on                         585 60 00 14 01 00 00 00 00
605 23 00 18 01 85 01 00 c0 | TPDO1 off                        585 60 00 18 01 00 00 00 00
605 2f 00 18 02 ff 00 00 00 | on change                        585 60 00 18 02 00 00 00 00
605 2b 00 18 05 00 00 00 00 | no period                        585 60 00 18 05 00 00 00 00
605 2f 00 1a 00 00 00 00 00 | unmapped                         585 60 00 1a 00 00 00 00 00
605 23 00 1a 01 08 01 00 60 | 6000h sub 1                      585 60 00 1a 01 00 00 00 00
605 2f 00 1a 00 01 00 00 00 | one object                       585 60 00 1a 00 00 00 00 00
605 23 00 18 01 85 01 00 40 | TPDO1 on                         585 60 00 18 01 00 00 00 00
605 2f 05 60 00 01 00 00 00 | inputs tell of changes           585 60 05 60 00 00 00 00 00
000 01 05                   | start                            185 00
605 40 00 62 01 00 00 00 00 | outputs                          585 4f 00 62 01 00 00 00 00
605 40 00 60 01 00 00 00 00 | inputs                           585 4f 00 60 01 00 00 00 00
"""
CONTRACT = (
    HOLD.replace("605 2f 29 10 01 00", "605 2f 29 10 01 02")
    .replace("pre-operational without it ", "stopped without it")
    .replace(
        "605 40 00 62 01",
        "605 2f 07 62 01 00 00 00 00 | error value 0     585 60 07 62 01 00 00 00 00\n"
        "605 2f 06 62 01 ff 00 00 00 | taken on error    585 60 06 62 01 00 00 00 00\n"
        "605 40 00 62 01",
    )
)


def spoken(table: str) -> list[tuple[int, str]]:
    frames = []
    for line in table.strip().splitlines():
        sent, _, rest = line.partition("|")
        answer = rest.rpartition("  ")[2] if "  " in rest.strip() else ""
        frames += [(int(f[:3], 16), f[4:].strip()) for f in (sent, answer.strip()) if f]
    return frames


@pytest.mark.parametrize(("on_loss", "table"), [("hold", HOLD), ("contract", CONTRACT)])
def test_boot_of_one_board(on_loss, table):
    world = World(on_loss=on_loss).boot()
    assert world.master.boot_faults == []
    assert world.frames() == spoken(table)


def test_a_commit_sends_all_rpdos_then_one_sync(monkeypatch):
    world = World(two_boards()).up()
    world.commit(1, 1)
    world.run(0.1)
    assert world.frames() == [(0x205, "01"), (0x209, "08"), (0x080, ""), (0x185, "01"), (0x189, "04")]
    assert world.measured() == [1, 1]


def test_a_commit_sends_only_what_changes():
    world = World(two_boards()).up()
    world.commit(1, 1)
    world.run(0.1)
    world.frames()
    world.commit(1, 0)
    world.run(0.1)
    assert world.frames() == [(0x209, "00"), (0x080, ""), (0x189, "00")]
    assert [mask for mask, _ in world.switched] == [0b11, 0b10]


def test_the_first_sync_overwrites_what_may_be_latched_in_any_board():
    world = World(two_boards()).up()
    world.say(0x209, b"\x08")  # an RPDO of a master that died before its SYNC
    world.run(0.01)
    world.frames()
    world.commit(1, 0)
    world.run(0.1)
    assert world.frames() == [(0x205, "01"), (0x209, "00"), (0x080, ""), (0x185, "01")]
    assert world.switches() == [1, 0]


def test_commit_with_a_shared_rpdo():
    world = World(two_boards(), shared_rpdo=True).boot()
    assert world.master.boot_faults == []
    frames = world.frames()
    left, right = ([data for cob_id, data in frames if cob_id == 0x600 + node] for node in (5, 9))
    assert "23 00 16 01 08 01 00 62" in left
    assert "23 00 16 02 08 00 05 00" in left  # the second byte is for another board
    assert "23 00 16 01 08 00 05 00" in right  # the first byte is for another board
    assert "23 00 16 02 08 01 00 62" in right
    assert "23 00 14 01 05 02 00 00" in right  # both take 205h
    world.commit(1, 1)
    world.run(0.1)
    assert world.frames() == [(0x205, "01 08"), (0x080, ""), (0x185, "01"), (0x189, "04")]
    world.commit(0, 1)
    world.run(0.1)
    assert world.frames() == [(0x205, "00 08"), (0x080, ""), (0x185, "00")]


def test_nothing_is_sent_if_nothing_changes():
    world = World().up()
    world.commit(0, 0)
    world.commit(1, 0)
    world.run(0.1)
    world.frames()
    world.commit(1, 0)
    world.master.status()
    world.run(0.1)
    assert world.frames() == []


def test_no_sync_is_sent_on_any_bus_before_all_rpdos_have_left_on_all():
    world = World(two_buses()).up()
    world.frames("can1")
    world.buses["can1"].held = True
    world.master.commit(3, world.now)
    world.flush()
    world.run(0.02)
    assert (world.frames(), world.frames("can1")) == ([(0x205, "01")], [])
    assert world.master.committing
    assert world.master.outputs == 0
    world.buses["can1"].held = False
    world.buses["can1"].next()
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
