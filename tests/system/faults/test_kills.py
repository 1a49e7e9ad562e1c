"""Planner, executor or both are killed at each moment of a goal's life: each accepted goal has one result.

Here each moment has one kill. `python -m tests.system.kills` kills many times at each moment.
"""

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.kills.campaign import Campaign, KillNursery
from tests.system.kills.moments import MOMENTS, PROCESSES
from tests.system.stack import arms
from tests.system.stack.processes import Nursery
from tests.system.stack.system import System

pytestmark = [pytest.mark.fresh, pytest.mark.buses("virtual")]


@pytest.fixture
def campaign(kind: str, nurseries: dict[str, Nursery], cache: Path, tmp_path: Path) -> Iterator[Campaign]:
    bus = {"interface": "virtual", "channel": "none"}
    file = arms.write(tmp_path, "planar", "none", bus, {})
    planners = KillNursery("planner", {"XDG_CACHE_HOME": str(cache.parent)}, file)
    own = {"executor": nurseries["executor"], "planner": planners}
    campaign = Campaign(lambda: System(kind, "planar", {"boards": arms.QUICK}, own, cache))
    yield campaign
    campaign.close()
    planners.close()


def test_each_accepted_goal_has_one_result_whichever_process_is_killed_at_whatever_moment(campaign: Campaign) -> None:
    """Takes about 40 s: 12 kills, after each of which processes start and boards boot."""
    for moment, victim in zip(MOMENTS, itertools.cycle(PROCESSES), strict=False):
        campaign.kill(moment, victim, 0)
    campaign.finish()
    for (moment, victim), tally in campaign.tallies.items():
        assert not tally.wrong, (moment, victim, tally.wrong)
        assert tally.kills == 1
