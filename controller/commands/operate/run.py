"""The command `run`: runs the daemon of an arm."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.terminals import named_boards
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmFile, BoardKinds, Listen, Wired, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, densities_of, load_wired
from hyperbit.controller.commands.connection import zenoh_config
from hyperbit.controller.commands.process import ending_event
from hyperbit.controller.host.files import read_file
from hyperbit.controller.network.endpoints import wait_for_router

if TYPE_CHECKING:
    import zenoh

SOCKET = "Socket of a running executor, or its folder. Default: this command starts an executor."
SIMULATE = (
    "Use simulated boards, inside the executor. Faults can be typed, or played by `fault`; `fault --help` names them."
    " With --socket: the executor there simulates its boards."
)
TYPED = "the boards are simulated: type a fault, such as silence can0/5; help names all"
INPUT = 0  # file descriptor of the standard input
CONNECT = "Zenoh router to join, such as rmw_zenohd, instead of accepting connections; waits until it is there."
LEDGER = "File of the ledger, which counts goals and switches; the switch journal is written beside it."
PANEL = "Also serve the operator's web page at this port of 127.0.0.1, by default 7480, and print its address."
POLL = 0.2  # [s] between two checks that executor and planner still run
M_MMAP_THRESHOLD = -3  # of glibc's malloc.h
LARGE = 1 << 17  # [bytes]


def run(
    file: ArmFile,
    simulate: Annotated[bool, typer.Option("--simulate", help=SIMULATE)] = False,
    board: BoardKinds = [],  # noqa: B006  # typer needs a list
    wired: Wired = None,
    socket: Annotated[Path | None, typer.Option(help=SOCKET, show_default=False)] = None,
    listen: Listen = ENDPOINT,
    connect: Annotated[str | None, typer.Option(help=CONNECT, show_default=False)] = None,
    zenoh_file: ZenohFile = None,
    ledger: Annotated[Path | None, typer.Option(help=LEDGER)] = None,
    panel: Annotated[
        int | None, typer.Option(metavar="[PORT]", min=0, max=65535, help=PANEL, show_default=False)
    ] = None,
) -> None:
    """Run the daemon until SIGTERM: it takes goals over Zenoh and moves the arm by an executor."""
    check_options(board, wired, socket, zenoh_file, simulate=simulate, panel=panel is not None)
    if connect is not None and zenoh_file is not None:
        raise InputFaults(Path("run"), ["give either --connect or --zenoh, whose file can name the router"])
    # Its faults are told before the executor starts. Peers do not hear each other through a router, clients do.
    if connect is not None:
        config = zenoh_config(None, connect=connect)
    else:
        config = zenoh_config(zenoh_file, mode="peer", listen=listen)
    prepare_process()
    boards = board if simulate else None
    if simulate and socket is None and os.isatty(INPUT):
        typer.echo(TYPED)
    with started_executor(file, socket, ledger, boards, wired) as executor, started_page(connect or listen, panel):
        serve(file, executor, config, connect, ledger, simulated=simulate)


class RunningExecutor(NamedTuple):
    """The executor at a socket. `ended`: exit code of one that this command started; None while it runs."""

    path: Path
    ended: Callable[[], int | None]


def check_options(
    board: list[str], wired: Path | None, socket: Path | None, zenoh_file: Path | None, *, simulate: bool, panel: bool
) -> None:
    if board and socket is not None:
        raise InputFaults(Path("run"), ["give --board to the executor at --socket, not to this command"])
    if wired is not None and (not simulate or socket is not None):
        raise InputFaults(Path("run"), ["--wired is for boards that this command simulates: give --simulate"])
    if board and not simulate:
        raise InputFaults(Path("run"), ["--board is for simulated boards: give --simulate as well"])
    if panel and zenoh_file is not None:
        raise InputFaults(Path("run"), ["with --zenoh start the page separately: hyperbit panel --zenoh FILE"])


def prepare_process() -> None:
    """Sets the process's time slices, so that a stop waits for no thread that plans, and its use of memory."""
    from hyperbit.controller.host.scheduling import shorten_slice

    sys.setswitchinterval(0.0005)  # a stop must not wait 5 ms for each thread that plans
    return_large_blocks()
    shorten_slice()  # a stop waits less for other processes


@contextlib.contextmanager
def started_executor(
    file: Path, socket: Path | None, ledger: Path | None, boards: list[str] | None, wired: Path | None = None
) -> Iterator[RunningExecutor]:
    """Starts an executor, unless one is running at `socket`; ends it at the end. `boards`: kinds of the simulated ones.

    `wired`: file that says how these are wired. The boards boot while this process loads the kernels.
    """
    from hyperbit.controller.armfile.actuators import ending_time, read_wired
    from hyperbit.controller.commands.operate.executor_process import END_TIMEOUT, end_child, start_executor
    from hyperbit.controller.host.journal import start_logging
    from hyperbit.controller.host.sockets import socket_path

    settings, actuators, _ = read_wired(file)
    start_logging({"HYPERBIT_ARM": settings.name})
    if boards:  # the kinds of boards need canopen, which takes 8 MB
        from hyperbit.controller.commands.operate.simulate import variants_of

        variants_of(boards, [f"{bus}/{node}" for bus, node in sorted(named_boards(settings))])
    path = socket_path(socket, settings.name)
    if socket is not None:
        yield RunningExecutor(path, lambda: None)
        return
    words = [str(file), "--socket", str(path), *(f"--board={word}" for word in boards or [])]
    words += [] if wired is None else [f"--wired={wired}"]
    words += [] if ledger is None else ["--journal", str(ledger.with_name(f"{ledger.stem}.switches"))]  # its own counts
    executor = start_executor(words, simulate=boards is not None)
    try:
        yield RunningExecutor(path, executor.poll)
    finally:
        end_child(executor, END_TIMEOUT + ending_time(settings, len(actuators)))


@contextlib.contextmanager
def started_page(endpoint: str, port: int | None) -> Iterator[None]:
    """Serves the operator's page for a daemon or router at a Zenoh endpoint; no page if `port` is None."""
    from hyperbit.controller.commands.operate.executor_process import end_child, start_child

    if port is None:
        yield
        return
    words = ["panel", "--connect", reachable(endpoint), "--listen", f"127.0.0.1:{port}"]
    page = start_child([sys.executable, "-m", "hyperbit", *words])
    try:
        yield
    finally:
        end_child(page)


def return_large_blocks() -> None:
    """Has the C library return each large block of memory to the system when it is freed.

    By default glibc keeps all blocks smaller than the largest one freed so far, up to 32 MiB: plans of whole
    trajectories left 30 MiB in the daemon. Other C libraries are not changed.
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
    executor: RunningExecutor,
    config: zenoh.Config,
    router: str | None,
    ledger: Path | None,
    *,
    simulated: bool,
) -> None:
    """Serves an arm until a signal arrives, or until the executor that this command started ends.

    `config` is that of the session with the clients; `router`: endpoint of the router that the daemon joins, if any.
    """
    from hyperbit.controller.gateway.claim import AlreadyRunning
    from hyperbit.controller.gateway.daemon import running
    from hyperbit.controller.host.keeper import FileInUse
    from hyperbit.controller.host.output import flush_outputs
    from hyperbit.controller.network.reach import NoSession
    from hyperbit.controller.planning.ledger_file import default_path

    arm = load_wired(file)
    digest = hashlib.sha256(read_file(file)).hexdigest()
    densities = densities_of(arm)
    book = ledger or default_path(arm.settings.name, simulated=simulated)
    ending = ending_event()  # before the first goal, so that an early signal ends goals in order
    try:
        if router is not None:
            wait_for_router(router, ending)
            if ending.is_set():
                return
        with running(arm, densities, digest, config, book, executor.path, simulated=simulated) as daemon:
            while not ending.wait(POLL):
                flush_outputs()
                if daemon.failure is not None:
                    raise CommandFailed(f"{daemon.failure}: the log has details")
                if (code := executor.ended()) is not None:
                    raise CommandFailed(f"the executor ended with code {code}: its messages are above")
    except (AlreadyRunning, FileInUse) as error:
        raise CommandFailed(str(error)) from None
    except NoSession as error:
        raise CommandFailed(str(error), error.step) from None
