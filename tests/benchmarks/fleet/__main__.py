"""Many arms on one computer: rates, latency and costs as arms are added, then faults.

python -m tests.benchmarks.fleet [--arms 1,2,5,10,20] [--seconds 30] [--json PATH]

Each arm is the paper's, with two simulated boards, and has a planner and an executor. Five clients, two pages and a
recorder share a router with them. Each arm gets a goal a second, if it keeps up. A computer for each arm would bear
more than this one: the table says what all together need.
"""

import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import zenoh

from hyperbit.controller.arm.arm import load
from tests.benchmarks.fleet.faults import play
from tests.benchmarks.fleet.plant import PATIENCE, Cost, Plant, sum_of
from tests.benchmarks.fleet.traffic import NOT_RECEIVED, Place, Traffic, ends
from tests.benchmarks.harness import PAPER_ARM, CommandLine, joined, report, show
from tests.benchmarks.solving import random_tips
from tests.waiting import eventually

SETTLE = 5.0  # [s] after the last arm has begun to serve
OTHERS = ("router", "page1", "page2", "recorder")
HEADERS = ("arms", "goals/s an arm", "answer p50, p99 [ms]", "result p50, p99 [ms]", "states/s an arm")
HEADERS += ("processor an arm", "of all else", "MB an arm", "ended")


class Row(NamedTuple):
    """One number of arms.

    Attributes:
        answer: time to the answer, median and 99 % [ms].
        end: time to the result, median and 99 % [ms].
        arm, others: processor time over time, of each arm with its executor and boards, and of router, pages, recorder
            and clients.
        memory: of each arm with its executor [MB].
    """

    arms: int
    goals: float
    answer: str
    end: str
    states: float
    arm: float
    others: float
    memory: float
    ended: dict[str, int]

    def cells(self) -> tuple[object, ...]:
        how = ", ".join(f"{count} {status}" for status, count in self.ended.items())
        shares = (f"{100 * self.arm:.0f} %", f"{100 * self.others:.0f} %")
        return self.arms, self.goals, self.answer, self.end, self.states, *shares, self.memory, how


def main() -> None:
    options = CommandLine(__doc__, arms="1,2,5,10,20", seconds=30.0).parse()
    counts = [int(it) for it in options.arms.split(",")]
    with ExitStack() as closing:
        plant = Plant(Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="hb"))), closing)
        traffic = Traffic(plant, places())
        closing.callback(traffic.close)
        rows = [measured(plant, traffic, count, options.seconds) for count in counts]
        show("", HEADERS, [row.cells() for row in rows])
        faults = play(plant, traffic)
        books = written(plant)
    print(*faults, sep="\n")
    doubled = sorted(
        {goal for goal, ended in books.items() if len(ended) > 1}
        | {goal for goal, count in traffic.results.items() if count > 1}
    )
    open_ends = sorted([*traffic.unknown, *(goal for goal, ended in books.items() if None in ended)])
    late = sum(it.status == NOT_RECEIVED and it.id in books for it in traffic.sent)
    bars = {
        "no goal accepted twice, or with two results": not doubled,
        "no goal without a result": not open_ends,
        "no goal ran that its client counts as not received": not late,
        "states and goals of the most arms at 90 % of one arm's": rows[-1].states >= 0.9 * rows[0].states
        and rows[-1].goals >= 0.9 * rows[0].goals,
    }
    figures = {"rows": [row._asdict() for row in rows], "faults": faults, "all": ends(traffic.sent)}
    report({**figures, "doubled": doubled, "without result": open_ends, "late": late}, bars, options.json)


def written(plant: Plant) -> dict[str, list[str | None]]:
    """Returns the ends of each goal in the ledgers, once each has its end; open ones after PATIENCE."""
    until, books = time.monotonic() + PATIENCE, plant.ledgers()
    while any(None in ended for ended in books.values()) and time.monotonic() < until:
        time.sleep(1.0)
        books = plant.ledgers()
    return books


def places() -> list[Place]:
    return random_tips(load(PAPER_ARM).manipulator, 500, seed=9).tolist()


def measured(plant: Plant, traffic: Traffic, count: int, seconds: float) -> Row:
    while len(plant.arms) < count:
        name = plant.add_arm()
        eventually(lambda name=name: plant.ready(name), PATIENCE)
        if len(plant.arms) == 1:
            plant.start_page(1)
            plant.start_page(2)
            plant.start_recorder()
    time.sleep(SETTLE)
    heard: Counter[str] = Counter()

    def hear(sample: zenoh.Sample) -> None:
        heard[str(sample.key_expr)] += 1

    with plant.session() as listening, listening.declare_subscriber("hyperbit/*/state", hear):
        before, own, began = costs(plant), time.process_time(), time.monotonic()
        goals = traffic.run(plant.arms, seconds)
        took, own = time.monotonic() - began, time.process_time() - own
        after = costs(plant)
    arms, others = (it[1].seconds - it[0].seconds for it in zip(before, after, strict=True))
    row = Row(
        count,
        round(len(goals) / count / took, 3),
        joined([it.answered for it in goals], "p50", "p99"),
        joined([it.ended for it in goals], "p50", "p99"),
        round(sum(heard.values()) / count / took, 1),
        round(arms / count / took, 3),
        round((others + own) / took, 3),
        round(after[0].memory / count, 1),
        ends(goals),
    )
    print(row, file=sys.stderr, flush=True)
    return row


def costs(plant: Plant) -> tuple[Cost, Cost]:
    return sum_of(plant.costs(plant.arms)), sum_of(plant.costs(OTHERS))


if __name__ == "__main__":
    main()
