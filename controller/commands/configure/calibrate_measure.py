"""`calibrate --measure`: drives the arm to the configurations that tell most, and takes the tip of each."""

from __future__ import annotations

import contextlib
import os
import queue
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer
from msgspec import ValidationError, convert

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.documents import read_text
from hyperbit.controller.armfile.goal_files import Orientation, goal_rows, parse_goal
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.units import unit_name
from hyperbit.controller.calibration.guide import Guide, frame_of_tip
from hyperbit.controller.calibration.samples import Samples, read_samples
from hyperbit.controller.commands.common import CommandFailed, console, errors, refusal
from hyperbit.controller.commands.connection import connected, named
from hyperbit.controller.commands.use.send import cancel_goal
from hyperbit.controller.manipulator.notation import format_configuration, parse_configuration
from hyperbit.controller.motion.tracking.bias import MeasuredTipMessage
from hyperbit.controller.refusals.reasons import Reason

if TYPE_CHECKING:
    from hyperbit.controller.network.client import Client
    from hyperbit.controller.studies.shares import Spread

PROMPT, TRACKER = "prompt", "measured_tip"
AVERAGED, HEARD_WITHIN = 10, 10.0  # messages of a tracker for one tip, and the longest time for them [s]
BEGIN_WITHIN = 60.0  # [s] from a goal to its beginning: nobody waits for it but this command
POLL = 0.2  # [s] between two looks at a file of tips
MOST_REFUSED = 20  # configurations one after the other to which the arm finds no way
# Reasons for which another configuration may be reached
ELSEWHERE = {
    it.value
    for it in (
        Reason.GOAL_IN_OBSTACLE,
        Reason.NO_CLEAR_PATH,
        Reason.NO_WAY,
        Reason.PLAN_COLLIDES,
        Reason.LOCKED_CONFIGURATION,
    )
}

COLUMNS = {  # of a file of samples, by dimension and whether orientations were measured
    (2, False): "x,y",
    (2, True): "x,y,th",
    (3, False): "x,y,z",
    (3, True): "x,y,z,qx,qy,qz,qw",
}

Tip = tuple[list[float], Orientation]
TakeTip = Callable[[], Tip | None]  # returns the tip where the arm stands; None: it was not seen


class Ended(Exception):
    """The person ends the measurements."""


def measure(
    arm: Arm,
    samples: Path,
    source: str,
    most: int,
    connect: str,
    zenoh_file: Path | None,
    *,
    each: bool,
    parts: Sequence[str] | None,
    yes: bool,
    spread: Spread,
) -> Guide:
    """Measures tips until the held-out error no longer falls, `most` are measured, or the person ends it.

    Each tip is written to the file of samples at once, so the same command goes on after any end.
    """
    columns = check_columns(samples, arm.manipulator.dimension)
    before = read_samples(samples, arm.manipulator) if columns else None
    guide = Guide(arm, before, oriented=before is not None and before.oriented, each=each, parts=parts, spread=spread)
    name = named(arm.settings.name, connect, zenoh_file)
    told = f"{len(guide)} tips are measured, {max(guide.enough - len(guide), 0)} more are needed for the first fit."
    if not yes and not typer.confirm(
        f"{told} The arm {arm.settings.name} will move to up to {most} configurations, one after the other. Continue?",
        err=True,
    ):
        raise CommandFailed("nothing was moved")
    with connected(arm.settings.name, connect, zenoh_file) as client:
        take, refused = source_of(source, client, arm), 0
        try:
            while len(guide) < most and not guide.done and (wanted := guide.propose()) is not None:
                if (text := go(client, format_configuration(arm.manipulator, wanted), name)) is None:
                    guide.leave_out(wanted[None])
                    if (refused := refused + 1) == MOST_REFUSED:
                        raise CommandFailed(f"the arm found no way to {refused} configurations, one after the other")
                    continue
                refused = 0
                console.print(f"{len(guide) + 1}: at {text}")
                if (tip := take()) is None:
                    guide.leave_out(wanted[None])
                    continue
                columns = columns or columns_of(tip)
                if (tip := fitting(tip, columns)) is None:
                    errors.print(f"  {samples} has the columns {columns}: this tip has no orientation, and is left out")
                    guide.leave_out(wanted[None])
                    continue
                if len(guide) == 0 and tip[1] is not None:
                    guide = Guide(arm, None, oriented=True, each=each, parts=parts, spread=spread)
                reached = parse_configuration(arm.manipulator, text)
                append(samples, columns, text, tip)
                if guide.add(reached, frame_of_tip(*tip)):
                    console.print(f"{len(guide)} tips: held-out error {guide.held_out[-1]:.3g} (root mean square)")
        except (Ended, KeyboardInterrupt):
            errors.print(f"ended: {samples} has {len(guide)} tips; the same command goes on after them")
    return guide


def go(client: Client, text: str, arm: str) -> str | None:
    """Moves the arm to a configuration; returns the measured one, or None if there is no clear way to it."""
    name = f"calibrate-{os.getpid()}-{time.monotonic_ns()}"
    goal = {"id": name, "waypoints": [{"configuration": text}], "begin_within": BEGIN_WITHIN}
    try:
        result = client.run(goal)
    except KeyboardInterrupt:
        cancel_goal(client, name, as_json=False)
        raise
    if result.get("code") == 0 and result.get("configuration") is not None:
        return str(result["configuration"])
    if result.get("reason") in ELSEWHERE:
        return None
    raise refusal(result, arm)


def source_of(source: str, client: Client, arm: Arm) -> TakeTip:
    """Returns what takes the tip: a prompt, a tracker that publishes `measured_tip`, or a file that gets a row more."""
    dimension = arm.manipulator.dimension
    if source == PROMPT:
        return lambda: from_prompt(dimension, unit_name(arm.settings.unit))
    if source == TRACKER:
        return lambda: from_tracker(client, dimension)
    if not source.endswith(".csv"):
        raise InputFaults(Path("--measure"), [f"{source!r}: {PROMPT}, {TRACKER} or a CSV file of tips is needed"])
    path = Path(source)
    return lambda: from_file(path, dimension)


def from_prompt(dimension: int, unit: str) -> Tip | None:
    """Asks for the tip until the answer can be read."""
    form = f"x,y[,th], in {unit} and rad" if dimension == 2 else f"x,y,z[,qx,qy,qz,qw], in {unit}"
    while True:
        sys.stderr.write(f"  tip {form} (Enter: skip it, q: end): ")
        sys.stderr.flush()
        if not (line := sys.stdin.readline()) or line.strip() == "q":
            raise Ended
        if not line.strip():
            return None
        try:
            return parse_goal(line.strip().split(","), dimension, "tip")
        except InputFaults as error:
            errors.print(str(error))


def from_tracker(client: Client, dimension: int) -> Tip:
    """Returns the mean of the next positions that a tracker measures from now on, by their stamps."""
    heard: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    found, until, now = list[list[float]](), time.monotonic() + HEARD_WITHIN, time.time()
    with client.subscribe("measured_tip", heard.put):
        while len(found) < AVERAGED:
            try:
                message = heard.get(timeout=max(until - time.monotonic(), 0.0))
            except queue.Empty:
                words = f"{len(found)} of {AVERAGED} positions came on `measured_tip` within {HEARD_WITHIN:g} s"
                words += ", each with a `stamp` after the motion"
                raise CommandFailed(words, "start the tracker, then this command again: it goes on") from None
            with contextlib.suppress(ValidationError):
                measured = convert(message, MeasuredTipMessage)
                if measured.stamp >= now and len(measured.position) == dimension:
                    found.append(measured.position)
    return np.mean(found, axis=0).tolist(), None


def from_file(path: Path, dimension: int) -> Tip:
    """Waits for a further row of a CSV file with columns x,y[,th] or x,y,z[,qx,qy,qz,qw]; returns its tip."""
    count = rows_in(path, dimension)
    errors.print(f"  waiting for row {len(count) + 1} of {path} (Ctrl-C: end)")
    while len(now := rows_in(path, dimension)) <= len(count):
        time.sleep(POLL)
    return now[len(count)]


def rows_in(path: Path, dimension: int) -> list[Tip]:
    """Returns the tips of the whole lines of a file; none if it is not there, or has no row yet."""
    if not path.exists() or path.read_bytes().count(b"\n") < 2 or not path.read_bytes().endswith(b"\n"):
        return []
    return [(row.position, row.orientation) for row in goal_rows(path, dimension)]


def check_columns(path: Path, dimension: int) -> str:
    """Returns the columns of a file of samples that goes on; "" if it has none yet."""
    if not path.exists() or not (text := read_text(path)).strip():
        return ""
    known = [f"configuration,{names}" for count, names in COLUMNS.items() if count[0] == dimension]
    if (columns := text.partition("\n")[0].strip().replace(" ", "")) not in known:
        raise InputFaults(
            path, [f"to go on, the columns {' or '.join(known)} are needed, in this order, got {columns}"]
        )
    if not text.endswith("\n"):
        raise InputFaults(path, ["the last line has no end: complete or remove it"])
    return columns


def columns_of(tip: Tip) -> str:
    return f"configuration,{COLUMNS[len(tip[0]), tip[1] is not None]}"


def fitting(tip: Tip, columns: str) -> Tip | None:
    """Returns a tip as a file with these columns takes it; None if its orientation is missing."""
    if columns_of(tip) == columns:
        return tip
    without = tip[0], None
    return without if columns_of(without) == columns else None


def append(path: Path, columns: str, configuration: str, tip: Tip) -> None:
    """Adds a sample to a file, and begins it with the names of its columns."""
    position, turn = tip
    numbers = [*position, *(turn if isinstance(turn, list) else [] if turn is None else [turn])]
    row = f'"{configuration}",{",".join(map(repr, numbers))}\n'
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(row if file.tell() else f"{columns}\n{row}")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise CommandFailed(f"{path} cannot be written: {error.strerror}") from None


def proposed(arm: Arm, samples: Samples | None, count: int, *, each: bool, parts: Sequence[str] | None) -> list[str]:
    """Returns the configurations to measure next, as text."""
    guide = Guide(arm, None, oriented=samples is not None and samples.oriented, each=each, parts=parts)
    design = guide.design
    if samples is not None:
        design.add(samples.configurations)
    found = list[str]()
    while len(found) < count and (wanted := design.propose()) is not None:
        design.add(wanted[None])
        found.append(format_configuration(arm.manipulator, wanted))
    return found
