"""What ends motion is repeated until the goal has ended. tests/ros2/world judges that it bars what came before it."""

import pytest

from hyperbit.controller.ros2 import goals
from hyperbit.controller.ros2.goal_book import MOST_OWED
from hyperbit.controller.ros2.wire.actions import Status
from tests.ros2.rig import CANCEL, ID, Rig, trajectory_goal

YEAR = 31_536_000  # [s]


@pytest.mark.parametrize("killed", [True, False])
def test_a_cancel_is_owed_though_the_goal_was_told_to_be_lost(rig: Rig, killed: bool) -> None:
    rig.send_goal()
    rig.daemon.away = {"cancel", "result"}
    rig.cancel()
    rig.hear("gone", b"")
    rig.turns(2 * goals.GONE_AFTER)
    assert rig.status is Status.ABORTED
    if killed:
        rig.kill()
        rig.restart()
    rig.daemon.away.clear()
    before = rig.daemon.count(*CANCEL)
    rig.hear("alive", b"")
    rig.turns(3.0)
    assert rig.daemon.count(*CANCEL) > before
    rig.daemon.end("canceled")
    rig.turns(3.0)
    assert not rig.judge.debts
    assert rig.status is Status.ABORTED, "one goal, one result"


def send_within(rig: Rig, sec: int, nanosec: int = 0) -> None:
    """Sends a goal that may end so long after the time of its last point, which is 1 s."""
    within = {"sec": sec, "nanosec": nanosec}
    rig.send_goal(goal=trajectory_goal(["tip_x", "tip_y"], [[0.5, 2.9], [0.4, 2.9]], goal_time_tolerance=within))


@pytest.mark.parametrize("years", [-20, 0, 20])
@pytest.mark.parametrize("killed", [True, False])
def test_a_goal_that_exceeds_its_time_is_canceled(rig: Rig, killed: bool, years: int) -> None:
    """Also if the system's clock is set meanwhile."""
    send_within(rig, 4, 500_000_000)
    rig.clock.epoch += years * YEAR
    if killed:
        rig.kill()
        rig.restart()
    rig.turns(5.0)
    assert rig.daemon.count(*CANCEL) == 0
    rig.turns(3.0)
    assert rig.daemon.count(*CANCEL) > 1
    rig.daemon.end("canceled")
    rig.turns(3.0)
    assert rig.result()[:2] == (Status.ABORTED, goals.TOO_LATE)
    assert "goal_time_tolerance" in rig.result()[2]


def test_a_client_may_cancel_a_goal_that_exceeds_its_time(rig: Rig) -> None:
    send_within(rig, 1)
    rig.turns(4.0)
    assert rig.cancel()
    rig.daemon.end("canceled")
    rig.turns(3.0)
    assert rig.status is Status.CANCELED


@pytest.mark.parametrize("sec", [0, -1])
def test_a_goal_without_a_time_tolerance_may_take_any_time(rig: Rig, sec: int) -> None:
    send_within(rig, sec)
    rig.turns(60.0)
    assert rig.daemon.count(*CANCEL) == 0


def test_a_bridge_that_ends_leaves_accepted_cancels_to_the_next(rig: Rig) -> None:
    rig.send_goal()
    rig.cancel()
    rig.restart()
    assert rig.status is Status.ABORTED
    assert rig.daemon.count(*CANCEL) == 1, "it is sent before the end"
    rig.turns(3.0)
    assert rig.daemon.count(*CANCEL) > 1


def test_a_goal_that_is_rejected_without_an_answer_is_canceled(rig: Rig) -> None:
    """The daemon may have it, or receive it later."""
    rig.daemon.away = {"goal"}
    assert not rig.send_goal()
    rig.daemon.away.clear()
    assert not rig.send_goal(), "the id is that of the goal that is to be canceled"
    rig.kill()
    rig.restart()
    rig.turns(goals.KNOWN_WITHIN - 1)
    assert rig.daemon.count(*CANCEL) > 10
    rig.turns(4.0)
    assert not rig.judge.debts
    assert rig.send_goal()


def test_no_goal_begins_while_too_many_cancels_are_owed(rig: Rig) -> None:
    rig.daemon.away = {"goal", "cancel", "result"}
    for _ in range(MOST_OWED + 10):
        rig.send_pose()
        rig.threads.run()
    assert len([key for key, _ in rig.daemon.asked if key == "goal"]) == MOST_OWED
    rig.daemon.away.clear()
    assert not rig.send_goal()


def test_an_ended_goal_does_not_run_again_after_a_restart(rig: Rig) -> None:
    rig.send_goal()
    rig.tell_end("succeeded")
    before = rig.result()
    rig.kill()
    rig.restart()  # the judge sees each status
    assert rig.result() == before
    assert rig.status is Status.SUCCEEDED
    assert rig.daemon.asked == [("goal", ID)]
