"""Recordings: what is flushed survives, whatever cuts the file; repair keeps all whole records."""

import json
import random
import time
from pathlib import Path

import pytest
from mcap.writer import Writer

from hyperbit.controller.host.files import MOST_ASIDE
from hyperbit.controller.recorder.recording import LogClock, Recording
from hyperbit.controller.recorder.repair import repair, unfinished
from tests.recorder.samples import (
    SECOND,
    TOPIC,
    names,
    numbers,
    read,
    read_by_another,
    read_unfinished,
    recovered_by_another,
    written,
)


def test_two_readers_read_a_complete_file(tmp_path: Path) -> None:
    recording = written(tmp_path / "a.mcap")
    recording.close()
    assert not unfinished(recording.path)
    assert read(recording.path) == read_by_another(recording.path)
    assert numbers(read(recording.path)) == list(range(100))
    assert {"Metadata", "Attachment", "Schema", "Channel", "Message"} <= set(names(recording.path))


def test_at_most_a_second_of_messages_is_not_flushed(tmp_path: Path) -> None:
    recording, path = Recording(tmp_path / "a.mcap"), tmp_path / "a.mcap"
    draw, times = random.Random(1), [1000.0]
    for k in range(150):
        times.append(times[-1] + draw.choice([0.0, 0.01, 0.3, 0.99, 1.0, 2.5]))
        recording.write(TOPIC, "state", json.dumps({"k": k}).encode(), round(times[-1] * SECOND), 1)
        there = numbers(read_unfinished(path.read_bytes()))
        assert there == list(range(len(there)))
        lost = times[1 + len(there) :]
        assert not lost or times[-1] - lost[0] < 1.0 + 1e-6
    recording.close()


def test_messages_after_a_pause_are_flushed_by_the_clock(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "a.mcap")
    recording.write(TOPIC, "state", b'{"k": 0}', 1000 * SECOND, 1)
    assert not recording.due(1000 * SECOND + 1)
    assert recording.due(1001 * SECOND)
    recording.flush()
    assert not recording.due(1005 * SECOND)
    assert numbers(read_unfinished(recording.path.read_bytes())) == [0]


@pytest.mark.parametrize("seed", range(4))
def test_a_file_cut_anywhere_is_repaired_with_all_that_two_readers_find(tmp_path: Path, seed: int) -> None:
    recording = written(tmp_path / "a.mcap", 200)
    recording.close()
    whole, draw = recording.path.read_bytes(), random.Random(seed)
    cuts = [0, 1, 7, 8, 9, 20, len(whole) - 1, len(whole) - 8, *(draw.randrange(len(whole)) for _ in range(40))]
    for cut in cuts:
        path = tmp_path / "cut.mcap"
        path.write_bytes(whole[:cut])
        assert unfinished(path)
        expected = read_unfinished(whole[:cut])
        assert expected == recovered_by_another(whole[:cut])
        found = repair(path)
        assert (found.messages, found.damage) == (len(expected), "")
        assert path.exists() is bool(found.records)
        if not found.records:
            continue
        assert read(path) == expected == read_by_another(path)
        assert not unfinished(path)


def test_a_damaged_file_keeps_all_other_chunks_and_is_set_aside(tmp_path: Path) -> None:
    recording = written(tmp_path / "a.mcap", 200)
    recording.close()
    whole, draw = recording.path.read_bytes(), random.Random(7)
    for _ in range(60):
        data, path = bytearray(whole[:-9]), tmp_path / "damaged.mcap"
        for _ in range(draw.randrange(1, 5)):
            data[draw.randrange(8, len(data))] = draw.randrange(256)
        path.write_bytes(data)
        found = repair(path)  # raises nothing
        if path.exists():
            assert len(read(path)) == found.messages
        asides = sorted(tmp_path.glob("damaged.mcap.damaged-*"))
        assert not found.damage or bytes(data) in [aside.read_bytes() for aside in asides]
    assert 1 <= len(asides) <= MOST_ASIDE


def test_one_damaged_chunk_costs_its_own_messages_only(tmp_path: Path) -> None:
    recording = written(tmp_path / "a.mcap", 200)
    recording.flush()
    recording.abandon()
    data = bytearray(recording.path.read_bytes())
    at = data.index(b"zstd", len(data) // 2)
    data[at + 30 : at + 40] = bytes(10)
    recording.path.write_bytes(data)
    found = repair(recording.path)
    assert found.damage
    there = numbers(read(recording.path))
    assert (there[0], there[-1]) == (0, 199)
    assert 150 < len(there) < 200


def test_metadata_and_attachments_survive(tmp_path: Path) -> None:
    recording = written(tmp_path / "a.mcap")
    recording.flush()
    recording.abandon()
    assert repair(recording.path).messages == 100
    kinds = names(recording.path)
    assert kinds.count("Metadata") == kinds.count("Attachment") == 1
    assert repair(recording.path).messages == 100, "a repaired file stays as it is"


def test_a_file_that_nobody_can_write_is_told_as_such(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")
    with pytest.raises(FileExistsError):
        Recording(tmp_path / "a.mcap")
    with pytest.raises(FileNotFoundError):
        Recording(tmp_path / "none" / "a.mcap")


def test_log_times_are_unix_times_that_no_step_of_the_clock_reorders() -> None:
    wall = [5_000 * 10**9]
    clock = LogClock(lambda: wall[0])
    begun = clock.at(time.monotonic_ns())
    assert 0 <= begun - wall[0] < 60 * 10**9
    for to in (0, 10**18):
        wall[0] = to
        assert begun <= clock.at(time.monotonic_ns()) < begun + 60 * 10**9
        assert clock.step() == pytest.approx((to - begun) / 1e9, abs=60.0)
    now = time.monotonic_ns()
    assert clock.at(now + 5) - clock.at(now + 3) == 2


def test_messages_of_a_channel_without_a_schema_survive(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("a", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    path.write_bytes(path.read_bytes()[:-8])
    assert repair(path).messages == 1
    assert read(path) == read_by_another(path)
