"""A process that forks commands of hyperbit, for all processes of the tests: `python -m tests.system.stack.nursery`.

Its arguments are the path of its socket, and "executor", "planner", or "hyperbit" for all commands; what these need is
imported once. The arms' files that follow are prepared once, too. A packet on a connection starts a command: its
arguments, folder and environment as a list in JSON, and its standard streams. Two packets come back: the id of the
process, and its exit code, which is negative after a signal. For executor and planner, the interface "virtual" of arms'
files is the emulated one. In the environment, CLOCK names a file with the seconds by which the system's clock is ahead,
and NOHUP lets the command ignore SIGHUP from its start.
"""

import contextlib
import ctypes
import importlib
import json
import os
import signal
import socket
import sys
import time
from pathlib import Path

import can.interfaces

from hyperbit.controller.host.output import Output
from tests import emulated  # noqa: F401

true_time = time.time
PR_SET_PDEATHSIG = 1  # of linux/prctl.h
NEEDED = {
    "executor": ("hyperbit.controller.executor.__main__",),
    "planner": (
        "hyperbit.controller.commands.operate.run",
        "hyperbit.controller.gateway.daemon",
        "filterpy.kalman",
        "tests.system.stack.patience",
    ),
    "hyperbit": (
        "hyperbit.controller.cli",
        "hyperbit.controller.commands.operate.run",
        "hyperbit.controller.commands.operate.router",
        "hyperbit.controller.commands.serve.panel",
        "hyperbit.controller.commands.serve.record",
        "hyperbit.controller.commands.serve.replay",
        "hyperbit.controller.commands.serve.ros2",
        "hyperbit.controller.executor.__main__",
        "hyperbit.controller.gateway.daemon",
        "hyperbit.controller.library.solver",
        "hyperbit.controller.panel.serve",
        "hyperbit.controller.recorder.recorder",
        "hyperbit.controller.ros2.bridge",
        "filterpy.kalman",
        "matplotlib.pyplot",
    ),
}
MOST_BYTES = 1 << 18  # of a packet


def execute(arguments: list[str]) -> int:
    from hyperbit.controller.executor.__main__ import main

    return main(arguments)


def run(arguments: list[str]) -> int:
    import typer

    from hyperbit.controller.commands.operate.run import run

    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    single.command("run")(run)
    single(arguments)
    return 0


def hyperbit(arguments: list[str]) -> int:
    from hyperbit.controller import cli

    sys.argv = ["hyperbit", *arguments]
    cli.main()
    return 0


def wall() -> float:
    ahead = os.environ.get("CLOCK")
    return true_time() + (float(Path(ahead).read_text()) if ahead else 0.0)


COMMANDS = {"executor": execute, "planner": run, "hyperbit": hyperbit}


def prepare(file: Path) -> None:
    from hyperbit.controller.arm.arm import load
    from hyperbit.controller.commands.common import densities_of
    from hyperbit.controller.search.solver import Solver

    arm = load(file)
    Solver(arm.reduced, densities_of(arm, silent=True)).prepare()


def become(kind: str, arguments: list[str], folder: str, environment: dict[str, str], streams: list[int]) -> None:
    """Runs a command in this process, which ends with the nursery."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGCHLD])
    os.setpgid(0, 0)  # not a session of its own: Linux 6.18 lets such a process wait for seconds on a busy machine
    for target, stream in enumerate(streams):
        os.dup2(stream, target)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    signal.signal(signal.SIGHUP, signal.SIG_IGN if "NOHUP" in environment else signal.SIG_DFL)
    code = 70  # an internal error
    try:
        code = COMMANDS[kind](arguments)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(Exception):
                stream.flush()
                if isinstance(stream.buffer, Output):
                    stream.buffer.finish()
        os._exit(code)


class Ended:
    """Tells the exit codes of commands, then reaps the commands.

    Attributes:
        told: connections by the ids of processes.
    """

    def __init__(self) -> None:
        self.told: dict[int, socket.socket] = {}

    def __call__(self, *_: object) -> None:
        with contextlib.suppress(ChildProcessError):
            while found := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOWAIT | os.WNOHANG):
                code = found.si_status if found.si_code == os.CLD_EXITED else -found.si_status
                with self.told.pop(found.si_pid) as there, contextlib.suppress(OSError):  # nobody may want to know it
                    there.send(b"%d" % code)
                os.waitpid(found.si_pid, 0)


def main(path: str, kind: str, *files: str) -> None:
    prctl, ended = ctypes.CDLL(None).prctl, Ended()
    prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # this process ends with its creator
    time.time = wall  # before the imports, which make defaults of it
    if kind != "hyperbit":  # whose executors simulate the boards themselves
        can.interfaces.BACKENDS["virtual"] = ("tests.emulated", "EmulatedBus")
    for name in NEEDED[kind]:
        importlib.import_module(name)
    for file in files:
        prepare(Path(file))
    signal.signal(signal.SIGCHLD, ended)
    here = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    here.bind(f"{path}~")
    here.listen(100)
    os.rename(f"{path}~", path)  # it is there when it listens
    while True:
        there = here.accept()[0]
        order, streams, _, _ = socket.recv_fds(there, MOST_BYTES, 3)
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCHLD])  # until it is known whose end that is
        child = os.fork()
        if child == 0:
            prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
            for connection in (here, there, *ended.told.values()):
                connection.close()
            become(kind, *json.loads(order), streams)
        for stream in streams:
            os.close(stream)
        ended.told[child] = there
        there.send(b"%d" % child)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGCHLD])


if __name__ == "__main__":
    main(*sys.argv[1:])
