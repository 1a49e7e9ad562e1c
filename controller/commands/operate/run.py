"""The command `run`: runs the daemon of an arm."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from controller.armfile.strict import InputFaults
from controller.commands.common import ENDPOINT, ArmFile, CommandFailed, ZenohFile, densities_of, load_wired

SOCKET = "Socket of a running executor, or its folder. Default: this command starts an executor."
KIND = "Kind of the simulated boards; see `simulate --help`."
LEDGER = "File of the ledger, which counts goals and switches; the switch journal is written beside it."
POLL = 0.2  # [s] between two checks that executor and planner still run
SIGNALS = (signal.SIGTERM, signal.SIGINT)
M_MMAP_THRESHOLD = -3  # of glibc's malloc.h
LARGE = 1 << 17  # [bytes]


def run(
    file: ArmFile,
    simulate: Annotated[bool, typer.Option("--simulate", help="Use simulated boards, inside the executor.")] = False,
    board: Annotated[list[str], typer.Option(metavar="[BOARD=]KIND", help=KIND, show_default=False)] = [],  # noqa: B006  # typer needs a list
    socket: Annotated[Path | None, typer.Option(help=SOCKET, show_default=False)] = None,
    listen: Annotated[str, typer.Option(help="Zenoh endpoint to accept connections at.")] = ENDPOINT,
    zenoh_file: ZenohFile = None,
    ledger: Annotated[Path | None, typer.Option(help=LEDGER)] = None,
    panel: Annotated[
        bool, typer.Option("--panel", help="Also serve the operator's web page, and print its address.")
    ] = False,
) -> None:
    """Run the daemon until SIGTERM: it takes goals over Zenoh and moves the arm by an executor."""
    if simulate and socket is not None:
        raise InputFaults(Path("run"), ["give --simulate to the executor at --socket, not to this command"])
    if board and not simulate:
        raise InputFaults(Path("run"), ["--board is for simulated boards: give --simulate as well"])
    if panel and zenoh_file is not None:
        raise InputFaults(Path("run"), ["with --zenoh start the page separately: hyperbit panel --zenoh FILE"])
    sys.setswitchinterval(0.0005)  # a stop must not wait 5 ms for each thread that plans
    return_large_blocks()

    from controller.armfile.actuators import ending_time, read_wired
    from controller.commands.operate.executor_process import END_TIMEOUT, ExecutorProcess, end_child, start_child
    from controller.host.journal import start_logging
    from controller.host.scheduling import shorten_slice
    from controller.host.sockets import socket_path

    shorten_slice()  # shorter time slices of this process's threads: a stop waits less for other processes
    settings, actuators, _ = read_wired(file)
    start_logging({"HYPERBIT_ARM": settings.name})
    path = socket_path(socket, settings.name)
    with contextlib.ExitStack() as stack:
        executor = None
        if socket is None:  # before the kernels are loaded, so that the boards boot meanwhile
            journal = ledger and ledger.with_name(f"{ledger.stem}.switches")  # a ledger has its own counts
            executor = ExecutorProcess(file, path, simulate=simulate, journal=journal, board=board)
            stack.callback(executor.close, END_TIMEOUT + ending_time(settings, len(actuators)))
        if panel:
            page = [sys.executable, "-m", "controller.cli", "panel", "--connect", reachable(listen)]
            stack.callback(end_child, start_child(page))
        serve(file, path, executor.ended if executor else lambda: None, listen, zenoh_file, ledger)


def return_large_blocks() -> None:
    """Has the C library return each large block of memory to the system when it is freed.

    glibc does so at first, but once it has freed a block of some size it keeps all smaller ones, up to 32 MiB: plans of
    whole trajectories left 30 MiB in the daemon. Other C libraries are left as they are.
    """
    if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):
        mallopt(M_MMAP_THRESHOLD, LARGE)


def reachable(listen: str) -> str:
    """Returns the endpoint by which a process of this computer connects to a listening endpoint."""
    for every in ("/0.0.0.0:", "/[::]:"):
        listen = listen.replace(every, "/127.0.0.1:")
    return listen


def serve(
    file: Path,
    path: Path,
    ended: Callable[[], int | None],
    listen: str,
    zenoh_file: Path | None,
    ledger: Path | None,
) -> None:
    """Serves an arm until a signal arrives, or until the executor that this command started ends.

    Args:
        file: the arm's file.
        path: socket of the executor.
        ended: returns the exit code of the started executor; None while it runs, or if none was started.
        listen: Zenoh endpoint.
        zenoh_file: Zenoh configuration, instead of the endpoint.
        ledger: path of the ledger; None: the default path.

    Raises:
        CommandFailed: executor or planner ended, there is no Zenoh session, or another daemon serves the arm.
        InputFaults: the arm's file or the Zenoh configuration is wrong.
    """
    import zenoh

    from controller.gateway.claim import AlreadyRunning
    from controller.gateway.daemon import running
    from controller.network import session
    from controller.planning.ledger import LedgerInUse
    from controller.planning.ledger_file import default_path

    arm = load_wired(file)
    try:
        config = session.from_file(zenoh_file) if zenoh_file else session.configuration("peer", listen=listen)
    except ValueError as error:
        raise InputFaults(Path("--zenoh"), [str(error)]) from None
    densities = densities_of(arm)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    book, ending = ledger or default_path(arm.settings.name), threading.Event()
    try:
        for number in SIGNALS:  # before the first goal, so that an early signal ends goals in order
            signal.signal(number, lambda *_: ending.set())
        with running(arm, densities, config, book, path, digest) as daemon:
            while not ending.wait(POLL):
                if daemon.failure is not None:
                    raise CommandFailed(f"{daemon.failure}: the log has details")
                if (code := ended()) is not None:
                    raise CommandFailed(f"the executor ended with code {code}: its messages are above")
    except (AlreadyRunning, LedgerInUse) as error:
        raise CommandFailed(str(error)) from None
    except zenoh.ZError as error:
        raise CommandFailed(f"no Zenoh session at {zenoh_file or listen}: {session.reason(error)}") from None
