"""Error frames according to linux/can/error.h."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire.bus import read_error


@pytest.mark.parametrize(
    ("kind", "data", "state", "errors"),
    [
        (0x04, "00 04 00 00 00 00 60 00", "warning", (96, 0)),
        (0x04, "00 08 00 00 00 00 00 61", "warning", (0, 97)),
        (0x04, "00 10 00 00 00 00 00 80", "passive", (0, 128)),
        (0x204, "00 24 00 00 00 00 82 07", "passive", (130, 7)),  # passive in sending is past warning in receiving
        (0x04, "00 40 00 00 00 00 5f 00", "active", (95, 0)),
        (0x04, "00 01 00 00 00 00 02 03", None, (2, 3)),  # its buffer ran over
        (0x04, "00 01 00 00 00 00 00 00", None, None),  # likewise; this driver tells no counters
        (0x204, "00 01 00 00 00 00 00 00", None, (0, 0)),
        (0x04, "", None, None),
        (0x40, "00 00 00 00 00 00 00 00", "bus-off", None),
        (0x44, "00 20 00 00 00 00 ff 00", "bus-off", (255, 0)),
        (0x100, "", "active", None),
        (0x140, "", "bus-off", None),
        (0x08, "00 00 08 00 00 00 00 00", None, None),  # a bit error alone
    ],
)
def test_state_and_counters(kind, data, state, errors):
    assert read_error(kind, bytes.fromhex(data))[:2] == (state, errors)


@pytest.mark.parametrize(
    ("kind", "data", "lost"), [(0x04, "00 01", True), (0x04, "00 02", False), (0x08, "00 01", False)]
)
def test_only_an_overrun_of_the_receive_buffer_loses_frames(kind, data, lost):
    assert read_error(kind, bytes.fromhex(data))[2] == lost
