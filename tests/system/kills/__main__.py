"""Kills each process many times at each moment, and prints a table: python -m tests.system.kills --each 20

Ends with 1 if a result was doubled or missing, or anything else was wrong. Give some moments to each of several
processes to run them at once.
"""

import argparse
import itertools
import sys
import tempfile
from contextlib import ExitStack, closing
from dataclasses import astuple, fields
from pathlib import Path

from tests.system.kills.campaign import Campaign, Tally, kill_nursery
from tests.system.kills.moments import MOMENTS, PROCESSES
from tests.system.stack import arms
from tests.system.stack.system import System

EACH_SYSTEM = 60  # kills of one arm, because the ledger is read as its latest thousand goals


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=20, help="kills of each process at each moment")
    parser.add_argument("--first", type=int, default=0, help="seed of the first kill")
    parser.add_argument("--moment", nargs="*", default=list(MOMENTS), choices=list(MOMENTS))
    parser.add_argument("--process", nargs="*", default=list(PROCESSES), choices=PROCESSES)
    given = parser.parse_args()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        planners = stack.enter_context(closing(kill_nursery(folder)))
        campaign = Campaign(lambda: System("emulated", "planar", {"boards": arms.QUICK}, planners))
        stack.callback(campaign.close)
        numbers = range(given.first, given.first + given.each)
        for k, (moment, number, victim) in enumerate(itertools.product(given.moment, numbers, given.process), 1):
            campaign.kill(moment, victim, number)
            print(f"{moment} {victim} {number}: {campaign.tallies[moment, victim]}", file=sys.stderr, flush=True)
            if k % EACH_SYSTEM == 0:
                campaign.close()
    names = [field.name for field in fields(Tally)][:-1]
    print(f"{'moment':<14}{'process':<10}" + "".join(f"{name:>11}" for name in names))
    for (moment, victim), tally in campaign.tallies.items():
        print(f"{moment:<14}{victim:<10}" + "".join(f"{number:>11}" for number in astuple(tally)[:-1]))
    wrong = [text for tally in campaign.tallies.values() for text in tally.wrong]
    print(*wrong, sep="\n")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
