"""plan ARM GOAL without a daemon: times, what each leg needs, and obstacles by name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import hyperbit as hb
from tests.commands.conftest import ARM

NOWHERE = "tcp/127.0.0.1:1"

pytestmark = pytest.mark.usefixtures("own_folders")


@pytest.fixture
def arm(tmp_path) -> Path:
    (tmp_path / "arm.yaml").write_text(ARM.read_text() + "inrush: 2\n")
    return tmp_path / "arm.yaml"


@pytest.fixture
def plan(hyperbit, arm, tmp_path):
    """Plans waypoints, and returns the exit code, the plan as JSON, and what is told."""

    def run(waypoints: list[dict[str, object]], *words: str):
        (tmp_path / "goal.json").write_text(json.dumps({"waypoints": waypoints}))
        code, out, err = hyperbit("plan", str(arm), str(tmp_path / "goal.json"), "--json", *words)
        return code, json.loads(out), err

    return run


def test_with_the_times_that_the_legs_need_the_plan_is_accepted(plan, arm):
    tips = hb.load(arm).frames(hb.load(arm).sample(6, seed=3))[:, :2, 3].tolist()
    _, slow, _ = plan([{"position": tip} for tip in tips], "--connect", NOWHERE, "--deadline", "10")
    needed = [point["needed"] for point in slow["waypoints"]]
    assert min(needed[1:]) > 0
    times = np.cumsum([0.0, *needed[1:]])
    fixed = [{"configuration": point["configuration"]} for point in slow["waypoints"]]
    timed = [{**point, "t": float(t) + 1e-9 * k} for k, (point, t) in enumerate(zip(fixed, times, strict=True))]
    code, fast, told = plan(timed, "--previous", "0" * 16)
    assert code == 0, told
    assert fast["switches"] == slow["switches"]
    half = [{**point, "t": 0.5 * point["t"]} for point in timed]
    code, refused, _ = plan(half, "--previous", "0" * 16)
    assert (code, refused["accepted"], refused["reason"]) == (1, False, "time-too-short")


def test_what_is_in_the_way_is_named(plan, arm):
    arm.write_text(arm.read_text() + "obstacles:\n- {disc: {centre: [0.55, 2.9], radius: 0.3}, name: crate}\n")
    code, refused, told = plan([{"position": [0.4, 2.2]}, {"position": [0.55, 2.9]}], "--connect", NOWHERE)
    assert (code, refused["reason"]) == (1, "goal-in-obstacle")
    assert "waypoint 2, position: (0.55, 2.9) is in disc 'crate'\nNext: move the goal or the obstacle" in told
