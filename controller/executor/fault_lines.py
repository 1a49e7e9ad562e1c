"""Faults of simulated boards, from lines on standard input."""

import os
import stat
import sys

from drivers.simulation.buses import SimulatedBuses
from drivers.simulation.fault_commands import perform

INPUT = 0  # file descriptor of the standard input


class FaultLines:
    """Reads lines when there are any, and makes the faults that they ask for.

    Attributes:
        open: whether more lines may come.

    Args:
        boards: simulated.
    """

    def __init__(self, boards: SimulatedBuses) -> None:
        self.open = readable()
        self._boards, self._rest = boards, b""

    def read(self) -> None:
        """Acts on the lines that wait; to be called when the standard input can be read."""
        data = os.read(INPUT, 4096)
        self.open = bool(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            text = line.decode(errors="replace").strip()
            if text:
                self._act(text)

    def _act(self, text: str) -> None:
        try:
            perform(self._boards, *text.split())
        except (ValueError, KeyError) as error:
            print(f"not done: {error.args[0]}", file=sys.stderr, flush=True)
        else:
            print(f"done: {text}", flush=True)


def readable() -> bool:
    """Returns whether the standard input is a pipe, or a terminal that this process may read."""
    try:
        if os.isatty(INPUT):
            return os.tcgetpgrp(INPUT) == os.getpgrp()
        return stat.S_ISFIFO(os.fstat(INPUT).st_mode)
    except OSError:
        return False
