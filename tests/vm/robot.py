"""The robot's computer in the virtual machine: its services, its commands and its bus."""

import itertools
import os
import re
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import can

from hyperbit.controller.planning.ledger_file import read
from tests.waiting import eventually

T = TypeVar("T")

ARM = Path("/etc/hyperbit/arm.yaml")
PLANNER, EXECUTOR = "hyperbit@arm", "hyperbit-executor@arm"  # services
STATE = {PLANNER: Path("/var/lib/private/hyperbit-arms/arm/planner")}
STATE[EXECUTOR] = STATE[PLANNER].with_name("executor")
ENVIRONMENT = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}  # the tests' own kernels

# CAN identifiers (CiA 301, 7.3.5) and states of a heartbeat (7.2.8.3.2.2).
NMT, SYNC, RPDO, SDO_ANSWER, SDO_REQUEST, HEARTBEAT = 0x000, 0x080, 0x200, 0x580, 0x600, 0x700
MASTER = 127
OPERATIONAL = 5


def hyperbit(*words: str | Path, prefix: Sequence[str] = ()) -> str:
    """Runs the installed command, which must succeed; returns what it prints."""
    done = subprocess.run([*prefix, "hyperbit", *words], capture_output=True, text=True, env=ENVIRONMENT)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def ledger() -> tuple[dict[str, int], list[dict[str, Any]]]:
    return read(STATE[PLANNER] / "planar16.sqlite")


def systemctl(*words: str) -> str:
    done = subprocess.run(["systemctl", *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr + journal()
    return done.stdout


def journal() -> str:
    words = ["journalctl", "--no-pager", "-u", PLANNER, "-u", EXECUTOR]
    return subprocess.run(words, capture_output=True, text=True).stdout


def shown(service: str, name: str) -> str:
    return systemctl("show", service, "--value", "--property", name).strip()


def pid(service: str) -> int:
    """Returns the main process of a service, 0 if it does not run."""
    return int(shown(service, "MainPID"))


def eventually_shown(what: Callable[[], T]) -> T:
    """Returns the first true value of a function that runs a command: each costs the time of a service's work."""
    return eventually(what, every=0.5)


def status(service: str) -> dict[str, str]:
    text = Path(f"/proc/{pid(service)}/status").read_text()
    return dict(re.findall(r"(\w+):\s+(.*)", text))


def exposure(service: str) -> float:
    """Returns the exposure of a service by `systemd-analyze security`."""
    words = ["systemd-analyze", "security", service, "--no-pager"]
    done = subprocess.run(words, capture_output=True, text=True)
    found = re.search(rf"exposure level for {service}\.service: ([0-9.]+)", done.stdout)
    assert found, done.stdout + done.stderr
    return float(found[1])


def drain(listener: can.BusABC) -> list[can.Message]:
    frames = []
    while (frame := listener.recv(0)) is not None:
        frames.append(frame)
    return frames


def syncs(frames: Sequence[can.Message]) -> list[float]:
    """Returns when a SYNC switched the boards [UNIX s]."""
    return [frame.timestamp for frame in frames if frame.arbitration_id == SYNC]


def switches(frames: Sequence[can.Message]) -> int:
    """Returns how many output bits the frames change, on boards that all begin contracted."""
    received, outputs, count = dict[int, bytes](), dict[int, bytes](), 0
    for frame in frames:
        if RPDO < frame.arbitration_id < RPDO + 0x80:
            received[frame.arbitration_id] = bytes(frame.data)
        elif frame.arbitration_id == SYNC:
            for board, data in received.items():
                before = outputs.get(board, bytes(len(data)))
                count += sum((old ^ new).bit_count() for old, new in zip(before, data, strict=True))
                outputs[board] = data
    return count


def disturbances(frames: Sequence[can.Message], longest_gap: float) -> list[str]:
    """Returns every sign that the boards did not stay operational under the master's heartbeat.

    Args:
        longest_gap: allowed between two heartbeats of the master [s].
    """
    found, beats = [], []
    for frame in frames:
        node, state = frame.arbitration_id - HEARTBEAT, frame.data[0] if frame.data else None
        if frame.arbitration_id == NMT:
            found.append(f"NMT command {frame.data.hex()}")
        elif node == MASTER:
            beats.append(frame.timestamp)
        elif 0 < node < MASTER and state != OPERATIONAL:
            found.append(f"board {node} in state {state}")
    gaps = [later - earlier for earlier, later in itertools.pairwise(beats)]
    if max(gaps, default=longest_gap) >= longest_gap:
        found.append(f"{len(beats)} heartbeats of the master, the longest gap {max(gaps, default=0):.2f} s")
    return found
