"""A drawing of an arm's wiring: the outputs and inputs of each board, and what is connected to them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from hyperbit.controller.armfile.settings import ActuatorSettings, ArmSettings
from hyperbit.controller.armfile.terminals import Terminal, actuator_terminals, owned_terminals

if TYPE_CHECKING:  # matplotlib takes half a second to import: only those who draw wait for it
    from matplotlib.axes import Axes
    from matplotlib.patches import Patch

BLUE, ORANGE, GREEN, RED = "#0072B2", "#D55E00", "#009E73", "#B00020"  # Okabe and Ito's, and a red
BOARD, WIRE, TEXT, OWNER = 1.6, 3.3, 3.45, 8.3  # x of the board's edge, the wires' ends, the texts, the owners' edge
ROW = 0.3  # [inch]
ENDS = {"input": "extended", "input_contracted": "contracted"}


class Pin(NamedTuple):
    """A row of the drawing: a terminal of the board, or None for a row without; and what it does."""

    terminal: Terminal | None
    text: str
    glyph: str = ""  # "pulse", "spring" or "switch"


class Owner(NamedTuple):
    """An actuator or interlock with its rows on one board."""

    name: str
    pins: list[Pin]


def save(path: Path, settings: ArmSettings) -> None:
    """Writes a drawing of all boards of an arm's file, in the format of the path's suffix.

    Raises:
        OSError: the file cannot be written.
        ValueError: matplotlib knows no such suffix, or the file has no boards.
    """
    from matplotlib.figure import Figure

    boards = wired(settings)
    if not boards:
        raise ValueError("the arm's file has no boards")
    rows = [sum(len(owner.pins) + 0.6 for owner in owners) + 1.9 for owners in boards.values()]
    figure = Figure(figsize=(8.4, ROW * sum(rows)), layout="constrained")
    all_axes = figure.subplots(len(boards), 1, squeeze=False, height_ratios=rows)[:, 0]
    for axes, height, ((bus, node), owners) in zip(all_axes, rows, boards.items(), strict=True):
        draw_board(axes, f"board {bus}/{node}", owners, height)
    figure.savefig(path, dpi=100)


def wired(settings: ArmSettings) -> dict[tuple[str, int], list[Owner]]:
    """Returns what is connected to each board, in the order of the file."""
    boards: dict[tuple[str, int], list[Owner]] = {}
    for entry in settings.actuators:
        here: dict[tuple[str, int], list[Pin]] = {}
        for board, pin in pins_of(entry, settings):
            here.setdefault(board, []).append(pin)
        for board, pins in here.items():
            boards.setdefault(board, []).append(Owner(f"{entry.module}.{entry.actuator}", pins))
    for owned in owned_terminals(settings):
        if owned.owner in (f"interlock {name}" for name in settings.interlocks):
            pin = Pin(owned.terminal, "must read 1 during motion", "switch")
            boards.setdefault(owned.terminal.board, []).append(Owner(owned.owner, [pin]))
    return boards


def pins_of(entry: ActuatorSettings, settings: ArmSettings) -> Iterator[tuple[tuple[str, int], Pin]]:
    """Yields the board and the row of each terminal of an actuator, and of its spring."""
    pulse = "" if entry.pulse is None else f", on for {1000 * entry.pulse:g} ms only"
    pair = entry.output_off is not None
    for terminal in actuator_terminals(entry):
        glyph = "pulse" if entry.pulse is not None else ""
        match terminal.field:
            case "output":
                yield terminal.board, Pin(terminal, f"extends{pulse}", glyph)
                if not pair:
                    yield terminal.board, Pin(None, "a spring contracts", "spring")
            case "output_off":
                yield terminal.board, Pin(terminal, f"contracts{pulse}; never both on", glyph)
            case field:
                yield terminal.board, Pin(terminal, f"end-stop, reads 1 at the {ENDS[field]} end", "switch")


def draw_board(axes: Axes, title: str, owners: list[Owner], height: float) -> None:
    """Draws one board: its terminals at the left, what is connected to them at the right."""
    axes.set(xlim=(0, 10.7), ylim=(height, 0))
    axes.axis("off")
    axes.add_patch(rectangle(0.05, 0.25, BOARD - 0.05, height - 0.5, "#EEF1F4"))
    axes.text(BOARD / 2, 0.8, title, ha="center", va="center", fontsize=9, fontweight="bold")
    y = 1.9
    for owner in owners:
        top = y
        for pin in owner.pins:
            draw_pin(axes, pin, y)
            y += 1
        axes.add_patch(rectangle(OWNER, top - 0.42, 2.3, y - top - 0.16, "white"))
        axes.text(OWNER + 1.15, (top + y - 1) / 2, owner.name, ha="center", va="center", fontsize=10, fontweight="bold")
        y += 0.6


def draw_pin(axes: Axes, pin: Pin, y: float) -> None:
    """Draws one row: terminal, wire with its direction, glyph and text."""
    terminal = pin.terminal
    colour = GREEN if terminal is None else BLUE if terminal.kind == "output" else ORANGE
    if terminal is not None:
        axes.text(BOARD - 0.1, y, f"{terminal.kind} {terminal.bit}", ha="right", va="center", fontsize=8)
        ends = (BOARD, y), (WIRE, y)
        start, end = ends if terminal.kind == "output" else ends[::-1]
        axes.annotate(
            "", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.4, "shrinkA": 0, "shrinkB": 0}
        )
        if terminal.inverted:
            axes.plot([BOARD + 0.3], [y], "o", ms=7, mfc="white", mec=RED, mew=1.4, zorder=5)
    x = [WIRE - 1.0 + 0.1 * k for k in range(11)]
    if pin.glyph == "pulse":
        axes.plot([x[1], x[4], x[4], x[7], x[7], x[9]], [y, y, y - 0.34, y - 0.34, y, y], color="white", lw=3)
        axes.plot([x[1], x[4], x[4], x[7], x[7], x[8]], [y, y, y - 0.34, y - 0.34, y, y], color=colour, lw=1.4)
    elif pin.glyph == "spring":
        axes.plot(x, [y, *[y + 0.22 * (-1) ** k for k in range(9)], y], color=colour, lw=1.4)
    elif pin.glyph == "switch":
        axes.plot([x[3], x[6]], [y, y], color="white", lw=3)
        axes.plot([x[3], x[6]], [y, y - 0.3], color=colour, lw=1.6)
    inverted = " (inverted: 0 for 1)" if terminal is not None and terminal.inverted else ""
    axes.text(TEXT, y, pin.text + inverted, ha="left", va="center", fontsize=8, color="#16191d")


def rectangle(x: float, y: float, width: float, height: float, colour: str) -> Patch:
    from matplotlib.patches import FancyBboxPatch

    return FancyBboxPatch(
        (x, y), width, height, boxstyle="round,pad=0,rounding_size=0.08", fc=colour, ec="#5C6670", lw=1.2
    )
