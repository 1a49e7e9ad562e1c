"""The targets of the fuzzing, with seeds and strategies."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hypothesis import strategies as st

from tests.fuzz import frames, packets, payloads, recordings, requests
from tests.fuzz.mutations import HEAD, mutated
from tests.fuzz.readers import SAMPLES, Quiet

CORPUS = Path(__file__).with_name("corpus")

Attack = Callable[[bytes], int]


@dataclass(frozen=True)
class Target:
    """One way into the program.

    Attributes:
        build: returns a function for one input after the other. A call returns the number of payloads or frames in the
            input, and raises an exception on a failure.
        strategy: of hypothesis; None: inputs are made by `mutation` only.
        spoil: mutates an input by its structure; None: mutate bytes.
        size: most bytes of an input.
    """

    build: Callable[[], Attack]
    seeds: list[bytes]
    strategy: st.SearchStrategy[bytes] | None = None
    spoil: Callable[[bytes, random.Random], bytes] | None = None
    size: int = 2000

    def found(self, name: str) -> list[bytes]:
        """Returns inputs that once caused a failure."""
        return [path.read_bytes() for path in sorted(CORPUS.glob(f"{name}-*"))]

    def mutation(self, name: str, number: int) -> bytes:
        """Returns the mutation with a number of one of the seeds; always the same."""
        return mutated(self.seeds, random.Random(f"{name} {number}"))


def request(read: Attack, *right: object) -> Target:
    seeds = [requests.written(value) for value in right]
    return Target(lambda: read, seeds, requests.wrong(*right), requests.spoiler(*right))


def reader(name: str) -> Target:
    build, samples = SAMPLES[name]
    pairs = [(key, value) for key, values in samples.items() for value in values]
    seeds = [key.encode() + HEAD + (it if isinstance(it, bytes) else requests.written(it)) for key, it in pairs]
    return Target(lambda: Quiet(build(), starts=name == "files"), seeds)


ARMS = (requests.ARM, requests.SPATIAL)

TARGETS = {
    "goal": request(payloads.read_goal, requests.GOAL, requests.LINE, requests.CONFIGURATIONS),
    "jog": request(payloads.read_jog, requests.JOG),
    "setpoint": request(payloads.read_setpoint, requests.SETPOINT),
    "measured_tip": request(payloads.read_measured_tip, requests.MEASURED_TIP),
    "degrade": request(payloads.read_degrade, requests.DEGRADE),
    "obstacles": request(payloads.read_obstacles, requests.OBSTACLES, requests.OBSTACLES_IN_SPACE),
    "arm": Target(
        payloads.ReadArm,
        [text(arm) for arm in ARMS for text in (requests.written, requests.plain)],
        requests.wrong(*ARMS),
        requests.spoiler(*ARMS),
        size=3000,
    ),
    "notation": Target(
        lambda: payloads.read_notation,
        [text.encode("utf-8", "surrogatepass") for text in payloads.NOTATIONS],
        payloads.notations,
        size=100,
    ),
    "recording": Target(
        lambda: recordings.read_recording, [bytes([k]) for k in range(5)], st.binary(min_size=8, max_size=8), size=8
    ),
    "executor": Target(frames.Boards, frames.SEEDS, frames.any_acts, size=150 * frames.SIZE),
    "packets": Target(packets.Packets, packets.SEEDS, packets.any_packets, size=3000),
    "board": Target(frames.Firmware, frames.SEEDS, frames.any_acts, size=150 * frames.SIZE),
    **{name: reader(name) for name in SAMPLES},
}
