"""Goals that come while a bridge begins or ends, a daemon that goes, and the file of the goals."""

import json
from pathlib import Path

import msgspec
import pytest

from hyperbit.controller.messages.goals import GoalEnd
from hyperbit.controller.ros2 import goal_book, goals
from hyperbit.controller.ros2.goal_book import BookedGoal, GoalBook
from hyperbit.controller.ros2.goals import LOST
from hyperbit.controller.ros2.messages import STALE
from hyperbit.controller.ros2.wire.actions import Status
from tests import told
from tests.clock import Clock
from tests.ros2.rig import ID, UUID, Rig

END = {"id": ID, "status": "succeeded", "code": 0, "message": "reached"}
FIRST = BookedGoal("00" * 16, "tip", ("tip_x", "tip_y"), 1_700_000_000_000_000_000)
SECOND = BookedGoal("11" * 16, "actuators", ("5.left",), 1_700_000_001_000_000_000)
NO_ID = msgspec.json.encode([msgspec.structs.replace(FIRST, uuid="none")])
ENDED = msgspec.structs.replace(FIRST, result=GoalEnd("succeeded"), ended=100.0)


def test_a_goal_that_is_accepted_while_the_bridge_ends_has_one_result(rig: Rig) -> None:
    rig.send_goal(run=False)
    rig.threads.take()
    rig.restart()
    assert [it.id for it in rig.judge.goals.values()] == [ID]
    assert rig.result()[:2] == (Status.ABORTED, LOST)


def test_a_goal_that_its_client_sends_again_while_the_bridge_begins_is_accepted(rig: Rig) -> None:
    """The bridge before this one was killed before it answered; the daemon knows the goal."""
    rig.killed_in(rig.send_goal)

    class Book(GoalBook):
        def goals(self) -> list[BookedGoal]:
            rig.send_goal(run=False)
            return super().goals()

    rig.book_kind = Book
    rig.restart()
    rig.threads.run()
    assert [it.active for it in rig.judge.goals.values()] == [True]
    rig.hear("result", END)
    assert rig.result()[0] is Status.SUCCEEDED


def test_a_goal_of_a_daemon_that_dies_before_its_first_state_is_lost(rig: Rig) -> None:
    rig.killed_in(rig.send_goal)
    rig.restart()
    results = rig.get_result()
    rig.hear("gone", b"")
    rig.clock.sleep(2 * goals.GONE_AFTER)
    assert results == []
    rig.hear("gone", b"")
    assert [(it.status, it.result.error_code) for it in results] == [(Status.ABORTED, LOST)]


def test_clocks_that_jump_end_no_goal_and_forget_no_result(rig: Rig) -> None:
    rig.send_goal()
    results = rig.get_result()
    for jump in (-(10.0**6), 10.0**6):
        rig.clock.epoch += jump
        rig.hear("state", told.state())
        assert results == []
    rig.hear("result", END)
    rig.clock.epoch -= 10.0**6
    assert rig.get_result() == results
    assert [it.status for it in results] == [Status.SUCCEEDED]


def test_the_diagnostics_of_a_daemon_that_is_gone_are_stale(rig: Rig) -> None:
    rig.hear("state", told.state())
    for key, level, words in (
        ("gone", STALE, "the daemon is gone; its last words were ready: holding"),
        ("alive", 0, "ready: holding"),
    ):
        rig.hear(key, b"")
        rig.clock.sleep(10.0)
        rig.hear("state", told.state())
        health = rig.network.latest["diagnostics"].status[0]
        assert (health.level, health.message) == (level, words)


def test_a_book_survives_the_process(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "a.ros2.json"
    book = GoalBook(path)
    book.put(FIRST)
    book.put(SECOND)
    assert GoalBook(path).goals() == [FIRST, SECOND]
    book.remove(FIRST)
    assert GoalBook(path).goals() == [SECOND]
    assert FIRST.id == "ros2-" + "00" * 16


def test_a_result_is_kept_for_a_while(tmp_path: Path) -> None:
    clock = Clock(100.0)
    book = GoalBook(tmp_path / "a.json", clock)
    book.put(FIRST)
    book.put(ENDED)
    assert book.goals() == [ENDED]
    clock.now += goal_book.KEPT + 1
    book.put(SECOND)
    assert book.goals() == [SECOND]


def test_times_of_an_earlier_start_of_the_computer_begin_anew(tmp_path: Path) -> None:
    book = GoalBook(tmp_path / "a.json", Clock(100.0))
    book.put(ENDED)
    book.put(msgspec.structs.replace(SECOND, since=100.0, within=5.0))
    found = GoalBook(tmp_path / "a.json", Clock(30.0)).goals()
    assert [(it.since, it.ended) for it in found] == [(0.0, 30.0), (30.0, 0.0)]


def test_a_book_is_bounded_and_keeps_running_goals(tmp_path: Path) -> None:
    book = GoalBook(tmp_path / "a.json")
    running = msgspec.structs.replace(FIRST, uuid=UUID.hex())
    book.put(running)
    for k in range(2 * goal_book.MOST_GOALS):
        book.put(BookedGoal(f"{k:032x}", "tip", (), 1, GoalEnd("succeeded"), ended=4e9))
    assert len(book.goals()) == goal_book.MOST_GOALS
    assert book.goals()[0] == running


WRONG = [
    {"stamp": -1},
    {"stamp": 2**63},
    {"result": {"status": 5}},
    {"result": {"status": "x", "code": 2**31}},
]
DAMAGED = [json.dumps([{"uuid": "00" * 16, "kind": "tip", "joints": [], "stamp": 1, **it}]).encode() for it in WRONG]


@pytest.mark.parametrize("content", [b"", b"{", b'[{"uuid": 5}]', b"\xff", NO_ID, *DAMAGED])
def test_a_damaged_book_forgets_the_goals_and_is_replaced(tmp_path: Path, content: bytes) -> None:
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
