from __future__ import annotations

import pytest

from drivers.faults import BusError
from drivers.probe import probe
from drivers.wiring import BusSettings, Channel, Wiring


def test_every_board_says_what_it_is_and_nothing_on_it_changes(make_rig, two_boards):
    rig = make_rig(two_boards)
    rig.boot()
    with rig.simulation.board("can0/9") as board:
        board.objects.put(0x1000, 0, 0x00020191)
    good, wrong = probe(rig.wiring)
    assert (good.board, good.ok) == ("can0/5", True)
    assert good.text == "device type 00030191h, error register 00h"
    assert (wrong.board, wrong.ok) == ("can0/9", False)
    assert "00020191h" in wrong.text
    requests = [data for cob_id, data in rig.frames() if 0x600 < cob_id < 0x680]
    assert requests
    assert all(data.startswith("40") for data in requests)  # SDO uploads only


def test_a_silent_board_is_told_by_name(make_rig):
    rig = make_rig()
    rig.simulation.fault("silence", "can0/5")
    rig.boot()
    [answer] = probe(rig.wiring)
    assert not answer.ok
    assert "can0/5 does not answer" in answer.text


def test_a_bus_that_cannot_be_opened_is_told():
    bus = BusSettings("can0", "socketcan", "no-such-interface")
    with pytest.raises(BusError, match="no-such-interface"):
        probe(Wiring((bus,), (Channel("a", "can0", 5, 0, 0),)))
