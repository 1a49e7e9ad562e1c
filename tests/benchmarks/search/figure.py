"""The plot: switches against time for a goal, one labelled point for each method."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

# Colours of Okabe and Ito, which colour-blind readers can distinguish. There are fewer than methods, so markers differ.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*", "d")
WELL = 0.95
# Where a label may go from its point: horizontal and vertical alignment, and offset in points; the nearest first.
WAYS = [("left", "center", 9, 0), ("right", "center", -9, 0)]
WAYS += [("center", "bottom", 0, 8), ("center", "top", 0, -8)]
WAYS += [(side, high, dx, dy) for dy, high in ((6, "bottom"), (-6, "top")) for side, dx in (("left", 6), ("right", -6))]
WAYS += [
    (side, "center", dx, dy)
    for away in (20, 32, 44, 56, 68)
    for dy in (away, -away)
    for side, dx in (("left", away / 2), ("right", -away / 2))
]


def plot(
    path: Path,
    title: str,
    names: Sequence[str],
    times: Sequence[float],
    switches: Sequence[float],
    within: Sequence[float],
) -> None:
    """Writes the plot; the first method is ours, times are in seconds, `within` the share within the tolerance."""
    figure = Figure(figsize=(10, 6.5), dpi=150, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_xscale("log")
    axes.set(xlabel="median time for a goal [s]", ylabel="mean switches for a goal")
    axes.set_title(title, loc="left")
    for n, (time, count, share) in enumerate(zip(times, switches, within, strict=True)):
        colour, marker = COLOURS[n % len(COLOURS)], MARKERS[n % len(MARKERS)]
        face = colour if share >= WELL else "white"
        size = 12 if n == 0 else 9
        axes.plot(time, count, marker, color=colour, markerfacecolor=face, ms=size, markeredgewidth=1.6, zorder=3)
    axes.set_xlim(min(times) / 3, max(times) * 15)
    axes.set_ylim(0, max(switches) * 1.12)
    axes.grid(which="major", color="0.92")
    axes.spines[["top", "right"]].set_visible(False)
    note = f"filled: at least {WELL:.0%} of the goals within the tolerance; hollow: fewer, the share by the name"
    figure.supxlabel(note, fontsize="small", color="0.35")
    labels = [name if share >= WELL else f"{name} ({share:.0%})" for name, share in zip(names, within, strict=True)]
    canvas.draw()  # settles the layout, so that labels are placed where there is room
    place(axes, canvas.get_renderer(), labels, times, switches)
    figure.savefig(path)


def place(axes: Axes, renderer: RendererAgg, labels: Sequence[str], xs: Sequence[float], ys: Sequence[float]) -> None:
    """Writes each label by its point where it covers no other point, no label and no edge; from afar with a line."""
    points = axes.transData.transform(list(zip(xs, ys, strict=True)))
    taken = [Bbox.from_bounds(x - 14, y - 14, 28, 28) for x, y in points]
    frame = axes.get_window_extent()
    for n, (label, x, y) in enumerate(zip(labels, xs, ys, strict=True)):
        others = taken[:n] + taken[n + 1 :]
        for side, high, dx, dy in WAYS:
            far = abs(dy) > 10
            line = {"arrowstyle": "-", "color": "0.6", "shrinkA": 0, "shrinkB": 6} if far else None
            style = {"fontsize": 9, "fontweight": "bold" if n == 0 else "normal", "color": "0.15", "arrowprops": line}
            text = axes.annotate(label, (x, y), (dx, dy), textcoords="offset points", ha=side, va=high, **style)
            text.update_positions(renderer)
            box = Text.get_window_extent(text, renderer).padded(2)  # without the line
            inside = frame.containsx(box.x0) and frame.containsx(box.x1) and frame.containsy(box.y0)
            corner = (box.x0 if side == "left" else box.x1, (box.y0 + box.y1) / 2)
            way = np.linspace(points[n], corner, 20) if far else []
            crosses = any(other.contains(*step) for other in others for step in way)
            if inside and not crosses and not any(box.overlaps(other) for other in others):
                break
            if (side, high, dx, dy) != WAYS[-1]:
                text.remove()
        taken.append(box)
