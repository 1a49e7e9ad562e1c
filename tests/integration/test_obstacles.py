"""Regions to keep out of: sent over Zenoh, or in the arm's file; the arm goes around them, or holds and says why."""

import dataclasses
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can
import numpy as np
import pytest

from controller.config import Arm
from controller.daemon.avoidance import IN_OBSTACLE
from controller.manipulator.frames import planar
from controller.motion import codes
from controller.obstacles.regions import half_space
from controller.obstacles.sweep import Sweep, Touch
from drivers import cia301
from drivers.simulation.simulation import Simulation
from drivers.wiring import MASTER, BusSettings
from tests.daemon.waiting import PATIENCE, SLOWNESS, eventually
from tests.integration.conftest import Bench
from tests.integration.harness import Observer
from tests.integration.motions import Motions
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT, tip
from tests.obstacles.dense import Box, Disc, Region, nearest

CRATE = {"disc": {"centre": list(RIGHT), "radius": 0.2}, "name": "crate"}
# Where the arm goes from MIDDLE to FAR, and beside the way.
FAR = (-0.6, 2.7)
AROUND = [
    {"disc": {"centre": [0.9, 1.4], "radius": 0.3}, "name": "pillar"},
    {"box": {"centre": [-0.9, 1.2], "size": [0.5, 0.3], "angle": 0.4}, "name": "shelf"},
]
SHAPES: list[Region] = [Disc((0.9, 1.4), 0.3), Box(planar(-0.9, 1.2, 0.4), (0.5, 0.3))]


@contextmanager
def watched(boards: Simulation) -> Iterator[list[np.ndarray]]:
    """Gives where the actuators are, over and over while the context lasts: 0 contracted, 1 extended."""
    strokes, ended = list[np.ndarray](), threading.Event()

    def watch() -> None:
        while not ended.wait(0.002):
            strokes.append(np.array(boards.positions(), dtype=float))

    thread = threading.Thread(target=watch)
    thread.start()
    yield strokes
    ended.set()
    thread.join()


def bodies(arm: Arm, strokes: np.ndarray) -> np.ndarray:
    """The arm's line segments (n, 2, 3) in the world where its actuators are at strokes (A,)."""
    frame, start, lines = arm.manipulator.base, 0, []
    for module in arm.manipulator.modules:
        own = strokes[start : start + len(module.actuators)]
        start += len(module.actuators)
        (onward,), (body,) = module.between(own[None])
        lines.append(body @ frame[:3, :3].T + frame[:3, 3])
        frame = frame @ onward
    return np.concatenate(lines)


def keep_out(client: Observer, *regions: object) -> str:
    answer = client.ask("obstacles", regions=list(regions))
    assert answer["accepted"], answer
    return str(answer["message"])


def test_goals_are_planned_around_regions_that_are_sent_until_they_are_gone(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    client.move(MIDDLE)
    before = boards.switches().tolist()
    assert keep_out(client, CRATE) == "keeping out of 1 region, 1 of them sent"
    refused = client.goal(RIGHT)
    assert (refused["accepted"], refused["code"]) == (False, codes.GOAL_TOLERANCE_VIOLATED)
    assert boards.switches().tolist() == before
    assert keep_out(client, *AROUND) == "keeping out of 2 regions, 2 of them sent"
    with watched(boards) as strokes:
        for number, goal in enumerate((FAR, LEFT, RIGHT, MIDDLE)):
            if client.goal(goal, id=f"b{number}")["accepted"]:
                assert client.result(f"b{number}")["status"] == "succeeded"
                assert np.linalg.norm(tip(boards, arm) - goal) <= arm.tolerance
    assert len(client.accepted) >= 4
    seen = np.unique(np.array(strokes).round(2), axis=0)
    assert len(seen) > 10
    assert all(nearest(bodies(arm, stroke), SHAPES) > 0 for stroke in seen)
    assert keep_out(client) == "keeping out of 0 regions, 0 of them sent"
    client.move(RIGHT, goal="c")


def test_a_running_goal_whose_rest_would_touch_is_aborted_and_the_arm_holds(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    assert client.goal(MIDDLE, LEFT, RIGHT, times=[0, 1, HOUR], id="a")["accepted"]
    eventually(lambda: len(client.feedback("a")) == 2)
    before = boards.switches().tolist()
    keep_out(client, CRATE)
    result = client.result("a")
    assert (result["status"], result["code"]) == ("aborted", codes.PATH_TOLERANCE_VIOLATED)
    assert "disc 'crate'" in result["message"]
    assert "disc 'crate'" in client.wait_now("ready")["reason"]
    assert boards.switches().tolist() == before
    client.move(MIDDLE, goal="b")


def test_an_arm_that_stands_in_a_region_says_so_and_takes_goals_when_it_is_gone(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    client.move(MIDDLE)
    assert "where the arm stands" in keep_out(client, {"disc": {"centre": list(MIDDLE), "radius": 0.1}, "name": "hand"})
    eventually(lambda: IN_OBSTACLE in [fault["code"] for fault in client.wait_now("ready")["faults"]])
    refused = client.goal(LEFT)
    assert (refused["accepted"], "disc 'hand'" in refused["message"]) == (False, True)
    keep_out(client)
    eventually(lambda: client.wait_now("ready")["faults"] == [])
    client.move(LEFT, goal="b")


def test_what_is_malformed_changes_nothing(client: Observer, motions: Motions) -> None:
    keep_out(client, CRATE)
    for payload in ({}, {"regions": [{}]}, {"regions": [CRATE, CRATE]}, {"regions": [], "more": 1}):
        assert client.client.request("obstacles", payload)["accepted"] is False
    assert client.goal(RIGHT)["accepted"] is False
    client.client._session.put(f"hyperbit/{client.client._arm}/obstacles", json.dumps({"regions": []}))  # a plain put
    eventually(lambda: client.goal(RIGHT, id=f"a{len(client.heard['state'])}")["accepted"])


@pytest.fixture
def walled(arm: Arm) -> Arm:
    """The arm, with a region in its file."""
    return dataclasses.replace(arm, regions=half_space("half-plane 'wall'", [2.5, 0], [-1, 0]))


def test_a_new_daemon_knows_the_regions_of_the_file_only(
    bench: Bench, walled: Arm, boards: Simulation, arm: Arm
) -> None:
    bench.arm = walled
    for _ in range(2):
        daemon = bench.daemon()
        thread = threading.Thread(target=daemon.run)
        thread.start()
        client = bench.observer()
        client.wait_for("ready")
        assert client.goal(RIGHT)["accepted"] is False
        assert keep_out(client) == "keeping out of 1 region, 0 of them sent"
        assert keep_out(client, *AROUND) == "keeping out of 3 regions, 2 of them sent"
        daemon.quit()
        thread.join(10 * SLOWNESS)


def test_the_loop_goes_on_while_a_stage_waits_that_nobody_looked_at(
    client: Observer, boards: Simulation, bus: BusSettings, motions: Motions, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened, touch = threading.Event(), Sweep.touch

    def waiting(sweep: Sweep, states: np.ndarray, actuators: np.ndarray) -> Touch | None:
        if threading.current_thread().name == "avoidance":
            assert opened.wait(PATIENCE)
        return touch(sweep, states, actuators)

    monkeypatch.setattr(Sweep, "touch", waiting)
    assert client.goal(MIDDLE, LEFT, times=[0, 3], id="a")["accepted"]
    eventually(lambda: client.feedback("a"))
    keep_out(client, {"disc": {"centre": [9, 9], "radius": 0.1}})
    before = boards.switches().tolist()
    eventually(lambda: any(told["waits"] > 0 for told in client.heard["diagnostics"]))
    states = len(client.heard["state"])
    with can.Bus(interface=bus.interface, channel=bus.channel, bitrate=bus.bitrate, ignore_config=True) as listening:
        beats = [frame.arbitration_id for _ in range(500) if (frame := listening.recv(PATIENCE))]
    assert beats.count(cia301.HEARTBEAT + MASTER) > 10, "the master is heard"
    assert cia301.SYNC not in beats
    state = eventually(lambda: client.heard["state"][states + 20 :])[-1]
    assert (state["mode"], state["goal"], state["faults"]) == ("executing", "a", [])
    assert boards.switches().tolist() == before
    opened.set()
    assert client.result("a")["status"] == "succeeded"
    assert boards.switches().tolist() != before
