"""Runs trials of all boards, and prints a table: `python -m tests.drivers.enumeration --every 20`."""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections import Counter
from functools import partial

from tests.drivers.enumeration.mixed import MIXED
from tests.drivers.enumeration.trials import Verdict, run, trials
from tests.drivers.variants.cases import CASES

SHOWN = 3  # examples of each broken invariant
COLUMNS = ("boots", "changed by START", "energised", "moved", "refused", "mended")
BOARDS = (*CASES, *MIXED)
Rows = dict[tuple[str, str], Counter[str]]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=1, help="run only each N-th trial of a board")
    parser.add_argument("--board", help="run only boards whose name has this text")
    parser.add_argument("--failure", default="", help="run only failures whose kind has this text")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    began = time.monotonic()
    numbers = [i for i, case in enumerate(BOARDS) if options.board is None or options.board in case.name]
    with multiprocessing.Pool(options.processes) as pool:
        results = pool.map(partial(results_of, every=options.every, kind=options.failure), numbers, chunksize=1)
    total: Counter[str] = Counter()
    kinds: Rows = {}
    print(f"{'board':<36} {'failure':<26}" + "".join(f"{column:>18}" for column in COLUMNS))
    for rows, _ in results:
        for (name, kind), counter in rows.items():
            print(line(name, kind, counter))
            total.update(counter)
            kinds.setdefault(("all", kind), Counter()).update(counter)
    for (name, kind), counter in kinds.items():
        print(line(name, kind, counter))
    print(line("all", "all", total))
    broken = [sentence for _, sentences in results for sentence in sentences]
    for invariant, examples in alike(broken).items():
        print(f"\n{invariant}: {len(examples)} times, for example")
        print("\n".join(f"  {example}" for example in examples[:SHOWN]))
    print(f"\n{total['boots']} boots in {time.monotonic() - began:.0f} s")
    return bool(broken)


def results_of(number: int, every: int, kind: str) -> tuple[Rows, list[tuple[str, str]]]:
    case, rows = BOARDS[number], Rows()
    broken: list[tuple[str, str]] = []
    for trial in trials(case, every, kind):
        verdict = run(trial)
        rows.setdefault((case.name, trial.failure.kind), Counter()).update(counts(verdict))
        broken += [(trial.name, sentence) for sentence in verdict.broken]
    return rows, broken


def counts(verdict: Verdict) -> dict[str, int]:
    columns = (1, verdict.started, verdict.energised, verdict.moved, not verdict.ready, verdict.ready)
    return dict(zip(COLUMNS, columns, strict=True))


def line(name: str, kind: str, counter: Counter[str]) -> str:
    return f"{name:<36} {kind:<26}" + "".join(f"{counter[column]:>18}" for column in COLUMNS)


def alike(broken: list[tuple[str, str]]) -> dict[str, list[str]]:
    groups: dict[str, list[str]] = {}
    for trial, sentence in broken:
        invariant, _, what = sentence.partition(": ")
        groups.setdefault(invariant, []).append(f"{trial}: {what}")
    return groups


if __name__ == "__main__":
    sys.exit(main())
