"""Files that are no recordings are refused in a sentence; those cut off are read as far as they go."""

from pathlib import Path

import pytest
from mcap.writer import Writer

from hyperbit.controller.recorder.reader import RecordingReader
from hyperbit.controller.recorder.recording import Recording
from hyperbit.controller.recorder.repair import BadRecording
from tests.recorder.samples import SECOND, written


def refusal(path: Path) -> str:
    with pytest.raises(BadRecording) as caught:
        RecordingReader(path)
    return str(caught.value)


def test_a_recording_is_read_from_any_time_on(tmp_path: Path) -> None:
    recording = written(tmp_path / "a.mcap")
    recording.close()
    past = RecordingReader(recording.path)
    assert (past.arm, past.begin, past.end, past.whole) == ("a", 1000 * SECOND, round(1004.95 * SECOND), True)
    assert [told.at for told in past.messages()] == [round((1000 + 0.05 * k) * SECOND) for k in range(100)]
    assert next(told.at for told in past.messages(1004 * SECOND)) == 1004 * SECOND
    (told,) = past.latest_before(1002 * SECOND)
    assert (told.key, told.at) == ("state", round(1001.95 * SECOND))
    (told,) = past.latest_before(999 * SECOND)
    assert (told.key, told.at) == ("state", 1000 * SECOND), "before the first state the arm is shown as it begins"
    assert past.latest_before(1000 * SECOND) == [], "what is of this time is due anyway"
    past.close()


def test_what_a_cut_recording_has_is_read(tmp_path: Path) -> None:
    recording = written(tmp_path / "a.mcap", 200)
    recording.close()
    recording.path.write_bytes(recording.path.read_bytes()[:-20])
    before = recording.path.read_bytes()
    past = RecordingReader(recording.path)
    assert not past.whole
    assert len(list(past.messages())) == 200
    assert recording.path.read_bytes() == before, "the file itself stays as it is"
    past.close()


@pytest.mark.parametrize("data", [b"", b"no recording", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" * 2, bytes(1000)])
def test_other_files_are_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(data)
    assert str(path) in refusal(path)


def test_no_file_a_folder_and_other_recordings_are_refused(tmp_path: Path) -> None:
    assert "No such file" in refusal(tmp_path / "none.mcap")
    assert "it is a directory, no file" in refusal(tmp_path)
    other = tmp_path / "other.mcap"
    with other.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/imu", "json", schema), 1, b"{}", 1)
        writer.finish()
    assert "of no arm" in refusal(other)
    two = Recording(tmp_path / "two.mcap")
    for name in ("a", "b"):
        two.write(f"hyperbit/{name}/state", "state", b"{}", 1, 1)
    two.close()
    assert "of 2 arms" in refusal(two.path)
    wild = Recording(tmp_path / "wild.mcap")
    wild.write("hyperbit/*/state", "state", b"{}", 1, 1)
    wild.close()
    assert "the arm '*', which is no name of an arm" in refusal(wild.path)


def test_topics_that_are_no_keys_are_not_read(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "a.mcap")
    for key in ("state", "*", "a/**", "a//b", "a#b", "$*", "a?b", "", "timeline", "other"):
        recording.write(f"hyperbit/a/{key}", "other", b"{}", 1, 1)
    recording.close()
    assert [told.key for told in RecordingReader(recording.path).messages()] == ["state"]


def test_damage_within_is_told_where_it_is_read(tmp_path: Path) -> None:
    recording = written(tmp_path / "a.mcap", 200)
    recording.close()
    data = bytearray(recording.path.read_bytes())
    middle = data.index(b"zstd") + 40
    data[middle : middle + 20] = bytes(20)
    recording.path.write_bytes(data)
    with pytest.raises(BadRecording, match="damaged"):
        list(RecordingReader(recording.path).messages())
