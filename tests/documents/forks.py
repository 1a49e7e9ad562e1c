"""A process that forks the command `hyperbit`, so that each example need not import numba, scipy and kernels again.

The process is ready once it has printed a line.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hyperbit.controller import cli

PR_SET_PDEATHSIG = 1  # of linux/prctl.h
NEEDED = (
    "hyperbit.controller.library.arm",
    "hyperbit.controller.library.solver",
    "hyperbit.controller.planning.planner",
    "matplotlib.pyplot",
)
CLIENT = """#!/bin/sh
exec {python} -IS -c 'import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as there:
    there.connect({path})
    asked = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)]).encode()
    socket.send_fds(there, [len(asked).to_bytes(8, "big")], [0, 1, 2])
    there.sendall(asked)
    code = there.recv(1)
sys.exit(code[0] if code else 70)
' "$@"
"""


@contextmanager
def forking(folder: Path) -> Iterator[str]:
    """Yields a script that does what `hyperbit` does."""
    path = folder / "socket"
    command = [sys.executable, "-c", f"from {__name__} import main; main({str(path)!r})"]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
    try:
        assert process.stdout
        assert process.stdout.readline() == b"ready\n"
        yield CLIENT.format(python=shlex.quote(sys.executable), path=json.dumps(str(path)))
    finally:
        process.kill()
        process.communicate()


def main(path: str) -> None:
    for name in NEEDED:
        importlib.import_module(name)
    prctl = ctypes.CDLL(None).prctl
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # ended children need no wait
    with socket.socket(socket.AF_UNIX) as here:
        here.bind(path)
        here.listen()
        print("ready", flush=True)
        while True:
            there, _ = here.accept()
            if os.fork() == 0:
                prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
                become(there)
            there.close()


def become(there: socket.socket) -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    head, files, _, _ = socket.recv_fds(there, 8, 3)
    asked = b""
    while len(asked) < int.from_bytes(head, "big"):
        asked += there.recv(1 << 16)
    for target, file in enumerate(files):
        os.dup2(file, target)
    words, folder, environment = json.loads(asked)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["hyperbit", *words]
    code = 70  # an internal error
    try:
        cli.main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        there.sendall(bytes([code]))
        os._exit(code)
