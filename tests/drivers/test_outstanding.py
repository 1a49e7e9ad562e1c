from __future__ import annotations

import can
import pytest

from drivers import outstanding
from drivers.cia301 import frame
from drivers.outstanding import Outstanding

A, B = frame(0x205, b"\x01"), frame(0x206, b"\x02")


def send(it: Outstanding, *messages: can.Message) -> None:
    for message in messages:
        with it.sending(message):
            pass


@pytest.fixture
def known() -> Outstanding:
    """Of an interface that has given a frame back."""
    it = Outstanding()
    send(it, A)
    assert it.came_back(A)
    return it


def test_nothing_is_outstanding_where_nothing_ever_comes_back():
    it = Outstanding()
    send(it, A, B)
    assert (it.waiting, it.oldest) == (False, None)


def test_frames_come_back_in_any_order(known):
    send(known, A, B, A)
    assert known.oldest is not None
    assert [known.came_back(m) for m in (B, A)] == [True, True]
    assert known.waiting
    assert known.came_back(A)
    assert (known.waiting, known.oldest) == (False, None)


def test_a_frame_that_was_not_sent_is_another_masters(known):
    send(known, A)
    assert not known.came_back(B)
    assert known.came_back(A)
    assert not known.came_back(A)


def test_one_that_failed_is_not_outstanding(known):
    with pytest.raises(can.CanError), known.sending(A):
        raise can.CanOperationError("full", 105)
    assert not known.waiting
    assert not known.came_back(A)


def test_what_is_written_off_may_still_come_back(known):
    send(known, A)
    known.write_off()
    assert not known.waiting
    assert known.came_back(A)
    assert not known.came_back(A)


def test_the_word_of_a_frame_may_be_lost(known, monkeypatch):
    send(known, A)
    monkeypatch.setattr(outstanding, "_LONGEST", -1.0)
    send(known, B)
    assert known.came_back(B)
    assert not known.waiting


def test_nothing_comes_back_to_a_bus_that_is_opened_anew(known):
    send(known, A)
    known.forget()
    assert not known.waiting
    assert not known.came_back(A)
