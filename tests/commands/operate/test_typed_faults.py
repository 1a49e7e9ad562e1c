"""Lines typed into the terminal of `hyperbit run --simulate` reach the executor in its own process group."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PARENT = """
import os, subprocess, sys, threading
from hyperbit.controller.commands.operate.executor_process import pass_lines, start_child

if os.isatty(0):
    import fcntl, termios
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
child = start_child([sys.executable, "-c", "print(input(), input(), flush=True)"], stdin=subprocess.PIPE)
threading.Thread(target=pass_lines, args=(child.stdin,), daemon=True).start()
sys.exit(child.wait())
"""
LINES = b"silence can0/5\nhelp\n"


@pytest.mark.parametrize("kind", ["terminal", "pipe"])
def test_typed_lines_reach_the_child(kind: str) -> None:
    reader, writer = os.openpty()[::-1] if kind == "terminal" else os.pipe()
    with subprocess.Popen(
        [sys.executable, "-c", PARENT], stdin=reader, stdout=subprocess.PIPE, start_new_session=True
    ) as parent:
        os.close(reader)
        os.write(writer, LINES)
        out, _ = parent.communicate(timeout=60)
    os.close(writer)
    assert (parent.returncode, out) == (0, b"silence can0/5 help\n")
