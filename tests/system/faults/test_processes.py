"""Planner or executor is killed or stopped in every phase: nothing moves unasked, each goal has one result."""

import signal
import time
from contextlib import ExitStack

import pytest

from hyperbit.controller.commands.use.halt import halt_local
from hyperbit.controller.network import session
from tests.system.stack.arms import QUICK
from tests.system.stack.lives import Lives
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT
from tests.system.stack.system import System
from tests.waiting import eventually

pytestmark = [pytest.mark.fresh, pytest.mark.arm(boards=QUICK)]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("victim", ["planner", "executor"])
def test_in_motion_following_in_a_fault_and_while_booting(lives: Lives, victim: str, number: signal.Signals) -> None:
    """Takes 15 to 30 s: four losses, each of which the other process must detect, and a lost board."""
    client, boards, system = lives.client, lives.system.boards, lives.system

    # In motion: the goal ends once, and does not move the arm afterwards.
    goal = lives.zigzag("in motion")
    lives.begun()
    lives.disturb(victim, number)
    assert client.result(goal)["status"] == "aborted"
    lives.ready()
    lives.rests()
    lives.move("after motion", MIDDLE)

    # Following: a stream has no result, and the arm rests when it has ended.
    told = len(client.first_results())
    with lives.publisher().streaming():
        client.wait_now("executing", "following")
        lives.disturb(victim, number)
    eventually(lambda: not client.diagnosed()["setpoint"]["alive"])  # a stopped planner has caught up
    lives.ready()
    lives.rests()
    assert len(client.first_results()) == told
    lives.move("after following", LEFT)

    # In a fault: the fault remains, and clears as usual.
    silenced = time.time()
    boards.fault("silence", "can0/5")
    client.wait_fault("board-lost", silenced)
    lives.disturb(victim, number)
    client.wait_now("fault", "can0/5")
    boards.fault("unsilence", "can0/5")
    lives.ready()
    lives.move("after the fault", MIDDLE)

    # While booting.
    system.executor.kill()
    system.start_executor()
    lives.disturb(victim, number)
    lives.ready()
    lives.move("after the boot", LEFT)
    lives.check()


def test_boards_hold_when_the_executor_is_killed_in_the_middle_of_a_goal(lives: Lives, system: System) -> None:
    client = lives.client
    goal = lives.send("a", MIDDLE, RIGHT, LEFT, times=[0.0, 0.5, HOUR])
    eventually(lambda: client.feedback(goal))
    system.executor.kill()
    lives.motions.agree(system.boards)
    held = system.boards.switches().tolist()
    assert client.result(goal)["status"] == "aborted"
    eventually(lives.masterless)
    lives.motions.agree(system.boards)
    assert system.boards.switches().tolist() == held
    refused = client.goal(LEFT, id="b")
    assert (refused["accepted"], refused["id"]) == (False, "b")
    assert client.state["mode"] != "ready"


@pytest.mark.parametrize("lease", [session.LEASE, None], ids=["for longer than its lease", "and is asked to stop"])
def test_a_stopped_planner_has_its_goal_ended_and_tells_so_when_it_goes_on(
    system: System, stack: ExitStack, lease: float | None
) -> None:
    lives = Lives(system, stack, lease) if lease else Lives(system, stack)
    client = lives.client
    goal = lives.send("passed", MIDDLE, RIGHT, times=[0.0, HOUR])
    lives.begun()
    system.planner.freeze()
    with lives.operator() as operator:  # the executor may wait for the planner for longer than the lease
        eventually(lambda: operator.snapshot().mode == "ready")
    lives.motions.agree(system.boards)
    before = system.boards.switches().tolist()
    if lease:
        eventually(lambda: not client.client.alive())
    else:
        lives.session.put(f"hyperbit/{system.name}/stop", b"")
    system.planner.thaw()
    assert client.result(goal)["status"] == "aborted"
    if not lease:
        client.wait_now("stopped")
        assert system.boards.switches().tolist() == before
        client.reset()
    lives.move("after", LEFT)
    lives.check()


def test_a_local_halt_works_while_the_planner_is_stopped(lives: Lives, system: System) -> None:
    client = lives.client
    goal = lives.send("a", MIDDLE, RIGHT, times=[0.0, HOUR])
    eventually(lambda: client.feedback(goal))
    system.planner.freeze()
    assert "stopped" in halt_local(system.name, system.socket)[0].message
    with lives.operator() as operator:
        assert operator.wait_for("stopped").program == -1
    system.planner.thaw()
    assert client.result(goal)["status"] == "aborted"
    refused = client.goal(LEFT, id="b")
    assert (refused["accepted"], "stopped" in refused["message"]) == (False, True)
    client.reset()
    lives.move("after", LEFT)
    lives.check()
