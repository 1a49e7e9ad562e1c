"""Plants defects, one at a time: those of `planted`, and random ones. The simulation looks for each, then the tests."""

from __future__ import annotations

import argparse
import gc
import os
import signal
import subprocess
import sys
from collections import deque
from functools import partial
from pathlib import Path

from tests.mutants.checks import COMPILING, ROOT, TESTS, ordered_tests, room_of, run_tests, simulate, warm_up
from tests.mutants.forks import Child, Result, ended, start, stop
from tests.mutants.planted import planted
from tests.mutants.results import Results, equivalents, shown, table, told
from tests.mutants.sites import Mutant, listed, sample

EQUIVALENT = Path(__file__).with_name("equivalent.txt")
PLANTED = Path(__file__).with_name("planted")
PATIENCE = 4  # time that a mutant may take, as a multiple of that of the program
LEAST = 30.0  # [s] added to it
BUSY = 10  # wall-clock time as a multiple of processor time: others use the computer, too
TESTS_LIMIT = 3600.0  # [s] of all tests of a room: processor time, or wall-clock time of those without a defect

Task = tuple[str, Mutant | None, str]  # room, defect and phase


def main() -> int:
    """Runs the checks; returns 1 if the program without a defect fails one."""
    options = parsed()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that no child remains
    mutants = listed(ROOT, options.rooms, room_of)
    by_hand = [mutant for mutant in planted(ROOT, PLANTED) if room_of(mutant.file) in options.rooms]
    aside = equivalents(EQUIVALENT)
    count = sum(map(len, mutants.values())) + len(by_hand)
    if options.only:
        chosen = [mutant for of_room in (by_hand, *mutants.values()) for mutant in of_room if options.only in mutant.id]
    else:
        mutants = {room: [mutant for mutant in of_room if mutant.id not in aside] for room, of_room in mutants.items()}
        chosen = [*by_hand, *sample(mutants, options.sample, options.seed)]
    if options.list:
        for mutant in chosen:
            print(shown(mutant))
    if not options.list and not options.report:
        if options.json and options.json.exists() and options.json.stat().st_size and not options.resume:
            sys.exit(f"{options.json} has results: continue with --resume, or name another file")
        results = Results(options.json)
        results.add({"phase": "run", "options": sys.argv[1:], "commit": commit()})
        if not Run(options, results, [(room_of(mutant.file), mutant) for mutant in chosen]).all():
            return 1
    print(f"{len(chosen)} of {count} mutants, {len(aside)} equivalent ones set aside")
    if not options.list:
        results = Results(options.json) if options.report else results
        print(table([("planted" if mutant in by_hand else room_of(mutant.file), mutant) for mutant in chosen], results))
    return 0


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--sample", type=int, default=50, help="number of random mutants")
    parser.add_argument("--rooms", nargs="+", choices=TESTS, default=list(TESTS), help="folders of the program")
    parser.add_argument("--only", metavar="ID", help="all mutants whose id contains this text, in place of a sample")
    parser.add_argument("--jobs", type=int, default=1, help="number of checks at a time")
    parser.add_argument("--steps", type=int, default=200_000, help="steps of the simulation for each mutant")
    parser.add_argument("--first", type=int, default=0, help="first seed of the simulation")
    parser.add_argument("--with-tests", action="store_true", help="run the tests if the simulation finds nothing")
    parser.add_argument("--json", type=Path, metavar="FILE", help="append the results to this file, one a line")
    parser.add_argument("--resume", action="store_true", help="run only what has no result in the file")
    parser.add_argument("--report", action="store_true", help="run nothing, and print the results of the file")
    parser.add_argument("--list", action="store_true", help="run nothing, and print the mutants")
    options = parser.parse_args()
    if (options.resume or options.report) and options.json is None:
        parser.error("--resume and --report need --json FILE")
    return options


def commit() -> str:
    """Returns the commit of the program, with a + if files have changed."""
    told = subprocess.run(
        ["git", "describe", "--always", "--dirty=+", "--abbrev=12"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return told.stdout.strip()


class Run:
    def __init__(self, options: argparse.Namespace, results: Results, chosen: list[tuple[str, Mutant]]) -> None:
        self._options, self._results, self._chosen = options, results, chosen
        self._limit = 0.0  # of the simulation [s]

    def all(self) -> bool:
        """Checks all mutants; returns False if the program without a defect fails."""
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        warm_up()
        gc.collect()
        gc.freeze()  # so that children share the memory
        todo = deque((room, mutant, "simulation") for room, mutant in self._chosen)
        tested = (
            {room for room, _ in self._chosen} - set(self._results.unchanged) if self._options.with_tests else set()
        )
        simulated = [task for task in todo if (task[1].id, "simulation") not in self._results.found]
        first: deque[Task] = deque((room, None, "tests") for room in sorted(tested))
        if simulated:
            first.appendleft(("", None, "simulation"))
        return self._checked(first) and self._checked(deque[Task](todo))

    def _checked(self, todo: deque[Task]) -> bool:
        children: list[Child] = []
        try:
            while todo or children:
                while todo and len(children) < self._options.jobs:
                    self._begin(todo, children)
                if not children:
                    continue
                for child, result in ended(children):
                    if not self._take(child.name, result, todo):
                        return False
        finally:
            stop(children)
        return True

    def _begin(self, todo: deque[Task], children: list[Child]) -> None:
        room, mutant, phase = task = todo.popleft()
        known = None if mutant is None else self._results.found.get((mutant.id, phase))
        if known is not None:
            self._continue(task, known, todo)
        elif phase == "simulation":
            limit = (self._limit or self._options.steps / 1000 + LEAST) + COMPILING * (
                mutant is not None and mutant.kernel
            )
            work = partial(simulate, mutant, self._options.steps, self._options.first)
            children.append(start(task, work, limit, BUSY * limit))
        else:
            files = ordered_tests(room, mutant, self._results.finders(mutant.module) if mutant else ())
            patience = PATIENCE * self._results.unchanged[room] + BUSY * LEAST if mutant else TESTS_LIMIT
            children.append(start(task, partial(run_tests, mutant, files), TESTS_LIMIT, patience))

    def _take(self, task: Task, result: Result, todo: deque[Task]) -> bool:
        room, mutant, phase = task
        if mutant is None:
            if result["found"]:
                print(f"without a defect, {phase} {room} fail: {result}", file=sys.stderr)
                return False
            if phase == "simulation":
                self._limit = PATIENCE * result["cpu"] + LEAST
            else:
                self._results.add({"phase": "unchanged", "room": room, "seconds": result["seconds"]})
            return True
        told_of = {"id": mutant.id, "phase": phase, "room": room, "module": mutant.module, "operator": mutant.operator}
        record = {**told_of, **result, **mutant.place}
        self._results.add(record)
        print(told(record), flush=True)
        self._continue(task, record, todo)
        return True

    def _continue(self, task: Task, record: Result, todo: deque[Task]) -> None:
        room, mutant, phase = task
        if phase == "simulation" and not record["found"] and self._options.with_tests:
            todo.appendleft((room, mutant, "tests"))


if __name__ == "__main__":
    sys.exit(main())
