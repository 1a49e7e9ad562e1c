"""Load for minutes and commits by the million; prints a table, writes JSON.

python -m tests.soak [--minutes N] [--commits N] [--json PATH]
"""

import argparse
import json
import logging
import os
import sys
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from controller.config import load
from controller.workspace.mapping import map_densities
from tests.conftest import PAPER_ARM
from tests.soak.commits import committed
from tests.soak.daemon import soaked

MOST_GROWTH = 0.01


def main() -> None:
    """Runs both; ends with an error where something was lost, doubled, miscounted or grew."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--commits", type=int, default=1_000_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    figures: dict[str, Any] = {"load_average": os.getloadavg()}
    if options.commits:
        logging.disable(logging.ERROR)  # a line for every stop
        began = time.perf_counter()
        figures["commits"] = {**committed(options.commits), "took": time.perf_counter() - began}
        logging.disable(logging.NOTSET)
        show("commits on a simulated clock", figures["commits"])
    if options.minutes:
        sys.setswitchinterval(0.0005)  # as `hyperbit run` does
        arm = load(PAPER_ARM)
        densities = map_densities(arm.manipulator, arm.pixel, arm.level_pixels)
        figures["load"] = soaked(arm, densities, 60 * options.minutes)
        show(f"{options.minutes:g} minutes of load", figures["load"])
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    for run in (figures[key] for key in ("commits", "load") if key in figures):
        for name, growth in run["memory"].items():
            assert "growth" not in name or growth < MOST_GROWTH, f"{name}: {growth:.2%}"


def show(title: str, figures: dict[str, Any]) -> None:
    """Prints figures as a table."""
    table = Table("figure", "value", title=title)
    for name, value in figures.items():
        rows = {f"{name}, {k}": v for k, v in value.items()} if isinstance(value, dict) else {name: value}
        for label, number in rows.items():
            table.add_row(label, f"{number:.6g}" if isinstance(number, float) else str(number))
    Console().print(table)


if __name__ == "__main__":
    main()
