"""Goals through the planner and the executor's core, on boards in memory, in real time."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.workspace.mapping import map_densities
from tests.planning.conftest import DOCUMENT
from tests.planning.rig.core_executor import CoreExecutor
from tests.planning.rig.executor import Inbox
from tests.planning.rig.process import RunningPlanner
from tests.waiting import PATIENCE, eventually


class Chain:
    def __init__(self, arm: Arm, folder: Path) -> None:
        self.arm, self.folder, self.path, self.inbox = arm, folder, folder / "small.sock", Inbox()
        self.densities = map_densities(arm.reduced, arm.pixel, arm.level_pixels)
        self.executor = CoreExecutor(self.path)
        self.planner = self.plan_anew()

    def plan_anew(self) -> RunningPlanner:
        planner = RunningPlanner(self.arm, self.densities, self.path, self.folder, self.inbox)
        eventually(lambda: planner.state.get("mode") == "ready")
        return planner

    def close(self) -> None:
        self.planner.close()
        self.executor.close()

    def goal(self, *configurations: tuple[int, int], step: float = 0.1, name: str = "a", **fields: Any) -> None:
        tips = [self.arm.manipulator.tip(np.array(c))[:2, 3].tolist() for c in configurations]
        waypoints = [{"t": step * k, "position": p} for k, p in enumerate(tips)]
        self.planner.ask("goal", {"id": name, "waypoints": waypoints, **fields})

    def error(self, configuration: tuple[int, int]) -> float:
        tip = self.planner.state["tip"]
        wanted = self.arm.manipulator.tip(np.array(configuration))[:2, 3]
        return float("inf") if tip is None else float(np.linalg.norm(wanted - tip["position"]))


@pytest.fixture(params=[{}, {"inrush": 1}], ids=["at once", "one by one"])
def chain(read: Callable[[Any], Arm], tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Chain]:
    modules = [{**DOCUMENT["modules"][0], "count": 2}]
    chain = Chain(read({**DOCUMENT, "modules": modules, **request.param}), tmp_path)
    yield chain
    chain.close()


A, B, C = (1, 2), (3, 4), (7, 0)


def test_goals_one_after_the_other(chain: Chain) -> None:
    done = 0
    for k, goal in enumerate((A, B, C, (0, 0))):
        chain.goal(goal, name=f"g{k}")
        assert chain.inbox.next("reply")["accepted"]
        assert chain.inbox.next("feedback")["waypoint"] == 0
        result = chain.inbox.next("result")
        assert (result["id"], result["status"]) == (f"g{k}", "succeeded"), result
        assert result["error"] <= 0.002
        assert chain.planner.ledger.known == tuple(chain.executor.journal.counts), "no diagnostics are needed"
        done += result["switches"]
    assert sum(chain.executor.journal.counts) == done
    eventually(lambda: chain.planner.diagnostics["counts"] == tuple(chain.executor.journal.counts))


def test_a_trajectory_is_fed_back_waypoint_by_waypoint(chain: Chain) -> None:
    chain.goal(A, B, C, A, step=0.5)
    assert chain.inbox.next("reply")["accepted"]
    told = [chain.inbox.next("feedback")]
    while told[-1]["waypoint"] < 3:
        told.append(chain.inbox.next("feedback"))
    waypoints = [f["waypoint"] for f in told]
    assert waypoints == sorted(set(waypoints)), "each once; a machine that stands still passes one over"
    assert all(f["stages"] >= 1 for f in told)
    assert chain.inbox.next("result")["status"] == "succeeded"


def test_a_goal_replaces_the_running_one_wherever_the_arm_is(chain: Chain) -> None:
    chain.goal(A, B, C, A, B, C, step=0.5, name="old")
    assert chain.inbox.next("reply")["accepted"]
    chain.inbox.next("feedback")
    chain.goal(C, name="new")
    told = [chain.inbox.queue.get(timeout=PATIENCE) for _ in range(4)]
    results = [payload for key, payload in told if key == "result"]
    replies = [payload for key, payload in told if key == "reply"]
    assert [(r["id"], r["status"], r["message"]) for r in results] == [
        ("old", "replaced", "replaced by goal new"),
        ("new", "succeeded", "reached"),
    ]
    assert replies[0]["id"] == "new"


def test_cancel_and_goals_after_it(chain: Chain) -> None:
    for k in range(5):
        chain.goal(A, B, step=10, name=f"g{k}")
        assert chain.inbox.next("reply")["accepted"]
        chain.inbox.next("feedback")
        chain.planner.ask("cancel", name="canceled")
        told = dict(chain.inbox.queue.get(timeout=PATIENCE) for _ in range(2))
        assert told["canceled"]["message"] == "canceled"
        assert told["result"]["status"] == "canceled"
        eventually(lambda: chain.planner.state["mode"] == "ready")


def test_a_planner_that_ends_leaves_the_arm_and_another_goes_on(chain: Chain) -> None:
    chain.goal(A, B, step=10)
    assert chain.inbox.next("reply")["accepted"]
    chain.inbox.next("feedback")
    chain.planner.close()
    result = chain.inbox.next("result")
    assert (result["status"], result["message"]) == ("aborted", "the daemon is shutting down")
    chain.planner = chain.plan_anew()
    chain.goal(C, name="b")
    assert chain.inbox.next("reply")["accepted"]
    chain.inbox.next("feedback")
    assert chain.inbox.next("result")["status"] == "succeeded"


def test_the_result_of_a_planner_that_was_killed_is_told_by_the_next(chain: Chain) -> None:
    chain.goal(A, B, step=10)
    assert chain.inbox.next("reply")["accepted"]
    chain.inbox.next("feedback")
    chain.planner.vanish()
    chain.planner = chain.plan_anew()
    result = chain.inbox.next("inherited")
    assert (result["id"], result["status"]) == ("a", "aborted")
    assert "the planner is gone" in result["message"]
    assert result["configuration"] == "12"


def test_an_executor_that_is_halted_is_met_again(chain: Chain) -> None:
    chain.goal(A, B, step=30)
    assert chain.inbox.next("reply")["accepted"]
    chain.inbox.next("feedback")
    chain.executor.frozen.set()
    result = chain.inbox.next("result")
    assert (result["id"], result["status"]) == ("a", "aborted")
    eventually(lambda: chain.planner.state["mode"] == "fault")
    chain.executor.frozen.clear()
    eventually(lambda: chain.planner.state["mode"] == "ready")
    chain.goal(C, name="b")
    assert chain.inbox.next("reply")["accepted"]
    chain.inbox.next("feedback")
    assert chain.inbox.next("result")["id"] == "b"


def test_stop_and_reset(chain: Chain) -> None:
    chain.goal(A, B, step=30)
    assert chain.inbox.next("reply")["accepted"]
    chain.inbox.next("feedback")
    chain.planner.ask("stop", name="stop")
    told = dict(chain.inbox.queue.get(timeout=PATIENCE) for _ in range(2))
    assert told["result"]["message"] == "stopped; the arm holds"
    assert told["stop"]["accepted"]
    eventually(lambda: chain.planner.state["mode"] == "stopped")
    chain.planner.ask("reset", name="reset")
    assert chain.inbox.next("reset")["accepted"]
    eventually(lambda: chain.planner.state["mode"] == "ready")


def test_set_points_are_followed(chain: Chain) -> None:
    loop = chain.planner.planner.loop

    def follows(goal: tuple[int, ...]) -> bool:
        position = chain.arm.manipulator.tip(np.array(goal))[:2, 3].tolist()
        loop.setpoints.put(json.dumps({"position": position}).encode(), loop.arrive(), "")
        return chain.error(goal) < 0.003

    for goal in (A, C, (0, 0)):
        eventually(lambda goal=goal: follows(goal))
    assert chain.planner.state["mode"] == "executing"
    eventually(lambda: chain.planner.state["mode"] == "ready")


def test_a_jog_and_a_lock(chain: Chain) -> None:
    payload = {"actuators": {"1.left": "extended", "2.right": "extended"}}
    chain.planner.ask("jog", payload)
    assert chain.inbox.next("reply")["accepted"]
    assert chain.inbox.next("result")["status"] == "succeeded"
    eventually(lambda: chain.planner.state["mode"] == "ready")
    eventually(lambda: not chain.executor.core.motion.moving)
    wish = {"actuator": "1.left", "state": 1}
    chain.planner.ask("degrade", wish, "degrade")
    assert chain.inbox.next("degrade")["message"] == "locked: 1.left (extended)"
    eventually(lambda: chain.planner.state["degraded"])
    eventually(lambda: chain.planner.state["mode"] == "ready")
    chain.goal(A, name="after")
    reply = chain.inbox.next("reply")
    if reply["accepted"]:
        chain.inbox.next("feedback")
        chain.inbox.next("result")
    assert chain.planner.state["measured"][0] == 1
