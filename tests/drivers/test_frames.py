"""Every byte on the wire, in order. Frames are written as COB-ID and data, sent ones and answers as they come."""

from __future__ import annotations

import pytest

HOLD = """
605 40 00 10 00 00 00 00 00 | is it there?                     585 43 00 10 00 91 01 03 00
605 40 00 10 00 00 00 00 00 | device type                      585 43 00 10 00 91 01 03 00
605 40 17 10 00 00 00 00 00 | does it send heartbeats? no      585 4b 17 10 00 00 00 00 00
605 40 00 18 01 00 00 00 00 | TPDO1, for bit 30                585 43 00 18 01 85 01 00 40
605 2f 06 62 01 00 00 00 00 | outputs hold                     585 60 06 62 01 00 00 00 00
000 80 05                   | pre-operational
605 23 06 10 00 00 00 00 00 | no SYNC period                   585 60 06 10 00 00 00 00 00
605 23 16 10 01 60 ea 7f 00 | master 127 within 60,000 ms      585 60 16 10 01 00 00 00 00
605 2f 29 10 01 00 00 00 00 | pre-operational without it       585 60 29 10 01 00 00 00 00
605 2b 17 10 00 14 00 00 00 | heartbeat every 20 ms            585 60 17 10 00 00 00 00 00
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
def test_start_of_one_board(make_rig, on_loss, table):
    rig = make_rig(on_loss=on_loss)
    rig.boot()
    assert rig.boards.start() == []
    assert rig.frames() == spoken(table)


def test_commit_sends_all_rpdos_then_one_sync(make_rig, two_boards):
    rig = make_rig(two_boards).up()
    rig.commit(1, 1)
    rig.arrive(1, 1)
    assert rig.frames() == [(0x205, "01"), (0x209, "08"), (0x080, ""), (0x185, "01"), (0x189, "04")]


def test_commit_sends_only_what_changes(make_rig, two_boards):
    rig = make_rig(two_boards).up()
    rig.commit(1, 1)
    rig.arrive(1, 1)
    rig.frames()
    rig.commit(1, 0)
    rig.arrive(1, 0)
    assert rig.frames() == [(0x209, "00"), (0x080, ""), (0x189, "00")]


def test_first_sync_overwrites_what_may_wait_in_any_board(make_rig, two_boards):
    rig = make_rig(two_boards).up()
    rig.say(0x209, b"\x08")  # an RPDO of a master that died before its SYNC
    rig.frames()
    rig.commit(1, 0)
    rig.arrive(1, 0)
    assert rig.frames() == [(0x205, "01"), (0x209, "00"), (0x080, ""), (0x185, "01")]
    assert rig.simulation.switches().tolist() == [1, 0]


def test_commit_with_a_shared_rpdo(make_rig, two_boards):
    rig = make_rig(two_boards, shared_rpdo=True)
    rig.boot()
    assert rig.boards.start() == []
    sent = [data for cob_id, data in rig.frames() if cob_id in (0x605, 0x609)]
    assert "23 00 16 01 08 01 00 62" in sent
    assert "23 00 16 02 08 00 05 00" in sent  # node 5: the second byte is for another board
    assert "23 00 16 01 08 00 05 00" in sent  # node 9: the first byte is
    assert "23 00 16 02 08 01 00 62" in sent
    assert "23 00 14 01 05 02 00 00" in sent[30:]  # both hear 205h
    rig.commit(1, 1)
    rig.arrive(1, 1)
    assert rig.frames() == [(0x205, "01 08"), (0x080, ""), (0x185, "01"), (0x189, "04")]
    rig.commit(0, 1)
    rig.arrive(0, 1)
    assert rig.frames() == [(0x205, "00 08"), (0x080, ""), (0x185, "00")]


def test_nothing_is_sent_when_nothing_changes(make_rig):
    rig = make_rig().up()
    rig.commit(0, 0)
    rig.commit(1, 0)
    rig.arrive(1, 0)
    rig.frames()
    rig.commit(1, 0)
    rig.boards.hold()
    rig.boards.status()
    assert rig.frames() == []


def test_heartbeats_come_from_tick_only_and_in_time(make_rig):
    rig = make_rig().up()
    rig.pass_time(0.1)
    assert rig.frames() == [(0x77F, "05")] * 5


def test_close_sends_nothing(make_rig):
    rig = make_rig().up()
    rig.boards.close()
    assert rig.frames() == []
