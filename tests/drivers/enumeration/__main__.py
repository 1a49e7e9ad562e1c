"""Runs trials of all boards, and counts boots by failure: `python -m tests.drivers.enumeration --every 20`."""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections import Counter, defaultdict
from functools import partial

from tests.drivers.enumeration.mixed import MIXED
from tests.drivers.enumeration.trials import run, trials
from tests.drivers.variants.cases import CASES

SHOWN = 3  # examples of each broken invariant
BOARDS = (*CASES, *MIXED)
Counts = Counter[tuple[str, bool]]  # boots by kind of failure, and whether the board was ready at the end


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=1, help="run only each N-th trial of a board")
    parser.add_argument("--board", default="", help="run only boards whose name has this text")
    parser.add_argument("--failure", default="", help="run only failures whose kind has this text")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    began, boots = time.monotonic(), Counts()
    examples: defaultdict[str, list[str]] = defaultdict(list)
    numbers = [i for i, case in enumerate(BOARDS) if options.board in case.name]
    with multiprocessing.Pool(options.processes) as pool:
        work = partial(results_of, every=options.every, kind=options.failure)
        for number, (counts, broken) in zip(numbers, pool.imap(work, numbers), strict=True):
            print(f"{BOARDS[number].name}: {counts.total()} boots", flush=True)
            boots += counts
            for trial, sentence in broken:
                invariant, _, what = sentence.partition(": ")
                examples[invariant].append(f"{trial}: {what}")
    for kind in dict.fromkeys(kind for kind, _ in boots):
        print(f"{kind:<26} {boots[kind, False]:>8} refused {boots[kind, True]:>8} ready")
    for invariant, found in examples.items():
        print(f"\n{invariant}: {len(found)} times, for example", *found[:SHOWN], sep="\n  ")
    print(f"\n{boots.total()} boots in {time.monotonic() - began:.0f} s")
    return bool(examples)


def results_of(number: int, every: int, kind: str) -> tuple[Counts, list[tuple[str, str]]]:
    counts, broken = Counts(), list[tuple[str, str]]()
    for trial in trials(BOARDS[number], every, kind):
        verdict = run(trial)
        counts[trial.failure.kind, verdict.ready] += 1
        broken += [(trial.name, sentence) for sentence in verdict.broken]
    return counts, broken


if __name__ == "__main__":
    sys.exit(main())
