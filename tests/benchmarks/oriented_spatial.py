"""Densities on SE(3): how mapping and convolution grow with the number of modules, and how near both come to the truth.

The mean square distance of the tip from the base is known exactly; what a density has more or less of it is its error.
Where the tips are otherwise, random configurations tell, in cells of a tenth and a sixth of the arm.
"""

import argparse
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from controller.workspace.oriented_mapping import map_oriented
from controller.workspace.spatial_convolution import by_spatial_convolution
from tests.arms import spatial_arm
from tests.benchmarks.measuring import exponent
from tests.workspace.comparing import drawn_points, mapped_positions, placed, second_moment, spatial_points
from tests.workspace.comparing import total_variation as variation

MODULES, PIXEL = (16, 64, 256), 0.01
MAPPED_PIXELS, WEIGHT = 20_000, 1.0
CONVOLVED_PIXELS, ALONG = 3_000_000, 2
CELLS = 6  # along the arm, in which positions are compared


@dataclass(frozen=True)
class Row:
    """What was measured for one arm, by mapping and by convolution: times in seconds of one processor.

    Attributes:
        modules: B.
        seconds: to map all levels, and to convolve.
        pixels: side of the whole arm's pixels.
        errors: of the tip's distance from the base, root mean square, as a share of it.
        variations: total variation from random configurations.
        apart: total variation between the two.
    """

    modules: int
    seconds: tuple[float, float]
    pixels: tuple[float, float]
    errors: tuple[float, float]
    variations: tuple[float, float]
    apart: float


def measured(modules: int) -> Row:
    """Measures one arm."""
    arm = spatial_arm(modules)
    began = time.process_time()
    densities = map_oriented(arm, PIXEL, MAPPED_PIXELS, WEIGHT)
    mapping, began = time.process_time() - began, time.process_time()
    density = by_spatial_convolution(arm, PIXEL, CONVOLVED_PIXELS, ALONG)
    convolving = time.process_time() - began
    both = mapped_positions(densities), spatial_points(density)
    exact = np.sqrt(second_moment(arm))
    mapped, convolved, drawn = (
        placed(points, shares, arm.length / CELLS, arm.length) for points, shares in (*both, drawn_points(arm, 100_000))
    )
    errors = [float(np.sqrt(w @ (p**2).sum(axis=1) / w.sum()) / exact - 1) for p, w in both]
    return Row(
        modules,
        (mapping, convolving),
        (float(densities.pixels[0]), density.pixel),
        (errors[0], errors[1]),
        (variation(mapped, drawn), variation(convolved, drawn)),
        variation(mapped, convolved),
    )


def report(modules: list[int]) -> dict[str, Any]:
    """Measures arms of so many modules each and prints the table; returns its figures."""
    map_oriented(spatial_arm(2), 0.1, 100, WEIGHT)  # loads the kernels
    by_spatial_convolution(spatial_arm(2), 0.1, 100_000, 1)
    rows = [measured(count) for count in modules]
    exponents = [exponent(modules, [row.seconds[k] for row in rows]) for k in range(2)]
    title = f"mapping ({MAPPED_PIXELS:,} pixels) | convolution ({CONVOLVED_PIXELS:,} in {24 * ALONG**3} rotations)"
    table = Table("B", "s", "pixel", "distance off", "variation", "apart", title=title, show_footer=True)
    table.columns[0].footer, table.columns[1].footer = "exponent", " | ".join(f"{e:.2f}" for e in exponents)
    for row in rows:
        pairs = row.seconds, row.pixels, row.errors, row.variations
        table.add_row(str(row.modules), *[" | ".join(f"{v:.3g}" for v in pair) for pair in pairs], f"{row.apart:.3f}")
    Console().print(table)
    return {"rows": [asdict(row) for row in rows], "exponents": exponents}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", type=int, nargs="*", default=MODULES)
    report(list(parser.parse_args().modules))
