"""Planner, executor or both are killed at each moment of a goal's life, at random times, and at a SYNC.

Here each moment has one kill. `python -m tests.system.kills` kills many times at each moment.
"""

import itertools
import random
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hyperbit.controller.planning.ledger_file import read
from hyperbit.drivers.canopen.wire import cia301
from tests import emulated
from tests.system.kills.campaign import Campaign, kill_nursery
from tests.system.kills.moments import MOMENTS, PROCESSES
from tests.system.stack import arms
from tests.system.stack.lives import Lives
from tests.system.stack.places import MIDDLE
from tests.system.stack.system import System
from tests.waiting import SLOWNESS

pytestmark = pytest.mark.fresh

KILLS = 6 if SLOWNESS == 1 else 5  # each takes 3 s


@pytest.fixture
def campaign(kind: str, tmp_path: Path) -> Iterator[Campaign]:
    planners = kill_nursery(tmp_path)
    campaign = Campaign(lambda: System(kind, "planar", {"boards": arms.QUICK}, planners))
    yield campaign
    campaign.close()
    planners.close()


@pytest.mark.buses("virtual")
def test_each_accepted_goal_has_one_result_whichever_process_is_killed_at_whatever_moment(campaign: Campaign) -> None:
    """Takes about 40 s: 12 kills, after each of which processes start and boards boot."""
    for moment, victim in zip(MOMENTS, itertools.cycle(PROCESSES), strict=False):
        campaign.kill(moment, victim, 0)
    campaign.close()
    for (moment, victim), tally in campaign.tallies.items():
        assert not tally.wrong, (moment, victim, tally.wrong)
        assert tally.kills == 1


@pytest.mark.arm(boards=arms.QUICK)
def test_counts_and_results_are_exact_after_many_kills_and_nothing_moves_by_itself(
    lives: Lives, system: System
) -> None:
    """Takes 20 s, see KILLS."""
    client, boards, chance = lives.client, system.boards, random.Random(1)
    for k in range(KILLS):
        lives.ready()
        lives.rests()
        goal = lives.zigzag(f"zigzag {k}")
        if k % 4 == 1 and isinstance(system.interface, emulated.Interface):
            at_the_sync(system, chance.randrange(1, 5))
            system.start_executor()
        else:
            lives.begun()
            time.sleep(chance.uniform(0.0, 0.3))  # the time of the kill is random on purpose
            lives.kill(("planner", "executor")[k % 2])
        assert client.result(goal)["status"] == "aborted"
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
