"""The command `commission`: moves each actuator of a new arm once there and back, and asks what was seen."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from hyperbit.controller.armfile.actuators import read_wired
from hyperbit.controller.armfile.commissioned import Sighting
from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.arguments import ArmFile, BoardKinds, Wired
from hyperbit.controller.commands.common import CommandFailed, console
from hyperbit.controller.commands.configure.commission_report import conclude
from hyperbit.controller.commands.operate.executor_process import end_child, start_executor
from hyperbit.controller.commission.driver import Commissioner, NoDriver
from hyperbit.controller.commission.session import Session
from hyperbit.controller.host.files import read_file
from hyperbit.controller.host.sockets import socket_path
from hyperbit.controller.program import MOST_WATCH, unpack

ONLY = "Only these actuators, such as 5.left, also if they were tried before. Default: those that were not."
SIMULATE = "Use simulated boards, inside an executor of this command."
SOCKET = "Socket of a running executor, or its folder. Default: the arm's; without one this command starts an executor."
WATCH = "Time for which the inputs are watched after each command [s]; longer than any travel."
PLANNER = "end the planner, so that only you move the arm: sudo systemctl stop hyperbit@INSTANCE, or Ctrl-C of `run`"
STARTED_WITHIN, READY_WITHIN = 20.0, 150.0  # [s]; boards may boot for 120 s
SEEN = "seen: e extended, c contracted, n nothing, or another one, as 5.left e; a again, q quit"
LAMPS = "lamps at its valve now: n none, e of extend, c of contract, b both, u unknown"
LIT = {"n": (0, 0), "e": (1, 0), "c": (0, 1), "b": (1, 1), "u": None}
ENDS = {"e": 1, "extended": 1, "c": 0, "contracted": 0}


class Left(Exception):
    """The person leaves; the arm holds."""


def commission(
    file: ArmFile,
    actuators: Annotated[list[str] | None, typer.Argument(metavar="ACTUATOR", help=ONLY, show_default=False)] = None,
    simulate: Annotated[bool, typer.Option("--simulate", help=SIMULATE)] = False,
    board: BoardKinds = [],  # noqa: B006  # typer needs a list
    wired: Wired = None,
    socket: Annotated[Path | None, typer.Option(help=SOCKET, show_default=False)] = None,
    watch: Annotated[float, typer.Option(min=0.1, max=MOST_WATCH, help=WATCH)] = 1.0,
) -> None:
    """Move each actuator there and back, one key press a motion; ask what was seen; propose the right wiring.

    No end-stop is believed meanwhile, and nothing else can move the arm. Each answer is kept beside the arm's file: the
    next call continues. q or Ctrl-C leaves at any moment, and the arm holds.
    """
    settings, labels, entries = read_wired(file)
    if unknown := [label for label in actuators or [] if label not in labels]:
        text = f"{unknown[0]!r} is no actuator of this arm, which has {labels[0]} to {labels[-1]}"
        raise InputFaults(Path("commission"), [text])
    if (board or wired is not None) and not simulate:
        raise InputFaults(Path("commission"), ["--board and --wired are for simulated boards: give --simulate as well"])
    session = Session(file, settings.name, labels, entries)
    session.forget(actuators or [])
    try:
        session.save()
    except OSError as error:
        raise InputFaults(session.path, [f"cannot be written: {error.strerror}; it keeps each answer"]) from None
    words = [*(f"--board={word}" for word in board), *([] if wired is None else [f"--wired={wired}"])]
    chosen = actuators or list(labels)
    try:
        with driven(file, settings, socket, words, simulate=simulate) as driver:
            warn(settings)
            walk(driver, session, chosen, watch)
    except (Left, KeyboardInterrupt) as left:
        console.print(f"\nleft; the arm holds. `hyperbit commission {file}` continues here")
        raise typer.Exit(130 if isinstance(left, KeyboardInterrupt) else 1) from None
    except NoDriver as error:
        raise CommandFailed(str(error), PLANNER if "planner is connected" in str(error) else "") from None
    conclude(file, settings, session, ask)


@contextlib.contextmanager
def driven(
    file: Path, settings: ArmSettings, socket: Path | None, words: list[str], *, simulate: bool
) -> Iterator[Commissioner]:
    """Yields the drive of an arm by a running executor, or by one that ends with this command, while it still holds."""
    path, digest = socket_path(socket, settings.name), hashlib.sha256(read_file(file)).hexdigest()
    if socket is not None or (path.is_socket() and not simulate):
        driver = Commissioner(path, settings.name, digest)
        try:
            yield driver
        finally:
            driver.close()
        return
    log = file.with_name(f"{file.stem}.commission.log")
    with log.open("wb") as messages:
        child = start_executor([str(file), "--socket", str(path), *words], simulate=simulate, log=messages)
    try:
        until = time.monotonic() + STARTED_WITHIN
        while True:
            if child.poll() is not None:
                told = log.read_text(errors="replace").strip()
                raise CommandFailed(f"the executor ended with code {child.returncode}: {told[-2000:]}")
            try:
                driver = Commissioner(path, settings.name, digest)
                break
            except NoDriver:
                if time.monotonic() > until:
                    raise
                time.sleep(0.1)
        yield driver
    finally:
        end_child(child)  # while the commissioner is connected: an uncommissioned arm does not contract at the end


def warn(settings: ArmSettings) -> None:
    """Says what nobody checks here, and what the boards do at the end."""
    console.print("The arm moves, one actuator at a time, without a look at obstacles. Keep the power switch at hand.")
    contract = [
        f"{it.module}.{it.actuator}"
        for it in settings.actuators
        if (it.on_loss or settings.boards.on_loss) == "contract"
    ]
    if contract:
        console.print(f"When the executor ends, the boards contract {len(contract)} actuators (on_loss: contract).")


def walk(driver: Commissioner, session: Session, chosen: list[str], watch: float) -> None:
    """Tries each actuator that is still open, in both directions; pairs that moved nothing once more."""
    labels = list(session.entries)
    while todo := [label for label in session.todo() if label in chosen]:
        for count, label in enumerate(todo, 1):
            entry = session.entries[label]
            console.print(f"\n{count} of {len(todo)}: {label}, {entry.bus}/{entry.node} output {shown(entry.output)}")
            ready(driver)
            assert driver.snapshot is not None
            first = 1 - (unpack(driver.snapshot.outputs) >> labels.index(label) & 1)
            for state in (first, 1 - first):
                session.add(look(driver, session, label, state, watch))


def look(driver: Commissioner, session: Session, label: str, state: int, watch: float) -> Sighting:
    """Moves an actuator after a key press; returns what the inputs and the person tell of it."""
    number, verb = list(session.entries).index(label), ("contract", "extend")[state]
    while True:
        if ask(f"  Enter: {verb} {label}; q quit", {"", "q"}) == "q":
            raise Left
        ended = driver.run(number, state, watch)
        if isinstance(ended, str) or ended.status != "done":
            console.print(f"  not tried: {ended if isinstance(ended, str) else ended.message}")
            ready(driver)
            continue
        seen = session.sighting(label, state, ended)
        changes = ", ".join(f"{it.line} to {it.level} after {1000 * it.seconds:.0f} ms" for it in seen.changes)
        console.print(f"  inputs: {changes or 'no change'}")
        if (answer := answered(session, seen)) is not None:
            return answer


def answered(session: Session, seen: Sighting) -> Sighting | None:
    """Returns a sighting with what the person saw; None: the motion is wanted again."""
    while True:
        words = ask(f"  {SEEN}", None).split()
        match words:
            case ["q"]:
                raise Left
            case ["a"]:
                return None
            case ["n" | "nothing"]:
                told = seen
            case [end] if end in ENDS:
                told = replace(seen, moved=seen.actuator, to=ENDS[end])
            case [label, end] if label in session.entries and end in ENDS:
                told = replace(seen, moved=label, to=ENDS[end])
            case _:
                console.print(f"  {' '.join(words)!r} is no answer: e, c, n, a, q, or an actuator and e or c")
                continue
        odd = told.moved is None or (told.moved == told.actuator and told.to != told.state)
        if odd and session.entries[seen.actuator].output_off is not None:
            told = replace(told, lamps=LIT[ask(f"  {LAMPS}", set(LIT))])
        return told


def ready(driver: Commissioner) -> None:
    """Waits until the arm is ready; a person resets a fault or a stop."""
    while (snapshot := driver.ready(READY_WITHIN)).mode != "ready":
        console.print(f"  the arm is {snapshot.mode}: {snapshot.reason}")
        if ask("  r: reset, nothing moves; q quit", {"r", "q"}) == "q":
            raise Left
        console.print(f"  {driver.reset().message}")


def ask(question: str, answers: set[str] | None) -> str:
    """Returns the answer to a question, one of `answers`; keys that were pressed before it do not count."""
    while True:
        with contextlib.suppress(ImportError, OSError):
            if os.isatty(sys.stdin.fileno()):
                import termios

                termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)
        console.print(f"{question}: ", end="")
        line = sys.stdin.readline()
        if not line:
            raise Left
        if answers is None or line.strip() in answers:
            return line.strip()
        named = ", ".join(sorted(answer or "Enter" for answer in answers))
        console.print(f"  {line.strip()!r} is no answer: {named}")


def shown(bit: object) -> str:
    return str(getattr(bit, "bit", bit))
