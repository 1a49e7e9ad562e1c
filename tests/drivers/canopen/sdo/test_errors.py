"""The habits of boards in their error history."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.sdo.errors import Errors

LOST, HARDWARE, OVERLOAD = 0x8130, 0x5000, 0x2310
NODE_LOST, NODE_LOST_ENDED = 0x1B11_8130, 0x1B00_0000  # CANopenNode, with 1001h in bits 16 to 23
NODE_BUS_OFF, NODE_BUS_OFF_ENDED, NODE_PASSIVE = 0x1210_8140, 0x1210_0000, 0x0600_8120


def errors(register: int, *entries: int, complete: bool = True) -> Errors:
    """`entries`: the newest first."""
    return Errors(register, entries, complete)


@pytest.mark.parametrize(
    ("found", "standing", "lost", "undecided"),
    [
        (errors(0x11, LOST), [LOST], True, False),
        (errors(0x11, LOST, LOST), [LOST, LOST], True, False),
        (errors(0x11, LOST, HARDWARE), [LOST, HARDWARE], False, True),
        (errors(0x11, HARDWARE, LOST), [HARDWARE, LOST], False, True),
        (errors(0x13, LOST, OVERLOAD), [LOST, OVERLOAD], False, False),  # the loss sets no bit 1
        (errors(0x01, HARDWARE), [HARDWARE], False, False),
        (errors(0x01, LOST, HARDWARE), [LOST, HARDWARE], False, False),
        (errors(0x11), [], False, False),
        (errors(0x11, LOST, complete=False), [LOST], False, True),
        (errors(0x10, NODE_LOST, NODE_BUS_OFF), [NODE_LOST, NODE_BUS_OFF], False, False),
        (errors(0x10, NODE_LOST_ENDED, NODE_LOST, NODE_BUS_OFF), [NODE_BUS_OFF], False, False),
        (errors(0x10, NODE_LOST, NODE_BUS_OFF_ENDED, NODE_BUS_OFF), [NODE_LOST], True, False),
        (errors(0x10, NODE_BUS_OFF_ENDED, NODE_LOST), [NODE_LOST], True, False),  # its start was pushed out
        (errors(0x10, NODE_LOST, NODE_PASSIVE), [NODE_LOST, NODE_PASSIVE], True, False),  # sets no bit of 1001h
        (errors(0x11, 0, HARDWARE), [], False, False),
        (errors(0x11, 0, OVERLOAD, HARDWARE), [OVERLOAD, HARDWARE], False, False),  # which one has ended?
        (errors(0x11, 0, 0, OVERLOAD, HARDWARE), [], False, False),
        (errors(0x11, LOST, 0, 0, 0), [LOST], True, False),  # sub-index 0 has the number of places
    ],
)
def test_standing_ended_and_lost_master_are_told_apart(found, standing, lost, undecided):
    assert [value for _, value in found.standing] == standing
    assert (found.lost(None), found.open) == (lost, undecided)


@pytest.mark.parametrize(("reported", "lost"), [(None, True), (LOST, True), (HARDWARE, False)])
def test_without_a_history_an_emergency_tells_the_cause(reported, lost):
    assert Errors(0x11, None).lost(reported) is lost
    assert "has no 1003h" in Errors(0x11, None).words(reported)
    assert not Errors(0x01, None).lost(reported)


@pytest.mark.parametrize(("reported", "told"), [(HARDWARE, False), (OVERLOAD, True)])
def test_the_sentence_has_an_emergency_only_if_no_entry_has_it(reported, told):
    assert ("it reported" in errors(0x01, HARDWARE).words(reported)) is told


def test_the_sentence_names_what_stands_and_not_what_has_ended():
    text = errors(0x10, NODE_LOST_ENDED, NODE_LOST, NODE_BUS_OFF).words()
    assert "1003h sub 3 is 12108140h, recovered from bus-off (8140h)" in text
    assert "8130h" not in text
