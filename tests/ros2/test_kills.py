"""Kills while goals of an action client run; `python -m tests.ros2.kills` makes more of them."""

from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.ros2.kills import run
from tests.ros2.rig import Rig

pytestmark = pytest.mark.timeout(900)


def test_each_accepted_goal_has_one_result(tmp_path: Path) -> None:
    with ExitStack() as closing:
        rig = Rig(tmp_path, closing, travel_time=0.5)
        for victim in ("router", "bridge", "daemon"):
            ends = run(rig, victim, 1)
            kept = victim in ("router", "bridge")  # the motion goes on; others end it, unless it has just ended
            assert set(ends) <= {"rejected", "succeeded", *([] if kept else ["aborted", "lost"])}, f"{victim}: {ends}"
