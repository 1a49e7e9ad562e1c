"""The folder of recordings: one recorder, repair at its start, room."""

import os
from pathlib import Path

import pytest

from hyperbit.controller.host.keeper import FileInUse
from hyperbit.controller.recorder.folder import CAN_LOG, Folder
from hyperbit.controller.recorder.repair import unfinished
from tests.recorder.samples import numbers, read, written


def test_names_tell_arm_and_time_and_never_meet(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "new" / "folder", "a")
    first = folder.new(0.0)
    assert first.name == "a-19700101T000000Z-1.mcap"
    first.touch()
    assert folder.new(0.0).name == "a-19700101T000000Z-2.mcap"
    folder.close()


def test_one_recorder_writes_an_arm(tmp_path: Path) -> None:
    folder = Folder(tmp_path, "a")
    with pytest.raises(FileInUse, match="end the other recorder of the arm 'a', or use another --folder"):
        Folder(tmp_path, "a")
    Folder(tmp_path, "b").close()
    folder.close()
    Folder(tmp_path, "a").close()


def test_unfinished_recordings_of_the_arm_are_repaired_at_the_start(tmp_path: Path) -> None:
    cut, empty, others = (tmp_path / f"{name}-19700101T00000{k}Z.mcap" for k, name in enumerate(("a", "a", "a-b")))
    for path in (cut, others):
        recording = written(path)
        recording.flush()
        recording.abandon()
    empty.touch()
    Folder(tmp_path, "a").close()
    assert numbers(read(cut)) == list(range(100))
    assert not empty.exists()
    assert unfinished(others), "of another arm, whose name begins like this one's"


def test_a_damaged_recording_is_set_aside_and_the_recorder_starts(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a-19700101T000000Z.mcap"
    recording = written(path)
    recording.flush()
    recording.abandon()
    content = bytearray(path.read_bytes())
    at, chunk = 8, 6
    while content[at] != chunk:
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    content[at + 25 : at + 33] = b"\xff" * 8  # the uncompressed size of the first chunk
    path.write_bytes(content)
    Folder(tmp_path, "a").close()
    (aside,) = tmp_path.glob("*.damaged-*")
    assert f"{path} was damaged (McapError: a chunk of {2**64 - 1} bytes), and renamed to {aside.name}" in caplog.text
    assert aside.read_bytes() == bytes(content)
    assert not path.exists(), "the first chunk has the channels: without it nothing can be read"


def test_a_file_of_somebody_else_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "a-19700101T000000Z.mcap"
    path.write_bytes(b"no recording, but named as one")
    Folder(tmp_path, "a").close()
    assert path.read_bytes() == b"no recording, but named as one"


@pytest.mark.parametrize("step", [-1e8, 1.0, 1e8])
def test_the_oldest_recordings_make_room(tmp_path: Path, step: float) -> None:
    """Whatever is the time by the system's clock, which was set before the third one."""
    folder, paths = Folder(tmp_path, "a"), []
    for k in range(4):
        now = 1e9 + k + step * (k >= 2)
        path = folder.new(now)
        path.write_bytes(b"x" * 500)
        path.with_suffix(CAN_LOG).write_bytes(b"x" * 500)
        for part in (path, path.with_suffix(CAN_LOG)):
            os.utime(part, (now, now))
        paths.append(path)
    other = tmp_path / "b-19700101T000000Z.mcap"
    other.write_bytes(b"x" * 5000)
    folder.close()
    folder = Folder(tmp_path, "a", keep=2500)
    folder.make_room(paths[0])
    assert [path.exists() for path in paths] == [True, False, False, True]
    assert [path.with_suffix(CAN_LOG).exists() for path in paths] == [True, False, False, True]
    assert other.exists()
    folder.close()
