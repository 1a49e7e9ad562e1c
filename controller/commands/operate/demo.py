"""The command `demo`: a daemon with simulated boards in processes of its own, and its client in this process."""

from __future__ import annotations

import contextlib
import importlib
import math
import os
import queue
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
import typer
from numpy.typing import NDArray
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.patience import patient_copy
from hyperbit.controller.commands.common import (
    CommandFailed,
    check_picture,
    console,
    densities_of,
    errors,
    load_wired,
    shipped,
)
from hyperbit.controller.commands.connection import connected
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.manipulator.notation import parse_configuration
from hyperbit.controller.network.endpoints import accepts
from hyperbit.controller.pictures import plots
from hyperbit.controller.workspace.densities import Densities

if TYPE_CHECKING:
    from hyperbit.controller.network.client import Client
from hyperbit.controller.messages.reading import Message

PAPER_TARGETS = [[3.0, 0.7], [0.55, 2.9], [0.4, 2.9]]
CURVE_WAYPOINTS = 36
MANY = 100.0  # configurations expected within the tolerance of each point of the curve
MOST = 100.0  # log counts are clipped here, so that exp does not overflow
DRAWN = 1000  # configurations drawn to find targets
STEP = 0.08  # [s] between waypoints; 1.5 travel times for each stage, if that is longer
LAST_STATE_TIMEOUT = 10.0  # [s] for the state message after a result
DAEMON_TIMEOUT = 180.0  # [s] until the daemon is ready, or has ended; its first start compiles the kernels


def demo(
    file: Annotated[Path | None, typer.Argument(metavar="ARM.yaml", help="The arm's file. Default: planar16.")] = None,
    picture: Annotated[Path, typer.Option(help="File for the picture.")] = Path("demo.png"),
    animation: Annotated[Path | None, typer.Option(help="File for an animation: .gif, .png or .webp.")] = None,
) -> None:
    """Run a daemon on simulated boards, send it three targets and a closed curve, and draw a picture."""
    path = file or shipped("planar16.yaml")
    arm = load_wired(path)
    for output in filter(None, (picture, animation)):
        check_picture(output)
    # The picture needs matplotlib, which is imported while the daemon starts.
    threading.Thread(target=importlib.import_module, args=("matplotlib.figure",), daemon=True).start()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as pool:
        choosing = pool.submit(choose_goals, arm, paper=file is None)  # while the daemon starts
        with started(path, Path(folder)) as (daemon, endpoint):
            goals = choosing.result()
            with connected(arm.settings.name, endpoint, None) as client:
                wait_until_ready(client, daemon.poll)
                shown = move(client, arm, goals)
            daemon.terminate()  # it ends while the picture is drawn
            console.print(summary(arm, shown.rows))
            draw(arm, goals, shown, picture, animation)


class DemoGoals(NamedTuple):
    densities: Densities
    targets: list[list[float]]  # positions, shape (count, dimension)
    curve: NDArray[np.float64]  # waypoints of a closed curve, shape (n, dimension)


class Shown(NamedTuple):
    rows: list[tuple[str, Message, float]]  # name, result and duration [s] of each goal
    reached: dict[str, Configuration]  # at each target, shape (B,)
    states: list[list[int]]  # commanded actuator states, shape (A,) each
    pauses: list[int]  # indices of states at which a goal had ended


def choose_goals(arm: Arm, *, paper: bool) -> DemoGoals:
    densities = densities_of(arm)
    return DemoGoals(densities, PAPER_TARGETS if paper else sample(arm, 3), closed_curve(arm, densities))


def move(client: Client, arm: Arm, goals: DemoGoals) -> Shown:
    """Sends all targets and the curve, and returns what the arm did."""
    states, shown = Watched(), Shown([], {}, [], [])

    def run_goal(waypoints: list[dict[str, Any]], row: str, what: str) -> Configuration:
        began = time.perf_counter()
        result = run(client, waypoints, what)
        shown.rows.append((row, result, time.perf_counter() - began))
        configuration = parse_configuration(arm.manipulator, result["configuration"])
        shown.pauses.append(states.find([int(state) for state in arm.manipulator.actuator_states(configuration)]))
        return configuration

    with client.subscribe("state", states.receive_state):
        for target in goals.targets:
            where = written(target)
            shown.reached[f"at ({where})"] = run_goal([{"position": target}], where, f"target ({where})")
        step = max(STEP, 1.5 * arm.travel_time * stages(arm) + arm.settings.rest_time)
        curve = [{"t": k * step, "position": p} for k, p in enumerate(goals.curve.tolist())]
        name = f"closed curve, {len(curve)} waypoints"
        run_goal(curve, name, name)
    return shown._replace(states=states)


def draw(arm: Arm, goals: DemoGoals, shown: Shown, picture: Path, animation: Path | None) -> None:
    title = f"{arm.settings.name}: {len(arm.manipulator.modules)} modules, {len(arm.manipulator.actuators)} actuators"
    subplots = [plots.Subplot(title, shown.reached, goals.targets, goals.curve)]
    plots.save(picture, arm.manipulator, goals.densities, subplots, arm.settings.unit, obstacles=arm.obstacles)
    console.print(f"picture: {picture}")
    if animation is not None:
        from hyperbit.controller.pictures.animation import Movement, ends, film

        around = ends(arm.manipulator, shown.states)
        subplot = plots.Subplot(title, targets=goals.targets, curve=goals.curve, around=around)
        figure = plots.figure(arm.manipulator, goals.densities, [subplot], obstacles=arm.obstacles)
        film(figure, arm.manipulator, Movement(shown.states, shown.pauses)).write(animation)
        console.print(f"animation: {animation}")


class Watched(list[list[int]]):
    """History of the commanded actuator states, shape (A,) each, without repetitions."""

    def receive_state(self, state: Message) -> None:
        """Appends the commanded states of a state message, if they are known and new."""
        commanded = state["commanded"]
        if commanded is not None and self[-1:] != [commanded]:
            self.append(commanded)

    def find(self, states: list[int]) -> int:
        """Waits until the last entry equals `states`, and returns its index; messages come 20 times a second."""
        until = time.monotonic() + LAST_STATE_TIMEOUT
        while self[-1:] != [states] and time.monotonic() < until:
            time.sleep(0.02)
        return len(self) - 1


def sample(arm: Arm, count: int) -> list[list[float]]:
    """Returns tips (count, dimension) of random collision-free configurations; the same at each call."""
    states = np.random.default_rng(16).integers(0, arm.manipulator.states, (DRAWN, len(arm.manipulator.modules)))
    states = states[~arm.clearance().blocked(states)][:count]
    tips = arm.manipulator.tips(states)[:, : arm.manipulator.dimension, 3]
    return [list(map(float, tip)) for tip in tips]


def closed_curve(arm: Arm, densities: Densities) -> NDArray[np.float64]:
    """Returns waypoints (n, dimension) on the largest ellipse that the arm reaches according to its densities.

    The centre is the tip of a random configuration. The ellipse lies in the plane of the tips' two principal
    directions.
    """
    chain, base = Manipulator(arm.manipulator.modules), arm.manipulator.base
    states = np.random.default_rng(0).integers(0, chain.states, (500, len(chain.modules)))
    tips = chain.tips(states)[:, :3, 3]
    promised = expected(densities, arm.tolerance, chain.planar)
    first, second = np.linalg.svd(tips - tips.mean(axis=0), full_matrices=False)[2][:2]
    turns = np.linspace(0.0, 2 * np.pi, CURVE_WAYPOINTS)[:, None]
    ellipse = np.cos(turns) * first + 0.5 * np.sin(turns) * second
    size = 0.1 * chain.length
    while True:
        curves = tips[:, None] + size * ellipse
        thinnest = np.where(outside(arm, curves), looked_up(densities, promised, curves).min(axis=1), 0.0)
        best = int(np.argmax(thinnest))
        if thinnest[best] >= MANY or size <= arm.tolerance / 2:
            return np.asarray((curves[best] @ base[:3, :3].T + base[:3, 3])[:, : arm.manipulator.dimension])
        size *= 0.9


def expected(densities: Densities, tolerance: float, planar: bool) -> NDArray[np.float64]:
    """Returns the expected number of configurations within the tolerance of each pixel (z, y, x) of W_0.

    Counts are averaged over neighbouring pixels: with few states in the last modules, every other pixel may be empty.
    """
    values = densities.level(0).astype(float)
    counts = np.where(values >= 0, np.exp(np.minimum(values, MOST)), 0.0)
    axes = (1, 2) if planar else (0, 1, 2)
    for axis in axes:
        ends = [(int(k == axis),) * 2 for k in range(3)]
        counts = np.lib.stride_tricks.sliding_window_view(np.pad(counts, ends), 3, axis).sum(axis=-1)
    ball = np.pi * tolerance**2 if planar else 4 / 3 * np.pi * tolerance**3
    return np.asarray(counts * (ball / densities.volume(0, planar=planar) / 3 ** len(axes)))


def looked_up(densities: Densities, values: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the values (z, y, x) of W_0's pixels at points (..., 3); 0 outside W_0."""
    index = np.round((points - densities.references[0]) / densities.pixels[0]).astype(int)[..., ::-1]
    inside = ((index >= 0) & (index < values.shape)).all(axis=-1)
    z, y, x = np.moveaxis(np.where(inside[..., None], index, 0), -1, 0)
    return np.where(inside, values[z, y, x], 0.0)


def outside(arm: Arm, curves: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Returns which of curves (m, n, 3), as seen from the base, keep out of the arm's regions."""
    world = curves.reshape(-1, 3) @ arm.manipulator.base[:3, :3].T + arm.manipulator.base[:3, 3]
    depths = arm.obstacles.depths(world).min(axis=1, initial=np.inf).reshape(curves.shape[:2])
    return np.asarray((depths > arm.settings.body_radius).all(axis=1))


def stages(arm: Arm) -> int:
    return 1 if arm.settings.inrush is None else math.ceil(len(arm.manipulator.actuators) / 3 / arm.settings.inrush)


@contextlib.contextmanager
def started(file: Path, folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Runs a daemon with simulated boards and long time-outs; yields its process and its Zenoh endpoint.

    Sockets, ledger and log are in `folder`, so another daemon of this arm may run on the computer.
    """
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = "127.0.0.1", free.getsockname()[1]
    endpoint = f"tcp/127.0.0.1:{address[1]}"
    file = patient_copy(file, folder)
    command = [sys.executable, "-m", "hyperbit", "run", str(file), "--simulate", "--listen", endpoint]
    with (folder / "log").open("w+") as log:
        command += ["--ledger", str(folder / "ledger.sqlite")]
        environment = {**os.environ, "RUNTIME_DIRECTORY": str(folder)}
        daemon = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=log, stdout=log, env=environment)
        try:
            until = time.monotonic() + DAEMON_TIMEOUT
            while not accepts(address):
                if daemon.poll() is not None or time.monotonic() > until:
                    log.seek(0)
                    errors.print(log.read())
                    raise CommandFailed("the daemon did not start; its log is above")
                time.sleep(0.05)
            yield daemon, endpoint
        finally:
            daemon.terminate()
            daemon.wait(DAEMON_TIMEOUT)


def wait_until_ready(client: Client, ended: Callable[[], int | None] = lambda: None) -> None:
    """Waits until the arm is in mode ready. `ended` returns the daemon's exit code, None while the daemon runs."""
    states: queue.SimpleQueue[Message] = queue.SimpleQueue()
    with client.subscribe("state", states.put):
        while True:
            try:
                state = states.get(timeout=DAEMON_TIMEOUT)
            except queue.Empty:
                raise CommandFailed(f"the daemon published no state for {DAEMON_TIMEOUT:g} s") from None
            if state["mode"] == "ready":
                return
            if (code := ended()) is not None:
                raise CommandFailed(f"the daemon ended with code {code}")
            if state["mode"] == "fault":
                raise CommandFailed(f"the daemon reports a fault: {state['reason']}")


def run(client: Client, waypoints: list[dict[str, Any]], what: str) -> Message:
    """Sends a goal and shows its progress; returns its result, with the worst error of its waypoints as `worst`."""
    errors_seen = [0.0]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(what, total=len(waypoints))

        def follow(message: Message) -> None:
            if "waypoint" in message:
                errors_seen.append(message["error"])
                progress.update(task, completed=message["waypoint"] + 1)

        result = client.run({"waypoints": waypoints}, follow)
    if result.get("code") != 0:
        raise CommandFailed(f"{what}: {result['message']}")
    return {**result, "worst": max(*errors_seen, result["error"])}


def summary(arm: Arm, rows: list[tuple[str, Message, float]]) -> Table:
    table = Table("target", "reached", "error", "switches", "time [s]", title=f"{arm.settings.name}, tip positions")
    for target, result, seconds in rows:
        table.add_row(
            target, written(result["position"], 4), f"{result['worst']:.4f}", str(result["switches"]), f"{seconds:.2f}"
        )
    return table


def written(position: list[float], digits: int = 2) -> str:
    return ", ".join(f"{x:.{digits}f}" for x in position)
