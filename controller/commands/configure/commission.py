"""The command `commission`: moves each actuator of a new arm once there and back, and asks what was seen."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from msgspec.structs import replace

from hyperbit.controller.armfile.actuators import read_wired
from hyperbit.controller.armfile.commissioned import Sighting
from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmFile, BoardKinds, Wired
from hyperbit.controller.commands.common import CommandFailed, console
from hyperbit.controller.commands.configure.commission_desk import LEAVE, Desk, Left, Withdrawn
from hyperbit.controller.commands.configure.commission_report import conclude
from hyperbit.controller.commands.configure.executor_absence import answers
from hyperbit.controller.commands.connection import open_zenoh, zenoh_config
from hyperbit.controller.commands.operate.executor_process import end_child, start_executor
from hyperbit.controller.commission.driver import BEGIN_WITHIN, Commissioner, NoDriver
from hyperbit.controller.commission.questions import Choice
from hyperbit.controller.commission.session import Session
from hyperbit.controller.host.files import read_file
from hyperbit.controller.host.sockets import socket_path
from hyperbit.controller.program import MOST_WATCH, Snapshot, unpack

if TYPE_CHECKING:
    import zenoh

ONLY = "Only these actuators, such as 5.left, also if they were tried before. Default: those that were not."
SIMULATE = "Use simulated boards, inside an executor of this command."
SOCKET = "Socket of a running executor, or its folder. Default: the arm's; without one this command starts an executor."
WATCH = "Time for which the inputs are watched after each command [s]; longer than any travel."
PLANNER = "end the planner, so that only you move the arm: sudo systemctl stop hyperbit@INSTANCE, or Ctrl-C of `run`"
STARTED_WITHIN, READY_WITHIN = 20.0, 150.0  # [s]; boards may boot for 120 s
LISTEN = "With --page: Zenoh endpoint to accept connections at."
ZENOH = "With --page: Zenoh configuration file of the daemon, instead of an endpoint."
PAGE = "Ask on the operator's page, too. A panel that shows the arm of the daemon shows the questions."
VERBS = ("contract", "extend")
SEEN = (Choice("e", "extended"), Choice("c", "contracted"), Choice("n", "nothing"), Choice("a", "again"), LEAVE)
LAMPS = (
    *(Choice("n", "none"), Choice("e", "of extend"), Choice("c", "of contract"), Choice("b", "both")),
    *(Choice("u", "unknown"), LEAVE),
)
LIT = {"n": (0, 0), "e": (1, 0), "c": (0, 1), "b": (1, 1), "u": None}


def commission(
    file: ArmFile,
    actuators: Annotated[list[str] | None, typer.Argument(metavar="ACTUATOR", help=ONLY, show_default=False)] = None,
    simulate: Annotated[bool, typer.Option("--simulate", help=SIMULATE)] = False,
    board: BoardKinds = [],  # noqa: B006  # typer needs a list
    wired: Wired = None,
    socket: Annotated[Path | None, typer.Option(help=SOCKET, show_default=False)] = None,
    watch: Annotated[float, typer.Option(min=0.1, max=MOST_WATCH, help=WATCH)] = 1.0,
    page: Annotated[bool, typer.Option("--page", help=PAGE)] = False,
    listen: Annotated[str, typer.Option(help=LISTEN)] = ENDPOINT,
    zenoh_file: Annotated[Path | None, typer.Option("--zenoh", help=ZENOH, show_default=False)] = None,
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
    chosen, desk = actuators or list(labels), Desk(labels, pages=page)
    place = zenoh_config(zenoh_file, mode="peer", listen=listen) if page else None
    try:
        with (
            driven(file, settings, socket, words, simulate=simulate) as driver,
            on_pages(place, settings, labels, driver, desk),
        ):
            desk.check = driver.check
            warn(settings)
            walk(driver, session, chosen, watch, desk)
            conclude(file, settings, session, desk)
    except (Left, KeyboardInterrupt) as left:
        console.print(f"\nleft; the arm holds. `hyperbit commission {file}` continues here")
        raise typer.Exit(130 if isinstance(left, KeyboardInterrupt) else 1) from None
    except NoDriver as error:
        raise CommandFailed(str(error), PLANNER if "planner is connected" in str(error) else "") from None


@contextlib.contextmanager
def on_pages(
    place: zenoh.Config | None, settings: ArmSettings, labels: Sequence[str], driver: Commissioner, desk: Desk
) -> Iterator[None]:
    """Serves the questions to pages, at a place in the network; None: only this terminal is asked."""
    if place is None:
        yield
        return
    from hyperbit.controller.gateway.claim import AlreadyRunning
    from hyperbit.controller.gateway.commission import Served, serving

    with open_zenoh(place) as session:
        try:
            with serving(session, Served(settings, labels, driver, desk.questions)):
                console.print("Pages that show this arm ask the same questions; the first answer counts.")
                yield
        except AlreadyRunning as error:
            raise CommandFailed(str(error)) from None


@contextlib.contextmanager
def driven(
    file: Path, settings: ArmSettings, socket: Path | None, words: list[str], *, simulate: bool
) -> Iterator[Commissioner]:
    """Yields the drive of an arm by a running executor, or by one that ends with this command, while it still holds."""
    path, digest = socket_path(socket, settings.name), hashlib.sha256(read_file(file)).hexdigest()
    if socket is not None or (not simulate and answers(path, settings.name)):
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


def walk(driver: Commissioner, session: Session, chosen: list[str], watch: float, desk: Desk) -> None:
    """Tries each actuator that is still open, in both directions; pairs that moved nothing once more."""
    labels = list(session.entries)
    while todo := [label for label in session.todo() if label in chosen]:
        for count, label in enumerate(todo, 1):
            entry = session.entries[label]
            desk.begin(f"{count} of {len(todo)}: {label}, {entry.bus}/{entry.node} output {shown(entry.output)}")
            first = 1 - (unpack(ready(driver, desk).outputs) >> labels.index(label) & 1)
            for state in (first, 1 - first):
                session.add(look(driver, session, label, state, watch, desk))


def look(driver: Commissioner, session: Session, label: str, state: int, watch: float, desk: Desk) -> Sighting:
    """Moves an actuator after a key press; returns what the inputs and the person tell of it.

    After a trial that a fault has ended, or that is wanted again, the actuator is there already: it goes back first.
    """
    number, verb = list(session.entries).index(label), VERBS[state]
    while True:
        at = ready(driver, desk)
        if unpack(at.outputs) >> number & 1 == state:
            desk.say(f"{label} was told to {verb} before: it goes back first")
            session.add(look(driver, session, label, 1 - state, watch, desk))
            continue
        epoch, same = at.epoch, partial(driver.is_ready, at.epoch)
        with contextlib.suppress(Withdrawn):
            desk.ask(f"ready to {verb} {label}", (Choice("", verb, hold=True), LEAVE), stands=same)
            ended = driver.run(number, state, watch, epoch, time.monotonic() + BEGIN_WITHIN)
            if isinstance(ended, str) or ended.status != "done":
                desk.say(f"not tried: {ended if isinstance(ended, str) else ended.message}")
                continue
            seen = session.sighting(label, state, ended)
            changes = ", ".join(f"{it.line} to {it.level} after {1000 * it.seconds:.0f} ms" for it in seen.changes)
            desk.say(f"inputs: {changes or 'no change'}")
            if (answer := answered(session, seen, desk)) is not None:
                return answer


def answered(session: Session, seen: Sighting, desk: Desk) -> Sighting | None:
    """Returns a sighting with what the person saw; None: the motion is wanted again."""
    told = desk.ask(f"{seen.actuator} was told to {VERBS[seen.state]}; what was seen", SEEN, others=True)
    if told == "a":
        return None
    label, _, end = told.rpartition(" ")
    if told != "n":
        seen = replace(seen, moved=label or seen.actuator, to=int(end == "e"))
    odd = seen.moved is None or (seen.moved == seen.actuator and seen.to != seen.state)
    if odd and session.entries[seen.actuator].output_off is not None:
        seen = replace(seen, lamps=LIT[desk.ask("lamps that are lit at its valve now", LAMPS)])
    return seen


def ready(driver: Commissioner, desk: Desk) -> Snapshot:
    """Waits until the arm is ready and at rest; a person resets a fault or a stop. Returns its state."""
    while (snapshot := driver.ready(READY_WITHIN)).mode != "ready":
        desk.say(f"the arm is {snapshot.mode}: {snapshot.reason}")
        desk.ask("nothing moves by a reset", (Choice("r", "reset", hold=True), LEAVE))
        desk.say(driver.reset().message)
    return snapshot


def shown(bit: object) -> str:
    return str(getattr(bit, "bit", bit))
