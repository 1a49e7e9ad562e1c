"""The command `replay`: publishes a recording again, or repeats its goals."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import common
from hyperbit.controller.commands.arguments import AsJson, Listen
from hyperbit.controller.commands.common import CommandFailed, arm_name, print_json
from hyperbit.controller.commands.connection import open_zenoh, zenoh_config
from hyperbit.controller.commands.process import ending_event
from hyperbit.controller.commands.serve.record import require

if TYPE_CHECKING:
    import zenoh

    from hyperbit.controller.recorder.player import Timeline
    from hyperbit.controller.recorder.reader import RecordingReader

LISTEN = "tcp/127.0.0.1:7457"

RECORDING = "A file that `hyperbit record` wrote."
SPEED = "Speed of the replay; 2 is twice as fast as recorded."
BEGIN = "Time in the recording at which the replay begins [s]."
PREFIX = "Prefix of the keys: they are published below PREFIX/<arm>."
STAY = "Continue after the end of the recording until SIGTERM, so that a page can move the timeline."
GOALS = "Send the recorded goals to a simulated arm instead, and compare the configurations."
ARM = "With --goals: an arm's file to use instead of the recorded one."
CONNECT = "Zenoh endpoint to connect to, instead of --listen."


def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE.mcap", help=RECORDING, show_default=False)],
    speed: Annotated[float, typer.Option(help=SPEED)] = 1.0,
    begin: Annotated[float, typer.Option("--from", metavar="SECONDS", help=BEGIN)] = 0.0,
    stay: Annotated[bool, typer.Option("--stay", help=STAY)] = False,
    prefix: Annotated[str, typer.Option(help=PREFIX)] = "replay",
    listen: Listen = LISTEN,
    connect: Annotated[str | None, typer.Option(help=CONNECT, show_default=False)] = None,
    goals: Annotated[bool, typer.Option("--goals", help=GOALS)] = False,
    arm: Annotated[Path | None, typer.Option(help=ARM, show_default=False)] = None,
    as_json: AsJson = False,
) -> None:
    """Publish a recording again below another key prefix, or repeat its goals on a simulated arm and compare."""
    require("mcap")
    check_options(speed, begin, prefix)
    if arm is not None and not goals:
        raise InputFaults(Path("--arm"), ["only with --goals"])
    with opened_recording(file) as past:
        if goals:
            compare_goals(past, arm, as_json)
            return
        from hyperbit.controller.recorder.player import Timeline

        where = {"mode": "client", "connect": connect} if connect else {"mode": "peer", "listen": listen}
        timeline = Timeline(past.begin / 1e9, past.end / 1e9, speed)
        timeline.change({"at": timeline.begin + begin})
        play(past, zenoh_config(None, **where), connect or listen, prefix, timeline, stay=stay)


def check_options(speed: float, begin: float, prefix: str) -> None:
    from hyperbit.controller.recorder.player import FASTEST

    if not 0.0 < speed <= FASTEST:
        raise InputFaults(Path("--speed"), [f"a number above 0 and up to {FASTEST:g} is needed, got {speed:g}"])
    if not 0.0 <= begin < 1e9:
        raise InputFaults(Path("--from"), [f"seconds from 0 on are needed, got {begin:g}"])
    keys = prefix.split("/")
    if "hyperbit" in keys or not all(key.isascii() and key.replace("-", "").replace("_", "").isalnum() for key in keys):
        words = f"{prefix!r}: letters, digits, - and _ are needed, and not hyperbit, the prefix of running daemons"
        raise InputFaults(Path("--prefix"), [words])


@contextlib.contextmanager
def opened_recording(file: Path) -> Iterator[RecordingReader]:
    """Opens a recording; warns if it is incomplete. One that is found damaged inside the context ends the command."""
    from hyperbit.controller.recorder.reader import RecordingReader
    from hyperbit.controller.recorder.repair import BadRecording

    try:
        past = RecordingReader(file)
    except BadRecording as error:
        raise InputFaults(file, [str(error).removeprefix(f"{file}: ")]) from None
    with contextlib.closing(past):
        if not past.whole:
            common.errors.print(f"{file} is incomplete: its readable part is replayed")
        try:
            yield past
        except BadRecording as error:
            raise CommandFailed(str(error)) from None


def play(
    past: RecordingReader, config: zenoh.Config, endpoint: str, prefix: str, timeline: Timeline, *, stay: bool
) -> None:
    """Publishes a recording again, until its end or SIGTERM; `stay`: it continues after the recording's end."""
    from hyperbit.controller.recorder.player import Player

    ending = ending_event()
    with open_zenoh(config) as session, contextlib.closing(Player(past, session, prefix, timeline)) as player:
        what = f"{timeline.end - timeline.begin:.0f} s of {past.arm} on {prefix}/{past.arm}"
        common.console.print(f"replaying {what} at {endpoint}")
        player.play(ending.is_set, stay=stay)


def compare_goals(past: RecordingReader, file: Path | None, as_json: bool) -> None:
    """Sends the recorded goals to a simulated arm and prints how their configurations compare."""
    from hyperbit.controller.recorder.regression import ArmFailed, Compared, compare

    if file is not None:
        common.load_wired(file)
        if (name := arm_name(str(file))) != past.arm:
            raise InputFaults(file, [f"the file describes the arm {name!r}, the recording is of {past.arm!r}"])
    counts = {"equal": 0, "differs": 0, "unproven": 0, "skipped": 0}

    def show(it: Compared) -> None:
        counts[it.outcome] += 1
        line: dict[str, Any] = {"goal": it.id, "outcome": it.outcome, "reason": it.reason or None}
        if as_json:
            print_json(line)
        elif it.outcome != "equal":
            common.console.print(f"goal {it.id} {it.outcome}: {it.reason}")

    try:
        compare(past, file, show)
    except ArmFailed as error:
        raise CommandFailed(str(error)) from None
    if not as_json:
        words = f"{counts['equal']} goals led to the same configurations, {counts['differs']} to others;"
        words += f" {counts['unproven']} differ, but were not proven optimal; {counts['skipped']} cannot be compared"
        common.console.print(words)
    if counts["differs"] or not counts["equal"]:
        raise CommandFailed("no recorded goal can be compared" if not counts["differs"] else "configurations differ")
