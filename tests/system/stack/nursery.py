"""A process that forks commands of hyperbit, so that a test can start many: `python -m tests.system.stack.nursery`.

The argument is "executor", "planner", or "hyperbit" for all commands; what these need is imported once. The arms' files
that follow are prepared once, too. Each line on standard input starts a command: its arguments, its log file and its
environment as a list in JSON; the id of its process is printed. For executor and planner, the interface "virtual" of
arms' files is the emulated one. In the environment, CLOCK names a file with the seconds by which the system's clock is
ahead, ENDED the file for the exit code, by default LOG.code, and NOHUP lets the command ignore SIGHUP from its start.
"""

import contextlib
import ctypes
import importlib
import json
import os
import signal
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
        "hyperbit.controller.panel.serve",
        "hyperbit.controller.recorder.recorder",
        "hyperbit.controller.ros2.bridge",
        "filterpy.kalman",
    ),
}


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


def become(kind: str, arguments: list[str], log: str, environment: dict[str, str]) -> None:
    """Runs a command in this process, which ends with the nursery."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGCHLD])
    os.setpgid(0, 0)  # not a session of its own: Linux 6.18 lets such a process wait for seconds on a busy machine
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for number, target in ((nothing, 0), (file, 1), (file, 2)):
        os.dup2(number, target)
    os.environ |= environment
    signal.signal(signal.SIGHUP, signal.SIG_IGN if "NOHUP" in environment else signal.SIG_DFL)
    code = 70  # an internal error
    try:
        code = COMMANDS[kind](arguments)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
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
    """Writes the exit codes of commands to files, then reaps the commands."""

    def __init__(self) -> None:
        self.files: dict[int, str] = {}

    def __call__(self, *_: object) -> None:
        with contextlib.suppress(ChildProcessError):
            while found := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOWAIT | os.WNOHANG):
                code = found.si_status if found.si_code == os.CLD_EXITED else -found.si_status
                with contextlib.suppress(OSError):  # the folder is gone
                    Path(self.files.pop(found.si_pid)).write_text(str(code))
                os.waitpid(found.si_pid, 0)


def main(kind: str, *files: str) -> None:
    time.time = wall  # before the imports, which make defaults of it
    if kind != "hyperbit":  # whose executors simulate the boards themselves
        can.interfaces.BACKENDS["virtual"] = ("tests.emulated", "EmulatedBus")
    for name in NEEDED[kind]:
        importlib.import_module(name)
    for file in files:
        prepare(Path(file))
    prctl, ended = ctypes.CDLL(None).prctl, Ended()
    signal.signal(signal.SIGCHLD, ended)
    print("ready", flush=True)
    for line in sys.stdin:
        order = json.loads(line)
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCHLD])  # until it is known whose end that is
        child = os.fork()
        if child == 0:
            prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
            become(kind, *order)
        ended.files[child] = order[2].get("ENDED", f"{order[1]}.code")
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGCHLD])
        print(child, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
