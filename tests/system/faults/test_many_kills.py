"""Planner and executor are killed in turn, at random times and at the SYNC: counts and results are exact."""

import random
import signal
import time

import pytest

from hyperbit.controller.planning.ledger_file import read
from hyperbit.drivers.canopen.wire import cia301
from tests import emulated
from tests.system.stack.arms import QUICK
from tests.system.stack.lives import Lives
from tests.system.stack.places import MIDDLE
from tests.system.stack.system import System
from tests.waiting import SLOWNESS

pytestmark = [pytest.mark.fresh, pytest.mark.arm(boards=QUICK)]

KILLS = 12 if SLOWNESS == 1 else 5  # each takes 3 s


def test_counts_and_results_are_exact_after_many_kills_and_nothing_moves_by_itself(
    lives: Lives, system: System
) -> None:
    """Takes 40 s, see KILLS."""
    client, boards, chance = lives.client, system.boards, random.Random(1)
    goals: list[str] = []
    for k in range(KILLS):
        lives.ready()
        lives.motions.agree(boards)
        before = boards.switches().tolist()
        state = lives.ready()
        assert boards.switches().tolist() == before, "nothing moved by itself"
        assert state["commanded"] == state["measured"] == boards.positions().astype(int).tolist()
        goals.append(lives.zigzag(f"zigzag {k}"))
        victim = ("planner", "executor")[k % 2]
        if k % 4 == 1 and isinstance(system.interface, emulated.Interface):
            at_the_sync(system, chance.randrange(1, 5))
            system.start_executor()
        else:
            lives.begun()
            time.sleep(chance.uniform(0.0, 0.3))  # the time of the kill is random on purpose
            lives.kill(victim)
        assert client.result(goals[-1])["status"] == "aborted"
    lives.move("last", MIDDLE)
    lives.check()
    assert lives.motions.switched.sum() > 5 * KILLS
    system.planner.end(signal.SIGTERM)
    assert system.counts() == boards.switches().tolist(), "by the ledger"
    ends = {(goal["id"], goal["status"]) for goal in read(system.ledger)[1]}  # a killed planner may not have written
    assert ends <= {(goal, client.results(goal)[0]["status"]) for goal in client.accepted}


def at_the_sync(system: System, count: int) -> None:
    """Kills the executor at one of its next SYNCs, which reaches the boards before the executor can know."""
    left = [count]

    def on_sent(cob_id: int, data: bytes) -> None:
        left[0] -= cob_id == cia301.SYNC
        if left[0] == 0:
            system.executor.send(signal.SIGKILL)

    system.interface.on_sent = on_sent
    system.executor.gone()
    system.interface.on_sent = lambda cob_id, data: None
