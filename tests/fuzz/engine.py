"""Fuzzes one target with one engine and writes the figures: python -m tests.fuzz.engine TARGET ENGINE RUNS OUT.

"mutations" changes valid inputs, each in a way that its number decides. hypothesis generates inputs from strategies;
atheris (libFuzzer) mutates seeds, guided by code coverage. Both begin with the same random seed on each run. Engines
need memory themselves. So "replay" runs the inputs of atheris repeatedly without instrumentation, to measure leaks of
the program itself.
"""

from __future__ import annotations

import collections
import gc
import hashlib
import json
import os
import random
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

PATIENCE = 5.0  # [s] of processor time for one input
ROUND = 1000  # examples of hypothesis between which it forgets
WARM = 0.2  # share of the runs before memory is looked at first
KEPT = Path("fuzz-found")  # inputs that went wrong, in the directory of work


class Endless(Exception):
    """One input took too long."""


class Record:
    def __init__(self, build: Callable[[], Callable[[bytes], int]], name: str, runs: int) -> None:
        self.inputs = self.count = 0
        self.wrong: collections.Counter[str] = collections.Counter()
        self._build, self._attack, self._name, self._warm = build, build(), name, int(runs * WARM)
        self._before: tuple[int, int] | None = None
        self._began = time.process_time()
        signal.signal(signal.SIGVTALRM, self._interrupt)

    def take(self, data: bytes) -> None:
        """Runs one input; of each kind of failure it records the first and saves the input."""
        signal.setitimer(signal.ITIMER_VIRTUAL, PATIENCE)
        try:
            self.inputs += self._attack(data)
        except Exception as error:
            self._note(error, data)
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        self.count += 1
        if self.count == self._warm:
            self._before = footprint()

    def result(self) -> dict[str, Any]:
        blocks, resident = footprint()
        before = self._before or (blocks, resident)
        moved = sum(times for kind, times in self.wrong.items() if kind.startswith("Moved"))
        return {
            "target": self._name,
            "runs": self.count,
            "inputs": self.inputs,
            "seconds": round(time.process_time() - self._began, 1),
            "crashes": sum(self.wrong.values()) - moved,
            "motions": moved,
            "blocks": round(blocks / before[0] - 1, 5),
            "resident": round(resident / before[1] - 1, 5),
            "switches": getattr(self._attack, "syncs", None),
            "wrong": dict(self.wrong),
        }

    def _note(self, error: Exception, data: bytes) -> None:
        place = traceback.extract_tb(error.__traceback__)[-1]
        kind = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}"
        if not self.wrong[kind]:
            KEPT.mkdir(exist_ok=True)
            name = f"{self._name}-{hashlib.sha1(data).hexdigest()[:8]}"
            (KEPT / name).write_bytes(data)
            sys.stderr.write(f"{name}: {''.join(traceback.format_exception(error))}\n")
        self.wrong[kind] += 1
        self._attack = self._build()

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        raise Endless(f"more than {PATIENCE:g} s for one input")


def footprint() -> tuple[int, int]:
    """Returns the number of memory blocks that Python has allocated, and the resident bytes of the process.

    A leak increases both. Bytes also grow when a table of the interpreter is doubled.
    """
    gc.collect()
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    return sys.getallocatedblocks(), resident


def by_hypothesis(name: str, runs: int, out: Path) -> None:
    from hypothesis import HealthCheck, Phase, given, seed, settings

    from tests.fuzz.targets import TARGETS

    target = TARGETS[name]
    assert target.strategy is not None
    record = Record(target.build, name, runs)
    for data in target.seeds + target.found(name):
        record.take(data)
    quiet = settings(
        max_examples=ROUND,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    turn = 0
    while record.count < runs:
        seed(turn)(quiet(given(target.strategy)(record.take)))()
        turn += 1
    out.write_text(json.dumps(record.result()))


def by_mutations(name: str, runs: int, out: Path) -> None:
    """Runs numbered mutations of the seeds: odd bytes, odd values, odd lengths."""
    from tests.fuzz.targets import TARGETS

    target = TARGETS[name]
    record = Record(target.build, name, runs)
    for number in range(runs):
        record.take(target.mutation(name, number))
    out.write_text(json.dumps(record.result()))


def by_replay(name: str, runs: int, out: Path) -> None:
    """Runs the inputs that atheris has saved, repeatedly."""
    from tests.fuzz.targets import TARGETS

    record = Record(TARGETS[name].build, name, runs)
    kept = [path.read_bytes() for path in sorted(out.with_name(f"{name}-atheris.corpus").iterdir())]
    while record.count < runs:
        record.take(kept[record.count % len(kept)])
    out.write_text(json.dumps(record.result()))


def by_atheris(name: str, runs: int, out: Path) -> None:
    """Fuzzes with inputs that reach new lines of the instrumented program."""
    import atheris

    compiled = [p for room in ("controller", "drivers") for p in Path(room).rglob("*.py") if "numba" in p.read_text()]
    # numba cannot compile instrumented code.
    exclude = [".".join(("hyperbit", *path.with_suffix("").parts)) for path in compiled]
    with atheris.instrument_imports(include=["hyperbit", "yaml", "canopen"], exclude=exclude):
        from tests.fuzz.targets import TARGETS
    target = TARGETS[name]
    record = Record(target.build, name, runs)
    corpus = out.with_suffix(".corpus")
    corpus.mkdir()
    for k, data in enumerate(target.seeds + target.found(name)):
        (corpus / f"seed-{k}").write_bytes(data)

    def one(data: bytes) -> None:
        record.take(data)
        if record.count == runs:
            out.write_text(json.dumps(record.result()))
            os._exit(0)  # libFuzzer would write its own end

    def change(data: bytes, size: int, number: int) -> bytes:
        chance = random.Random(number)
        if target.spoil is not None and chance.random() < 0.5:
            return target.spoil(data, chance)[:size]
        return bytes(atheris.Mutate(data, size))

    # One input more than runs, and no end of its own to any: see PATIENCE.
    options = [
        f"-max_len={target.size}",
        "-seed=1",
        "-timeout=600",
        "-rss_limit_mb=0",
        "-len_control=0",
        "-verbosity=0",
    ]
    atheris.Setup([sys.argv[0], *options, str(corpus)], one, custom_mutator=change)
    atheris.Fuzz()


if __name__ == "__main__":
    _name, _engine, _runs, _out = sys.argv[1:]
    engines = {"hypothesis": by_hypothesis, "atheris": by_atheris, "replay": by_replay, "mutations": by_mutations}
    engines[_engine](_name, int(_runs), Path(_out))
