"""The command `run`: what it sets in its process. What it serves is tested in tests/gateway and tests/system."""

import subprocess
import sys

MEASURE = """
import re
import numpy as np
from pathlib import Path
from controller.commands.run import return_large_blocks

def resident():
    return int(re.search(r"RssAnon:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]) / 1024  # [MiB]

SETUP
np.ones(30 << 17)  # glibc keeps smaller blocks from now on
begun = resident()
blocks = [np.ones(1 << 17) for _ in range(40)]  # of 1 MiB
del blocks
print(resident() - begun)
"""


def left(setup: str) -> float:
    """Returns how much memory a process keeps that has freed 40 MiB in large blocks [MiB]."""
    words = [sys.executable, "-c", MEASURE.replace("SETUP", setup)]
    return float(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


def test_large_blocks_are_returned_to_the_system() -> None:
    assert left("return_large_blocks()") < 8
    assert left("") > 30, "what this protects from is gone"
