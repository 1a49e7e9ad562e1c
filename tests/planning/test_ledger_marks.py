"""Marks of published results survive the process, damage of their file, and a folder that cannot be written."""

import os
from pathlib import Path

import pytest

from hyperbit.controller.messages.goals import Result
from hyperbit.controller.planning import ledger as published
from hyperbit.controller.planning.core.events import Identity, ResultEntry
from hyperbit.controller.planning.ledger import PublishedResults, published_path

RESULT = Result("aborted", "a", -4, "of \udc80\nlines", 3)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "arm.published"


def add(results: PublishedResults, *identities: Identity) -> None:
    for identity in identities:
        results.add(identity, RESULT)


def test_the_next_process_knows_what_was_published(path: Path) -> None:
    results, one, two = PublishedResults(path), Identity(2**62, 1), Identity(5, 2)
    assert results.known() == {}
    add(results, one, two)
    assert set(results.known()) == {one, two}
    again = PublishedResults(path)
    assert again.known() == dict.fromkeys([one, two], ResultEntry(0.0, "aborted", -4, "of \\udc80\nlines", 3))
    assert len(list(filter(None, path.read_bytes().splitlines()))) == 2


def test_garbage_and_a_torn_line_are_ignored_and_the_next_mark_is_whole(path: Path) -> None:
    add(PublishedResults(path), Identity(1, 1), Identity(1, 2))
    path.write_bytes(b'\xff\n[]\n{"program": 3}\n[1,"2","",0,"",0]\n' + path.read_bytes()[:-5])
    torn = PublishedResults(path)
    assert set(torn.known()) == {Identity(1, 1)}
    add(torn, Identity(1, 3))
    assert set(PublishedResults(path).known()) == {Identity(1, 1), Identity(1, 3)}


def test_a_folder_that_cannot_be_written_is_logged_once(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    results = PublishedResults(path / "missing" / "arm.published")
    add(results, Identity(1, 1), Identity(1, 2))
    assert set(results.known()) == {Identity(1, 1), Identity(1, 2)}
    assert len(caplog.records) == 1
    (path / "missing").mkdir(parents=True)
    add(results, Identity(1, 3))
    assert set(PublishedResults(path / "missing" / "arm.published").known()) == {Identity(1, 3)}


def test_a_full_memory_loses_no_other_mark(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results, write = PublishedResults(path), os.write
    add(results, Identity(1, 1))
    monkeypatch.setattr(os, "write", lambda file, data: write(file, data[:10]))
    add(results, Identity(1, 2))
    monkeypatch.setattr(os, "write", write)
    add(results, Identity(1, 3))
    assert set(results.known()) == {Identity(1, 1), Identity(1, 2), Identity(1, 3)}
    assert set(PublishedResults(path).known()) == {Identity(1, 1), Identity(1, 3)}


def test_the_newest_results_are_kept(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(published, "MOST_MARKS", 3)
    results = PublishedResults(path)
    add(results, *(Identity(1, k) for k in range(7)))
    assert results.known() == PublishedResults(path).known()
    assert set(results.known()) == {Identity(1, 4), Identity(1, 5), Identity(1, 6)}
    assert list(path.parent.iterdir()) == [path]


def test_the_folder_is_that_of_systemd_or_of_the_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    assert published_path("a", Path("/tmp/x/a.sock")) == Path("/tmp/x/a.published")
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/hyperbit-planner")
    assert published_path("a", Path("/run/hyperbit/a.sock")) == Path("/run/hyperbit-planner/a.published")
