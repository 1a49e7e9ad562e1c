"""What is attacked: by what, from where on, and how."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hypothesis import strategies as st

from tests.fuzz import frames, payloads

CORPUS = Path(__file__).with_name("corpus")

Attack = Callable[[bytes], int]


@dataclass(frozen=True)
class Target:
    """One way into the program.

    Attributes:
        build: makes what takes one input after the other; each call returns how many payloads or frames it held, and
            raises when something did not go as it must.
        seeds: right inputs, and nearly right ones.
        strategy: of hypothesis.
        spoil: changes an input with its structure in mind; None: bytes are as good.
        size: most bytes of an input.
    """

    build: Callable[[], Attack]
    seeds: list[bytes]
    strategy: st.SearchStrategy[bytes]
    spoil: Callable[[bytes, random.Random], bytes] | None = None
    size: int = 2000

    def found(self, name: str) -> list[bytes]:
        """Inputs that something once went wrong with."""
        return [path.read_bytes() for path in sorted(CORPUS.glob(f"{name}-*"))]


TARGETS = {
    "goal": Target(
        lambda: payloads.read_goal,
        [payloads.written(payloads.GOAL), payloads.written(payloads.LINE)],
        payloads.wrong(payloads.GOAL, payloads.LINE),
        payloads.spoiler(payloads.GOAL, payloads.LINE),
    ),
    "setpoint": Target(
        lambda: payloads.read_setpoint,
        [payloads.written(payloads.SETPOINT)],
        payloads.wrong(payloads.SETPOINT),
        payloads.spoiler(payloads.SETPOINT),
    ),
    "measured_tip": Target(
        lambda: payloads.read_measured_tip,
        [payloads.written(payloads.MEASURED_TIP)],
        payloads.wrong(payloads.MEASURED_TIP),
        payloads.spoiler(payloads.MEASURED_TIP),
    ),
    "degrade": Target(
        lambda: payloads.read_degrade,
        [payloads.written(payloads.DEGRADE)],
        payloads.wrong(payloads.DEGRADE),
        payloads.spoiler(payloads.DEGRADE),
    ),
    "obstacles": Target(
        lambda: payloads.read_obstacles,
        [payloads.written(payloads.OBSTACLES), payloads.written(payloads.OBSTACLES_IN_SPACE)],
        payloads.wrong(payloads.OBSTACLES, payloads.OBSTACLES_IN_SPACE),
        payloads.spoiler(payloads.OBSTACLES, payloads.OBSTACLES_IN_SPACE),
    ),
    "arm": Target(
        payloads.ReadArm,
        [
            payloads.written(payloads.ARM),
            payloads.plain(payloads.ARM),
            payloads.written(payloads.SPATIAL),
            payloads.plain(payloads.SPATIAL),
        ],
        payloads.wrong(payloads.ARM, payloads.SPATIAL),
        payloads.spoiler(payloads.ARM, payloads.SPATIAL),
        size=3000,
    ),
    "notation": Target(
        lambda: payloads.read_notation,
        [text.encode("utf-8", "surrogatepass") for text in payloads.NOTATIONS],
        payloads.notations,
        size=100,
    ),
    "daemon": Target(frames.Daemon, frames.SEEDS, frames.any_acts, size=150 * frames.SIZE),
    "board": Target(frames.Firmware, frames.SEEDS, frames.any_acts, size=150 * frames.SIZE),
}
