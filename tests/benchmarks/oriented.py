"""Densities with orientation: how good they are, and how mapping and convolution grow with the number of modules.

Both are held to a bound on pixels that binds from the first modules on. Mapping keeps a table of every intermediate
workspace, convolution a full box of the whole arm alone. Positions are independent sums, so their second moment is
known exactly: what a density has more of it is blur.
"""

import math
import time
import tracemalloc
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from controller.workspace.convolution import by_convolution
from controller.workspace.oriented_mapping import map_oriented
from tests.arms import paper_arm, spatial_arm
from tests.benchmarks.measuring import exponent
from tests.workspace.comparing import (
    convolved_points,
    exact_counts,
    mapped_points,
    rank_correlation,
    second_moment,
    smoothed,
    total_variation,
)

MODULES, PIXEL = (16, 32, 64, 128, 256, 512, 1024), 0.001
MAPPED_PIXELS, WEIGHT = 20_000, 0.5
CONVOLVED_PIXELS, TURNS = 100_000, 64
VIEW = 16  # pixels along the arm, in which the two are compared by position alone
SHORT = {"planar": paper_arm(5), "spatial": spatial_arm(5)}  # of 15 actuators
SHORT_BOUNDS = ((0.05, 1 << 16), (0.01, 1000), (0.01, 300))


@dataclass(frozen=True)
class Row:
    """What was measured for one arm by both: times in seconds of one processor, memory in MiB, lengths in pixels.

    Attributes:
        modules: B.
        seconds: to map all levels, and to convolve.
        pixels: side of the whole arm's pixels.
        memory: of all that is kept.
        peak: of memory while convolving.
        blurs: root of what the second moment of the position has too much (negative: too little), in pixels.
        rarest: least share of the configurations in a pixel, as logarithm to base 10.
        variation: total variation between the two, seen in pixels of 1/VIEW of the arm.
        rank: their rank correlation, seen so.
    """

    modules: int
    seconds: tuple[float, float]
    pixels: tuple[float, float]
    memory: tuple[float, float]
    peak: float
    blurs: tuple[float, float]
    rarest: tuple[float, float]
    variation: float
    rank: float


def measured(modules: int) -> Row:
    """Measures one arm."""
    manipulator = paper_arm(modules)
    began = time.process_time()
    densities = map_oriented(manipulator, PIXEL, MAPPED_PIXELS, WEIGHT)
    mapping = time.process_time() - began
    began = time.process_time()
    density = by_convolution(manipulator, PIXEL, CONVOLVED_PIXELS, TURNS)
    convolving = time.process_time() - began
    tracemalloc.start()
    by_convolution(manipulator, PIXEL, CONVOLVED_PIXELS, TURNS)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    pixels = float(densities.pixels[0]), density.pixel
    exact, blurs, rarest, views = second_moment(manipulator), [], [], []
    for (points, weights), pixel in zip((mapped_points(densities), convolved_points(density)), pixels, strict=True):
        shares = weights / weights.sum()
        excess = float(shares @ (points[:, :2] ** 2).sum(axis=1)) - exact
        blurs.append(math.copysign(math.sqrt(abs(excess)), excess) / pixel)
        rarest.append(float(np.log10(shares.min())))
        views.append(smoothed(points, weights, manipulator.length / VIEW, 1, 1.2 * manipulator.length))
    kept = sum(array.nbytes for array in vars(densities).values() if isinstance(array, np.ndarray))
    return Row(
        modules,
        (mapping, convolving),
        pixels,
        (kept / 2**20, density.shares.nbytes / 2**20),
        peak / 2**20,
        (blurs[0], blurs[1]),
        (rarest[0], rarest[1]),
        total_variation(*views),
        rank_correlation(*views),
    )


def quality() -> list[dict[str, Any]]:
    """Returns rank correlations with the enumeration of short arms."""
    rows = []
    for name, arm in SHORT.items():
        for pixel, level_pixels in SHORT_BOUNDS:
            densities = map_oriented(arm, pixel, level_pixels, 0.2)
            exact, mapped = exact_counts(arm, densities)
            figures = {"pixel": float(densities.pixels[0]), "pixels": len(densities.level(0))}
            rank, variation = rank_correlation(exact, mapped), total_variation(exact, mapped) / exact.sum()
            rows.append({"arm": name, **figures, "rank": rank, "variation": variation})
    return rows


def report() -> dict[str, Any]:
    """Measures and prints two tables; returns their figures."""
    map_oriented(paper_arm(2), 0.1, 100, WEIGHT)  # loads the kernels
    by_convolution(paper_arm(6), 0.1, 2000, 16)
    shorts = quality()
    table = Table(*shorts[0], title="mapping with orientation against enumeration, 5 modules, 15 actuators")
    for short in shorts:
        table.add_row(*[value if isinstance(value, str) else f"{value:.4g}" for value in short.values()])
    Console().print(table)
    rows = [measured(m) for m in track(MODULES, "measuring", console=Console(stderr=True), transient=True)]
    exponents = [exponent(list(MODULES), [row.seconds[k] for row in rows]) for k in range(2)]
    title = (
        f"mapping ({MAPPED_PIXELS:,} pixels with points a level) | convolution ({CONVOLVED_PIXELS:,}, {TURNS} turns)"
    )
    headers = ["s", "pixel", "MiB kept", "blur\npixels", "rarest\n10^", "peak MiB\n(conv.)", "variation", "rank"]
    table = Table("B", *headers, title=title, show_footer=True)
    table.columns[0].footer, table.columns[1].footer = "exponent", " | ".join(f"{e:.2f}" for e in exponents)
    for row in rows:
        pairs = row.seconds, row.pixels, row.memory, row.blurs, row.rarest
        cells = [" | ".join(f"{value:.3g}" for value in pair) for pair in pairs]
        table.add_row(str(row.modules), *cells, f"{row.peak:.0f}", f"{row.variation:.3f}", f"{row.rank:.3f}")
    Console().print(table)
    return {"rows": [asdict(row) for row in rows], "exponents": exponents, "short": shorts}


if __name__ == "__main__":
    report()
