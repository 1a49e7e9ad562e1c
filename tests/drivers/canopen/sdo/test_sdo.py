"""The SDO client, and the dictionary of a board, with scripted answers."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.objects import Need
from hyperbit.drivers.canopen.sdo.procedure import Procedure, Runner
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.link import Link
from hyperbit.drivers.canopen.wiring import BusWiring

TYPE = b"\x43\x00\x10\x00\x91\x01\x02\x00"
OTHER = b"\x4f\x00\x62\x01\x01\x00\x00\x00"
ABORT_OF_OTHER = b"\x80\x29\x10\x01\x00\x00\x02\x06"


class Line:
    """A bus with scripted answers to each request; None: it accepts no frame."""

    def __init__(self, *answers: list[bytes] | None) -> None:
        self.sent: list[Frame] = []
        self.link = Link(BusWiring("can0", "none", ""), lambda bus, frame: self.sent.append(frame), 10.0)
        self.link.changed("active", "", None, 0.0)
        self.runner = Runner(5, self.link)
        self.answers, self.now, self.requests = list(answers), 0.0, list[str]()
        self.value: object = None
        self.fault: ArmFault | None = None

    def run(self, steps) -> object:
        def procedure():
            self.value = yield from steps

        def ended(fault: ArmFault | None, now: float) -> None:
            self.fault = fault

        self.runner.start(procedure(), ended, self.now)
        while self.runner.running:
            self.hand_over()
            self.now += 0.01
            self.link.tick(self.now, self.now)
            self.runner.tick(self.now)
            assert self.now < 100
        return self.fault or self.value

    def hand_over(self) -> None:
        while self.sent:
            frame = self.sent.pop(0)
            self.requests.append(frame.data.hex(" "))
            if frame.data[0] == 0x80:
                continue  # an abort wants no answer
            answers = self.answers.pop(0) if self.answers else []
            if answers is None:
                self.link.send_failed(frame, self.now)
                continue
            for answer in answers:
                self.runner.receive_sdo(answer, self.now)
                self.runner.check(self.now)


def known(need: Need, present: int) -> Dictionary:
    """Returns the dictionary of a board that has a value."""
    it = Dictionary("can0/5")
    it.values[need.at] = present
    return it


def ensure(need: Need, present: int) -> Procedure:
    return known(need, present).ensure(need)


@pytest.mark.parametrize("first", [[], [OTHER], [ABORT_OF_OTHER], [OTHER, TYPE], None])
def test_asks_again_if_the_answer_is_late_or_missing_or_the_bus_full(first):
    assert Line(first, [TYPE]).run(Dictionary("can0/5").read(0x1000, 0, 4)) == 0x00020191


def test_late_answers_to_another_object_are_dropped():
    late = [b"\x60\x17\x10\x00\0\0\0\0", ABORT_OF_OTHER, OTHER, b"\x4f\x00\x10\x01\0\0\0\0"]
    line = Line([*late, TYPE])
    assert line.run(Dictionary("can0/5").read(0x1000, 0, 4)) == 0x00020191
    assert line.now < 0.1


def test_a_refusal_of_another_object_is_no_refusal_and_a_confirmation_of_another_no_confirmation():
    need = Need(0x1017, 0, 600, 2, "period of its heartbeat")
    fault = Line(*[[ABORT_OF_OTHER]] * 3).run(ensure(need, 0))
    assert fault.code == "board-missing"
    fault = Line([b"\x60\x16\x10\x01\0\0\0\0", b"\x80\x17\x10\x00\x30\x00\x09\x06"]).run(ensure(need, 0))
    assert fault.code == "sdo-refused"
    assert fault.message == (
        "board can0/5 has 0000h in 1017h sub 0 (period of its heartbeat); 0258h is needed, which it refuses:"
        " value out of range (abort 06090030h)"
    )


def test_gives_up_after_three_attempts():
    line = Line()
    fault = line.run(Dictionary("can0/5").read(0x1000, 0, 4))
    assert fault.code == "board-missing"
    assert "can0/5 does not answer to 1000h sub 0: no SDO answer within 0.5 s, asked 3 times" in fault.message
    assert line.requests == ["40 00 10 00 00 00 00 00"] * 3
    assert 1.4 < line.now < 1.7


def test_an_object_without_an_answer_on_a_board_that_answers_is_told_apart_from_a_missing_board():
    line = Line(*[[], [], [], [TYPE]] * 2)
    fault = line.run(Dictionary("can0/5").find(0x100C, 0))
    assert fault.code == "sdo-unanswered"
    assert "answers to 1000h, but not to 100Ch sub 0" in fault.message
    line = Line([], [], [], [TYPE], [b"\x4f\x29\x10\x01\x02\0\0\0"])  # three frames were lost
    assert line.run(Dictionary("can0/5").find(0x1029, 1)) == 2
    assert Line().run(Dictionary("can0/5").find(0x1029, 1)).code == "board-missing"


def test_gives_up_if_the_bus_takes_no_frame():
    line = Line(*[None] * 1000)
    fault = line.run(Dictionary("can0/5").read(0x1000, 0, 4))
    assert fault.code == "board-missing"
    assert 1.4 < line.now < 1.7


@pytest.mark.parametrize("absent", [0x06020000, 0x06090011])
def test_an_absent_object_is_none_and_told_if_it_is_required(absent):
    abort = b"\x80\x29\x10\x01" + absent.to_bytes(4, "little")
    assert Line([abort]).run(Dictionary("can0/5").check(Need(0x1029, 1, 2))) is None
    fault = Line([abort]).run(
        Dictionary("can0/5").check(Need(0x1029, 1, 2, 1, "error behaviour", required="it must stop"))
    )
    assert fault.code == "wrong-device"
    assert fault.message == "board can0/5 has no 1029h sub 1 (error behaviour); 02h is needed there: it must stop"


def test_what_was_written_is_read_back():
    need = Need(0x6206, 1, 0x01, 1, "error mode", mask=0x03)
    line = Line([b"\x60\x06\x62\x01\0\0\0\0"], [b"\x4f\x06\x62\x01\xfd\0\0\0"])
    assert line.run(ensure(need, 0xFE)) is None
    assert line.requests == ["2f 06 62 01 fd 00 00 00", "40 06 62 01 00 00 00 00"]
    line = Line([b"\x60\x06\x62\x01\0\0\0\0"], [b"\x4f\x06\x62\x01\xfe\0\0\0"])
    fault = line.run(ensure(need, 0xFE))
    assert "has FEh in 6206h sub 1 (error mode) after FDh was written" in fault.message


def test_a_late_confirmation_of_a_repeated_write_does_not_hide_a_refusal():
    """The first write was answered late: the second answer to it comes while the next value is written."""
    it = known(Need(0x1600, 0, 1), 2)
    confirmed, refused = b"\x60\x00\x16\x00\0\0\0\0", b"\x80\x00\x16\x00\x30\x00\x09\x06"
    line = Line([], [confirmed], [confirmed], [refused])

    def steps():
        first = yield from it.write(0x1600, 0, 0, 1)
        second = yield from it.write(0x1600, 0, 1, 1)
        return first, second

    assert line.run(steps()) == (None, 0x06090030)


def test_answers_that_never_come_late_do_not_delay_what_follows():
    need = Need(0x6206, 1, 1)
    confirmed, present = b"\x60\x06\x62\x01\0\0\0\0", b"\x4f\x06\x62\x01\x01\0\0\0"
    line = Line([], [confirmed], [present], [present])  # the answer to the first request was lost
    begun = line.now
    assert line.run(ensure(need, 0)) is None
    assert line.now - begun < 0.6  # one time-out, of the first request
    assert line.requests == ["2f 06 62 01 01 00 00 00"] * 2 + ["40 06 62 01 00 00 00 00"] * 2


def test_answers_that_are_long_overdue_are_expected_no_more():
    """Reads go on all the time, as those of outputs that are switched: lost answers slow them for 4 s only."""
    present = b"\x4f\x00\x62\x01\x01\0\0\0"
    line = Line([], [], *[[present]] * 200)  # two answers were lost
    assert line.run(Dictionary("can0/5").read(0x6200, 1, fresh=True)) == 1
    counts, lost_at = list[int](), line.now
    while line.now < lost_at + 6.0:
        begun = len(line.requests)
        assert line.run(Dictionary("can0/5").read(0x6200, 1, fresh=True)) == 1
        counts.append(len(line.requests) - begun)
        line.now += 0.5
    assert (counts[0], counts[-1]) == (3, 1)


def test_late_answers_to_a_read_that_was_given_up_do_not_count_for_the_next_one():
    late, present = b"\x4f\x00\x62\x01\x01\0\0\0", b"\x4f\x00\x62\x01\x02\0\0\0"
    line = Line([], [], [], [late], [late], [late], *[[present]] * 3)
    assert line.run(Dictionary("can0/5").read(0x6200, 1)).code == "board-missing"
    assert line.run(Dictionary("can0/5").read(0x6200, 1, fresh=True)) == 2


def test_a_slow_board_is_given_more_time():
    slow = [[TYPE]]
    line = Line([], *slow, [], [b"\x4f\x00\x62\x01\x07\0\0\0"])
    assert line.run(Dictionary("can0/5").read(0x1000, 0, 4)) == 0x00020191  # after more than 0.5 s
    begun = line.now
    assert line.run(Dictionary("can0/5").read(0x6200, 1)) == 7
    assert line.now - begun > 1.2


def test_a_value_without_its_size_is_cut():
    assert Line([b"\x42\x00\x62\x01\x07\xff\xff\xff"]).run(Dictionary("can0/5").read(0x6200, 1)) == 7


def test_a_number_in_segments_is_read():
    answers = [[b"\x41\x00\x10\x00\x04\x00\x00\x00"], [b"\x07\x91\x01\x02\x00\x00\x00\x00"]]
    line = Line(*answers)
    assert line.run(Dictionary("can0/5").read(0x1000, 0, 4)) == 0x00020191
    assert line.requests == ["40 00 10 00 00 00 00 00", "60 00 00 00 00 00 00 00"]


@pytest.mark.parametrize(
    "answers",
    [[b"\x4b\x00\x62\x01\x07\x01\x00\x00"], [b"\x41\x00\x62\x01\x06\x00\x00\x00", b"\x03\x01\x02\x03\x04\x05\x06\x00"]],
    ids=["two bytes", "six bytes in a segment"],
)
def test_a_value_of_another_size_is_another_device(answers):
    fault = Line(*([answer] for answer in answers)).run(Dictionary("can0/5").read(0x6200, 1))
    assert fault.code == "wrong-device"
    assert "bytes to 6200h sub 1; 1 are needed" in fault.message


def test_a_segment_that_comes_twice_counts_once():
    first, last = b"\x0a\x91\x01\x00\x00\x00\x00\x00", b"\x1b\x02\x00\x00\x00\x00\x00\x00"  # two bytes each
    line = Line([b"\x41\x00\x10\x00\x04\x00\x00\x00"], [first, first], [last])
    assert line.run(Dictionary("can0/5").read(0x1000, 0, 4)) == 0x00020191


def test_segments_without_end_are_given_up():
    segments = [[bytes([0x10 * (k % 2), *range(7)])] for k in range(1000)]
    line = Line([b"\x40\x00\x62\x01\0\0\0\0"], *segments)
    fault = line.run(Dictionary("can0/5").read(0x6200, 1))
    assert "longer than 8 segments" in fault.message
    assert "80 00 62 01 05 00 04 05" in line.requests


def test_a_segment_that_does_not_come_is_aborted_and_all_is_asked_again():
    line = Line([b"\x40\x00\x62\x01\0\0\0\0"], [], [OTHER])
    assert line.run(Dictionary("can0/5").read(0x6200, 1)) == 1
    assert line.requests[2:] == ["80 00 62 01 00 00 04 05", "40 00 62 01 00 00 00 00"]
