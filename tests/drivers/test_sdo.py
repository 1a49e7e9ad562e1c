"""The SDO client against answers a test makes up."""

from __future__ import annotations

import canopen
import pytest

import drivers.sdo
from drivers.faults import BusBusy
from drivers.layout import Board
from drivers.sdo import BoardError, Entry, Sdo

BOARD = Board("can0", 5, (1,), (), 0x205, (), slice(0, 1), slice(0, 0))
TYPE = b"\x43\x00\x10\x00\x91\x01\x02\x00"
OTHER = b"\x4f\x00\x62\x01\x01\x00\x00\x00"


class Line:
    """A bus whose answers to each request are given beforehand; None: it takes no frame."""

    def __init__(self, *answers: list[bytes] | None) -> None:
        self.network = canopen.Network()
        self.answers = list(answers)
        self.sdo = Sdo(BOARD, self, self.network)

    def send(self, message, timeout=None) -> None:
        if message.data[0] == 0x80:
            return  # an abort wants no answer
        answers = self.answers.pop(0)
        if answers is None:
            raise BusBusy("can0: full")
        for answer in answers:
            self.network.notify(0x585, bytearray(answer), 0.0)


@pytest.fixture(autouse=True)
def _hurry(monkeypatch):
    monkeypatch.setattr(drivers.sdo, "_TIMEOUT", 0.01)


@pytest.mark.parametrize("first", [[OTHER, TYPE], [], None])
def test_asks_again_when_the_answer_is_late_missing_or_the_bus_busy(first):
    assert Line(first, [TYPE]).sdo.read(0x1000, 0, size=4) == 0x00020191


@pytest.mark.parametrize(
    ("answers", "words"), [([], "No SDO response"), ([OTHER], "another SDO client"), (None, "full")]
)
def test_gives_up_in_the_end(answers, words):
    with pytest.raises(BoardError, match=rf"can0/5 does not answer to 1000h sub 0: .*{words}"):
        Line(answers, answers).sdo.read(0x1000, 0, size=4)


@pytest.mark.parametrize("code", [0x06010002, 0x06020000])
def test_an_object_that_is_not_optional_may_not_be_refused(code):
    abort = b"\x80\x17\x10\x00" + code.to_bytes(4, "little")
    with pytest.raises(BoardError, match=rf"refuses 0064h in 1017h sub 0: .*{code:08X}h") as caught:
        Line([abort]).sdo.write(Entry(0x1017, 0, 100, size=2))
    assert caught.value.fault.code == "sdo-refused"


def test_a_value_without_its_size_is_cut_to_what_is_needed():
    assert Line([b"\x42\x00\x62\x01\x07\xff\xff\xff"]).sdo.read(0x6200, 1) == 7


@pytest.mark.parametrize(
    "answers",
    [
        [b"\x4b\x00\x62\x01\x07\x01\x00\x00"],
        [b"\x41\x00\x62\x01\x06\x00\x00\x00", b"\x03\x01\x02\x03\x04\x05\x06\x00"],
    ],
    ids=["two bytes", "six bytes in a segment"],
)
def test_a_value_of_another_size_is_another_device(answers):
    with pytest.raises(BoardError, match=r"answers . bytes to 6200h sub 1; 1 are needed") as caught:
        Line(*([answer] for answer in answers)).sdo.read(0x6200, 1)
    assert caught.value.fault.code == "wrong-device"


def test_segments_without_end_are_given_up():
    segments = [[bytes([0x10 * (k % 2), *range(7)])] for k in range(1000)]
    line = Line([b"\x40\x00\x62\x01\0\0\0\0"], *segments)
    with pytest.raises(BoardError, match="does not answer"):
        line.sdo.read(0x6200, 1)
    assert len(line.answers) > 900


def test_what_nobody_asked_for_is_not_kept():
    line = Line([TYPE])
    for _ in range(100):
        line.network.notify(0x585, bytearray(TYPE), 0.0)
    assert line.sdo._client.responses.empty()
    assert line.sdo.read(0x1000, 0, size=4) == 0x00020191
    line.network.notify(0x585, bytearray(TYPE), 0.0)
    assert line.sdo._client.responses.empty()
