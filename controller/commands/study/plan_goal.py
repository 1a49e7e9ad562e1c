"""`plan ARM.yaml GOAL`: what `send ARM.yaml GOAL` would do, told and drawn. Nothing moves.

A running daemon of the arm is asked, so the plan begins where the arm is. Without one the plan is made here, as the
daemon makes it.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.commands.common import (
    CommandFailed,
    check_picture,
    configuration,
    console,
    densities_of,
    drawing,
    print_json,
    print_table,
    refusal,
    results_table,
    shown,
)
from hyperbit.controller.commands.connection import arms_alive, named, open_session
from hyperbit.controller.commands.study.plan_rows import sentence
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.manipulator.notation import format_configuration, parse_configuration
from hyperbit.controller.messages.goals import Answer, refused
from hyperbit.controller.motion.decoding.goal import parse
from hyperbit.controller.motion.decoding.requests import decode_obstacles
from hyperbit.controller.motion.stages.program import packed
from hyperbit.controller.motion.trajectory import upwards
from hyperbit.controller.obstacles.obstacles import NONE, Obstacles, together
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

TOO_FAST = {it.value for it in (Reason.TIME_TOO_SHORT, Reason.TIMES_TOO_CLOSE, Reason.LINE_TOO_FAST)}
LONGEST = 60.0  # [s] for a plan without a daemon, beside its own deadline
MOST_DRAWN = 8  # configurations of a picture


Plan = dict[str, Any]  # the answer of a daemon to `plan`


class Start(NamedTuple):
    """Where a plan begins."""

    configuration: str | None  # None: the arm is in none, and the daemon refuses
    words: str
    obstacles: Obstacles = NONE  # those that were sent to the daemon


class Planned(NamedTuple):
    """The plan of a goal; `slow`: of one that its times refuse, the plan with as much time as it needs."""

    start: Start
    plan: Plan
    slow: Plan | None


def plan_goal(
    file: Path,
    payload: Plan,
    previous: str | None,
    connect: str,
    zenoh_file: Path | None,
    picture: Path | None,
    *,
    as_json: bool,
) -> None:
    """Prints the plan of a goal, given as its payload.

    `previous` is the configuration to begin with; no daemon is asked then.
    """
    arm = load(file)
    if picture is not None:
        check_picture(picture)
    found = None if previous is not None else of_daemon(arm, payload, connect, zenoh_file)
    start, plan, slow = of_arm(arm, payload, previous) if found is None else found
    if as_json:
        print_json({**plan, "start": start.configuration})
    if not plan["accepted"]:
        if slow is not None and slow["accepted"] and not as_json:
            console.print("too fast; with more time the goal is possible, and needs:")
            print_table(legs_table(slow, [waypoint.get("t", 0.0) for waypoint in payload["waypoints"]]))
        raise refusal(plan, named(str(file), connect, zenoh_file))
    if not as_json:
        show(start, plan)
    if picture is not None:
        draw(picture, arm, start, plan)
        if not as_json:
            console.print(f"picture: {picture}")


def of_daemon(arm: Arm, payload: Plan, connect: str, zenoh_file: Path | None) -> Planned | None:
    """Returns the plan of the arm's daemon, from where the arm is; None if there is none."""
    from hyperbit.controller.network.client import Client, Unanswered

    with contextlib.ExitStack() as stack:
        try:
            session = stack.enter_context(open_session(connect, zenoh_file))
        except CommandFailed:
            return None
        if arm.settings.name not in arms_alive(session):
            return None
        client = stack.enter_context(contextlib.closing(Client(session, arm.settings.name)))
        try:
            text, sent = client.next_state().configuration, client.describe().sent_obstacles
            obstacles = decode_obstacles(json.dumps({"regions": sent}).encode(), arm.manipulator.dimension)
            words = f"from where the arm is: {f'configuration {text}' if text else 'in no configuration'}"
            start = Start(text, words, obstacles)
            return planned(start, payload, lambda goal: client.request("plan", goal, timeout=LONGEST))
        except Unanswered as error:
            raise CommandFailed(str(error)) from None


def of_arm(arm: Arm, payload: Plan, previous: str | None) -> Planned:
    """Returns the plan without a daemon."""
    begin = configuration(arm, previous or "0" * len(arm.manipulator.modules), "--previous")
    text = format_configuration(arm.manipulator, begin)
    why = "no daemon of this arm is running; --previous names another" if previous is None else "as --previous says"
    return planned(Start(text, f"from configuration {text}: {why}"), payload, Alone(arm, begin).plan)


def planned(start: Start, payload: Plan, plan: Callable[[Plan], Plan]) -> Planned:
    found = plan(payload)
    return Planned(start, found, plan(untimed(payload)) if found.get("reason") in TOO_FAST else None)


class Alone:
    """Plans goals of an arm without a daemon, from a configuration (B,) of the whole arm, as its daemon would."""

    def __init__(self, arm: Arm, start: Configuration) -> None:
        from hyperbit.controller.planning.workers.computations import ArmModel, build_scene, build_tables

        locked = np.asarray(arm.locked, dtype=np.int8)
        states = arm.manipulator.actuator_states(start)
        if (wrong := np.flatnonzero((locked >= 0) & (locked != states))).size:
            label = arm.manipulator.actuators[wrong[0]]
            raise CommandFailed(f"--previous: {label} is stuck in another state, see `actuators` of the arm's file")
        at, mask = packed(states), packed(locked >= 0)
        tables = build_tables(arm, densities_of(arm), weights_of(arm), tasks.BuildTables(0, locked.tobytes()))
        scene = build_scene(arm, tasks.BuildScene(0, NONE)).scene
        self._basis = tasks.Basis(tasks.ArmStart(at, at, at, mask), tables, scene)
        self._model = ArmModel(arm, "queries")

    def plan(self, payload: dict[str, Any]) -> Plan:
        """Returns the answer to a goal's payload, as the daemon's to `plan`."""
        from hyperbit.controller.gateway.outbox import encoded
        from hyperbit.controller.planning.workers.computations import describe

        try:
            message = parse(json.dumps(payload).encode())
            goal = tasks.PlanGoal(message, time.time(), None, self._basis)
            task = tasks.DescribePlan(goal, LONGEST + (message.deadline or 0.0))
            answer: Answer = describe(self._model, task, lambda: False, lambda: False).plan
        except Refusal as error:
            answer = refused(error)
        plan: Plan = json.loads(encoded(answer))
        return plan


def untimed(payload: dict[str, Any]) -> dict[str, Any]:
    waypoints = [{name: value for name, value in it.items() if name != "t"} for it in payload["waypoints"]]
    return {**payload, "waypoints": waypoints}


def show(start: Start, plan: Plan) -> None:
    console.print(start.words)
    if plan.get("homing"):
        console.print(f"homed first, one switch each: {', '.join(plan['homing'])}")
    print_table(legs_table(plan))
    for number, points in legs(plan):
        for point in points:
            for stage in point["stages"]:
                console.print(f"  {number}: {', '.join(stage)}")
    console.print(f"{plan['message']}: {sentence(plan)}")


def legs(plan: Plan) -> Iterator[tuple[int, list[Plan]]]:
    """Yields the number of each waypoint, from 1, and the points of a plan on the way to it, itself the last."""
    ends = np.cumsum([not point["between"] for point in plan["waypoints"]])
    of = [int(end) + bool(point["between"]) for end, point in zip(ends, plan["waypoints"], strict=True)]
    for number, points in groupby(zip(of, plan["waypoints"], strict=True), key=lambda pair: pair[0]):
        yield number, [point for _, point in points]


def legs_table(plan: Plan, given: list[float] | None = None) -> Any:
    """Returns a table of the waypoints; `given`: their times [s], None: those of the plan."""
    table = results_table("waypoint", "t [s]", "time [s]", "needs [s]", "stages", "switches", "error", "configuration")
    before = 0.0
    for number, points in legs(plan):
        last = points[-1]
        t = last["t"] if given is None else given[number - 1]
        needed = sum(point.get("needed") or 0.0 for point in points)
        table.add_row(
            f"{number}: ({', '.join(f'{x:g}' for x in last['goal'])})",
            f"{t:g}",
            "" if number == 1 else f"{t - before:.3g}",
            f"{upwards(needed):g}" if needed else "0",
            str(sum(len(point["stages"]) for point in points)),
            str(sum(point["switches"] for point in points)),
            shown(last["error"]),
            last["configuration"],
        )
        before = t
    return table


def draw(picture: Path, arm: Arm, start: Start, plan: Plan) -> None:
    """Draws the arm at the start and at waypoints, the goals, and the obstacles."""
    from hyperbit.controller.pictures import plots

    ends = [(number, points[-1]) for number, points in legs(plan)]
    some = sorted({round(k) for k in np.linspace(0, len(ends) - 1, min(len(ends), MOST_DRAWN))})
    texts = {} if start.configuration is None else {"start": start.configuration}
    texts |= {f"waypoint {ends[k][0]}": ends[k][1]["configuration"] for k in some}
    shapes = {name: parse_configuration(arm.manipulator, text) for name, text in texts.items()}
    goals = np.array([point["goal"] for _, point in ends])
    subplot = plots.Subplot(f"{arm.settings.name}: {plan['message']}", shapes, goals, goals if len(goals) > 1 else ())
    densities = densities_of(arm) if arm.manipulator.planar else None
    with drawing(picture):
        plots.save(
            picture,
            arm.manipulator,
            densities,
            [subplot],
            arm.settings.unit,
            obstacles=together([arm.obstacles, start.obstacles]),
        )
