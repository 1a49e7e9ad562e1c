"""Files of unknown content: bounded reading, and damaged files that are set aside."""

import itertools
import os
import socket
import time
from pathlib import Path

import pytest

from hyperbit.controller.host.files import MOST_ASIDE, is_at, open_file, read_file, set_aside


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.json"


def test_a_file_is_read_up_to_its_limit(path: Path) -> None:
    path.write_bytes(b"x" * 20)
    assert read_file(path, 20) == b"x" * 20
    with pytest.raises(OSError, match=r"more than 1\.9e-05 MB, the most for such a file; is it the right file"):
        read_file(path, 19)
    with open_file(path, None) as file:
        assert file.read() == b"x" * 20


def test_a_file_that_tells_no_size_is_read_up_to_its_limit() -> None:
    assert read_file(Path("/proc/self/cmdline"))
    with pytest.raises(OSError, match="more than"):
        read_file(Path("/proc/self/cmdline"), 1)


@pytest.mark.parametrize("kind", ["directory", "pipe", "socket", "device"])
def test_what_is_no_file_is_named(path: Path, kind: str) -> None:
    match kind:
        case "directory":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case "socket":
            socket.socket(socket.AF_UNIX).bind(str(path))
        case "device":
            path.symlink_to("/dev/zero")
    with pytest.raises(OSError, match=f"it is a {kind}, no file"):
        read_file(path)


def test_a_damaged_file_is_renamed_and_told(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path.write_text("damaged")
    path.with_name("a.json-wal").write_text("its log")
    told = set_aside(path, "no JSON", "a new one begins", "-wal")
    (aside,) = path.parent.glob("a.json.damaged-*[0-9]")
    assert told == f"{path} was damaged (no JSON), and renamed to {aside.name}; a new one begins"
    assert caplog.messages == [told]
    assert (aside.read_text(), aside.with_name(f"{aside.name}-wal").read_text()) == ("damaged", "its log")


def test_no_damaged_file_is_overwritten_and_the_oldest_are_deleted(tmp_path: Path) -> None:
    for k in range(2 * MOST_ASIDE):
        path = tmp_path / f"a-{k}.mcap"
        for part in (path, tmp_path / f"a-{k}.mcap-wal"):
            part.write_text(str(k))
        assert set_aside(path, "no MCAP", "it is not replayed", "-wal", kind="a-[0-9]*.mcap")
    left = {aside.read_text() for aside in tmp_path.iterdir()}
    assert left == {str(k) for k in range(MOST_ASIDE, 2 * MOST_ASIDE)}
    for _ in range(2):
        (path := tmp_path / "b.json").write_text("b")
        set_aside(path, "no JSON", "a new one begins")
    assert len(list(tmp_path.glob("b.json.damaged-*"))) == 2


def test_the_newest_damaged_files_stay_though_the_clock_is_set_back(path: Path, monkeypatch) -> None:
    monkeypatch.setattr(time, "time_ns", itertools.count(10**18, -(10**15)).__next__)
    for k in range(2 * MOST_ASIDE):
        path.write_text(str(k))
        set_aside(path, "no JSON", "a new one begins")
    left = {aside.read_text() for aside in path.parent.iterdir()}
    assert left == {str(k) for k in range(MOST_ASIDE, 2 * MOST_ASIDE)}


def test_a_file_that_cannot_be_renamed_stays(path: Path, caplog: pytest.LogCaptureFixture, monkeypatch) -> None:
    path.write_text("damaged")

    def refuse(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(os, "rename", refuse)
    assert set_aside(path, "no JSON", "a new one begins") is None
    assert path.read_text() == "damaged"
    assert caplog.messages == [f"{path} is damaged (no JSON), and cannot be renamed: Read-only file system"]


def test_a_file_that_was_deleted_moved_or_replaced_is_noticed(path: Path) -> None:
    with path.open("w") as file:
        assert is_at(path, file.fileno())
        path.rename(path.with_name("b.json"))
        assert not is_at(path, file.fileno())
        path.write_text("another one")
        assert not is_at(path, file.fileno())
        path.unlink()
        assert not is_at(path, file.fileno())
