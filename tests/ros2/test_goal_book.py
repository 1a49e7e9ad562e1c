"""The file of the goals that action clients wait for."""

from pathlib import Path

import msgspec
import pytest

from hyperbit.controller.ros2 import goal_book
from hyperbit.controller.ros2.answers import GoalResult
from hyperbit.controller.ros2.goal_book import BookedGoal, GoalBook

FIRST = BookedGoal("00" * 16, "tip", ("tip_x", "tip_y"), 1_700_000_000_000_000_000)
SECOND = BookedGoal("11" * 16, "actuators", ("5.left",), 1_700_000_001_000_000_000)
NO_ID = msgspec.json.encode([msgspec.structs.replace(FIRST, uuid="none")])
ENDED = msgspec.structs.replace(FIRST, result=GoalResult("succeeded"), ended=100.0)


def test_goals_survive_the_process(tmp_path: Path) -> None:
    book = GoalBook(tmp_path / "deep" / "a.ros2.json")
    book.put(FIRST)
    book.put(SECOND)
    assert GoalBook(tmp_path / "deep" / "a.ros2.json").goals() == [FIRST, SECOND]
    book.remove(FIRST)
    assert GoalBook(tmp_path / "deep" / "a.ros2.json").goals() == [SECOND]
    assert FIRST.id == "ros2-" + "00" * 16


def test_a_result_is_kept_for_a_while(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(goal_book.time, "monotonic", lambda: now[0])
    book = GoalBook(tmp_path / "a.json")
    book.put(FIRST)
    book.put(ENDED)
    assert book.goals() == [ENDED]
    now[0] += goal_book.KEPT + 1
    book.put(SECOND)
    assert book.goals() == [SECOND]


def test_times_of_an_earlier_start_of_the_computer_begin_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(goal_book.time, "monotonic", lambda: 100.0)
    limited = msgspec.structs.replace(SECOND, since=100.0, within=5.0)
    book = GoalBook(tmp_path / "a.json")
    book.put(ENDED)
    book.put(limited)
    monkeypatch.setattr(goal_book.time, "monotonic", lambda: 30.0)
    assert [(it.since, it.ended) for it in GoalBook(tmp_path / "a.json").goals()] == [(0.0, 30.0), (30.0, 0.0)]


@pytest.mark.parametrize("content", [b"", b"{", b'[{"uuid": 5}]', b"\xff", NO_ID])
def test_a_damaged_file_forgets_the_goals_and_is_replaced(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(content)
    book = GoalBook(path)
    assert book.goals() == []
    book.put(FIRST)
    assert GoalBook(path).goals() == [FIRST]
    [aside] = tmp_path.glob("a.json.damaged-*")
    assert aside.read_bytes() == content


def test_a_folder_that_cannot_be_written_harms_no_goal(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    book = GoalBook(tmp_path / "gone" / "a.json")
    (tmp_path / "gone").rmdir()
    (tmp_path / "gone").touch()
    book.put(FIRST)
    assert book.goals() == [FIRST]
    assert "a restart would forget the goals" in caplog.text
