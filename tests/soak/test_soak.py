"""The long runs, short: what must hold for hours holds for seconds."""

import pytest

from controller.config import Arm
from controller.workspace.densities import Densities
from tests.soak.commits import committed
from tests.soak.counting import SwitchCounter
from tests.soak.daemon import soaked


def test_switches_are_counted_when_sync_comes() -> None:
    counter = SwitchCounter([(1, 0), (1, 1), (2, 5)])
    counter.take(0x201, b"\x03")
    counter.take(0x202, b"\x20")
    assert counter.counts.tolist() == [0, 0, 0]
    counter.take(0x080, b"")
    counter.take(0x201, b"\x01")
    counter.take(0x201, b"\x02")
    counter.take(0x080, b"")
    counter.take(0x080, b"")
    assert (counter.counts.tolist(), counter.syncs) == ([2, 1, 1], 3)
    counter.off()
    counter.take(0x201, b"\x03")
    counter.take(0x080, b"")
    assert counter.counts.tolist() == [3, 2, 1]


@pytest.mark.timeout(600)
def test_under_load_no_goal_and_no_switch_is_lost(arm: Arm, densities: Densities) -> None:
    figures = soaked(arm, densities, 10.0, longest=300.0)
    assert figures["results"]["succeeded"] >= 1
    assert figures["results"]["refused"] >= 1
    assert figures["switches_following"] > 0


def test_commits_on_a_simulated_clock() -> None:
    figures = committed(2000)
    assert figures["results"].keys() == {"succeeded", "replaced", "canceled", "aborted"}
    assert figures["acts"]["supply"] >= 1
    assert figures["most_waiting"] <= 5
