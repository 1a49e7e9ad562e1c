"""The lock of a CAN interface, between processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hyperbit.drivers.canopen.wire.bus import InterfaceInUse, lock_interface

ROOT = Path(__file__).parents[4]
OWNER = """
from hyperbit.drivers.canopen.wire.bus import lock_interface
lock = lock_interface({channel!r})
print("owns", flush=True)
input()
"""


def test_one_process_owns_an_interface_until_it_ends() -> None:
    channel = "can-of-a-test"
    owner = subprocess.Popen(
        [sys.executable, "-c", OWNER.format(channel=channel)],
        cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    with owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "owns\n"
        with pytest.raises(InterfaceInUse, match=f"process {owner.pid} of hyperbit uses {channel}: stop it first"):
            lock_interface(channel)
        lock_interface("another-can").close()
        owner.kill()
    lock_interface(channel).close()
