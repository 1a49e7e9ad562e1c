"""What a study has found: a table, and files of arms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperbit.controller.arm.saving import Fields, fields_of, write_arm
from hyperbit.controller.armfile.new_file import Answers, wiring_rows
from hyperbit.controller.design.explore import Finalist
from hyperbit.controller.design.search import Evaluation, Figures
from hyperbit.controller.design.study import Study

if TYPE_CHECKING:  # matplotlib takes half a second to import
    from matplotlib.figure import Figure

BUS = "can0"


def table(study: Study, found: Sequence[Finalist]) -> tuple[list[str], list[list[str]]]:
    """Returns the columns of a table of finalists, and its rows."""
    parameters, stuck = list(study.settings.parameters), ["stuck"] if study.stuck else []
    columns = ["arm", "reached", "switches", *stuck, "actuators", "length", "proven", *parameters]
    return columns, [row(one, stuck, parameters) for one in found]


def row(one: Finalist, stuck: Sequence[str], parameters: Sequence[str]) -> list[str]:
    own, values = one.figures, one.values or {}
    cells = [one.name, with_error(own, "reached", "{:.3f}"), with_error(own, "switches", "{:.2f}")]
    cells += [f"{own[name]:.3f}" if name in own else "" for name in stuck]
    cells += [f"{own.get('actuators', '')}", f"{own['length']:.4g}" if own else ""]
    cells.append(f"{own['proven']} of {own['targets']}" if "proven" in own else "")
    return cells + [shown(values.get(name, "")) for name in parameters]


def with_error(figures: Any, name: str, form: str) -> str:
    """Returns a figure as text, with its standard error if it has one."""
    if name not in figures:
        return ""
    error = f" ± {form.format(figures[f'{name}_error'])}" if f"{name}_error" in figures else ""
    return form.format(figures[name]) + error


def shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def notes(study: Study, found: Sequence[Finalist]) -> list[str]:
    """Returns sentences about a table."""
    if not any(one.values is not None for one in found):
        required = ", ".join(f"{name} {bound:g}" for name, bound in study.settings.require.items())
        return [f"no design meets what the study requires: {required}"]
    if any(one.final is None for one in found):
        return ["The figures are those of the search: the study ended before the arms were judged again."]
    if study.fresh:
        return [f"reached and switches are of {len(study.fresh)} new targets in the same boxes, with standard errors."]
    return ["The study lists each target, so there are no new ones: the figures are of the targets of the search."]


def as_text(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Returns a table as lines of text."""
    lines = [list(columns), *map(list, rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(columns))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )


def save(study: Study, found: Sequence[Finalist], folder: Path) -> Iterator[Path]:
    """Writes the file of each design; yields its path.

    A design without a wiring gets one to boards with 8 outputs, so that simulated boards can run it.

    Raises:
        InputFaults: an arm cannot be written as a file.
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for one in found:
        if one.values is None:
            continue
        fields = {**fields_of(one.arm.arm, one.arm.locked), "name": one.name}
        if not one.arm.arm.wiring:
            fields |= wiring(one)
        path = folder / f"{one.name}.yaml"
        figures = ", ".join(f"{name} {shown(value)}" for name, value in one.figures.items())
        write_arm(path, fields, f"A design of the study {study.settings.name}: {figures}.")
        yield path


def wiring(one: Finalist) -> Fields:
    """Returns a wiring of an arm to as few boards as have room; none if one bus has not room enough."""
    try:
        rows = wiring_rows(Answers(one.name, (), bus=BUS), one.arm.manipulator.actuators)
    except ValueError:
        return {}
    return {"buses": [{"name": BUS, "channel": BUS}], "actuators": rows}


def picture_of(study: Study, designs: Sequence[Evaluation], found: Sequence[Finalist]) -> Figure:
    """Returns a picture of designs and finalists, see draw_designs."""
    from hyperbit.controller.pictures.design_plots import DrawnArm, draw_designs

    arms = [
        DrawnArm(one.name, one.arm.manipulator, one.arm.arm.obstacles, point(one.figures), one.values is None)
        for one in found
        if one.figures
    ]
    points = np.array([point(one.figures) for one in designs]).reshape(-1, 3)
    positions = np.array([target.position for target in study.targets])
    return draw_designs(f"{study.settings.name}: {len(designs)} designs", points, arms, positions)


def point(figures: Figures) -> tuple[float, float, float]:
    return figures["actuators"], figures["switches"], figures["reached"]
