"""What all benchmarks share: options, times, percentiles, and figures as tables and as JSON."""

import argparse
import gc
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

DEPLOY = Path(__file__).parents[2] / "deploy"
PAPER_ARM = DEPLOY / "planar16.yaml"
PERCENTILES = {"p50": 0.5, "p75": 0.75, "p95": 0.95, "p99": 0.99, "p999": 0.999, "worst": 1.0}

T = TypeVar("T")
Times = Sequence[float] | NDArray[np.float64]  # [s]


class CommandLine(argparse.ArgumentParser):
    """The options of a benchmark. Each benchmark has `--json`.

    Args:
        goals: default of the option `--goals`; None: no such option.
        busy: whether there is an option `--busy`.
        options: defaults of further options, by name; their types are those of the defaults.
    """

    def __init__(
        self, description: str | None, goals: int | None = None, busy: bool = False, **options: float | str
    ) -> None:
        super().__init__(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
        self.add_argument("--json", type=Path, help="also write the figures there")
        for name, default in (({} if goals is None else {"goals": goals}) | options).items():
            self.add_argument(f"--{name}", type=type(default), default=default, help="(default: %(default)s)")
        if busy:
            self.add_argument("--busy", action="store_true", help="count the thread's own time, on a busy machine")

    def parse(self) -> argparse.Namespace:
        """Returns the options. With `--busy` all times and deadlines of this process are those of its thread."""
        given = self.parse_args()
        if getattr(given, "busy", False):
            time.perf_counter = time.thread_time
        return given


def timed(call: Callable[[], T]) -> tuple[T, float]:
    """Returns the result of a call, and its time [s]."""
    began = time.perf_counter()
    return call(), time.perf_counter() - began


def processor_time(pid: int) -> float:
    """Returns the processor time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def no_collection() -> Iterator[None]:
    """Collects garbage, then not again inside the context."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def percentiles(times: Times, *names: str) -> dict[str, float]:
    """Returns percentiles of times [s] in milliseconds: those named, or median, 99 %, 99.9 % and worst."""
    names = names or ("p50", "p99", "p999", "worst")
    return {name: round(1e3 * float(np.quantile(times, PERCENTILES[name])), 4) for name in names}


def joined(times: Times, *names: str) -> str:
    """Returns percentiles of times [s] as text, in milliseconds."""
    return " / ".join(f"{time:.3g}" for time in percentiles(times, *names).values())


def show(title: str, headers: Sequence[str], rows: Iterable[Sequence[object]], width: int = 150) -> None:
    table = Table(title=escape(title))
    for k, header in enumerate(headers):
        table.add_column(escape(header), justify="right" if k else "left")
    for row in rows:
        table.add_row(*map(str, row))
    Console(width=width).print(table)


def write_figures(path: Path | None, figures: Any) -> None:
    if path is not None:
        path.write_text(json.dumps(figures, indent=1, default=_plain) + "\n")


def report(figures: dict[str, Any], bars: dict[str, bool], path: Path | None) -> None:
    whole = figures | {"bars": bars, "met": all(bars.values())}
    print(json.dumps(whole, indent=1, default=_plain))
    write_figures(path, whole)


def _plain(value: Any) -> Any:
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else np.asarray(value).tolist()
