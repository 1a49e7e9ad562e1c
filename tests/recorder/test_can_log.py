"""Frames beside a recording are candump's: python-can's reader has them back."""

from pathlib import Path

import can
import pytest

from hyperbit.controller.armfile.settings import BusSettings
from hyperbit.controller.recorder import can_log
from hyperbit.controller.recorder.can_log import CanLog
from tests.waiting import eventually

FRAMES = [
    can.Message(arbitration_id=0x205, data=b"\x01\x02", is_extended_id=False),
    can.Message(arbitration_id=0x80, data=b"", is_extended_id=False),
    can.Message(arbitration_id=0x705, is_remote_frame=True, is_extended_id=False),
    can.Message(arbitration_id=0x1ABCDEF0, data=bytes(8), is_extended_id=True),
]


def key(message: can.Message) -> tuple[int, bytes, bool, bool]:
    return message.arbitration_id, bytes(message.data), message.is_remote_frame, message.is_extended_id


def test_frames_of_all_buses_are_read_back(tmp_path: Path) -> None:
    names = ("log-a", "log-b")
    buses = [BusSettings(name, name, "virtual") for name in names]
    first, second = tmp_path / "1.candump", tmp_path / "2.candump"
    log = CanLog(buses)
    senders = [can.Bus(interface="virtual", channel=name) for name in names]
    log.begin(first)

    def lines(path: Path) -> int:
        log.flush()
        return len(path.read_text().splitlines())

    def heard() -> bool:  # a reader that has not opened its bus yet hears nothing
        for sender in senders:
            sender.send(FRAMES[1])
        return all(f" {name} " in first.read_text() for name in names) if lines(first) else False

    eventually(heard, every=0.1)
    log.begin(second)
    for sender in senders:
        for frame in FRAMES:
            sender.send(frame)
    eventually(
        lambda: (
            sum(line.split()[-1] == "1ABCDEF0#" + 16 * "0" for line in second.read_text().splitlines()) == 2
            if lines(second)
            else False
        )
    )
    log.close()
    for sender in senders:
        sender.shutdown()
    read = list(can.CanutilsLogReader(str(second)))
    for name in names:
        assert [key(message) for message in read if message.channel == name][-4:] == [key(frame) for frame in FRAMES]


def test_an_error_frame_is_marked() -> None:
    message = can.Message(timestamp=1.5, arbitration_id=0x40, data=bytes(8), is_error_frame=True, is_extended_id=False)
    assert can_log.candump(message, "can0") == "(1.500000) can0 20000040#0000000000000000\n"


def test_a_bus_that_cannot_be_opened_is_told_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(can_log, "REOPEN", 0.01)
    log = CanLog([BusSettings("can9", "no-such-interface9")])
    eventually(lambda: "can9 cannot be read" in caplog.text)
    log.close()
    assert caplog.text.count("can9 cannot be read") == 1
