"""Measured tips in CSV files, a row for each sample, and every fault in them by its line."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.frames import Frame
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.manipulator.notation import parse_configuration
from controller.strict import MOST_FAULTS, InputFaults
from controller.tables import PLANAR, SPATIAL, read_row

MOST_SAMPLES = 5000
STATES = ("configuration", "actuators")


@dataclass(frozen=True, eq=False)
class Samples:
    """What was measured.

    Attributes:
        configurations: of the arm, shape (n, B).
        tips: frames measured in the world, shape (n, 4, 4); of no turn where only positions were.
        oriented: whether orientations were measured, too.
        lines: of the file, shape (n,).
    """

    configurations: NDArray[np.int64]
    tips: Frame
    oriented: bool
    lines: NDArray[np.int64]

    def only(self, chosen: NDArray[np.bool_]) -> "Samples":
        """Returns the samples that a mask (n,) chooses."""
        return replace(
            self, configurations=self.configurations[chosen], tips=self.tips[chosen], lines=self.lines[chosen]
        )


def read_samples(path: Path, manipulator: Manipulator) -> Samples:
    """Returns the samples in a CSV file.

    The first line names the columns, in any order: `configuration` as `hyperbit fk` takes it, or `actuators`, a 0 or 1
    for each in the order of the arm's actuators; and the tip as x, y and maybe th [rad], for a spatial arm x, y, z and
    maybe a quaternion qx, qy, qz, qw.

    Raises:
        InputFaults: the file is missing, or what is wrong in which lines.
    """
    faults: list[str] = []
    found: list[tuple[Configuration, Frame, int]] = []
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # spreadsheets put a mark before it
            reader = csv.reader(file, skipinitialspace=True, strict=True)
            columns = [column.strip() for column in next(reader, [])]
            state, tip = checked_columns(path, columns, planar=manipulator.planar)
            for row in islice(reader, MOST_SAMPLES + 1):
                if row:
                    where = f"line {reader.line_num}"
                    fields = dict(zip(columns, row, strict=False))
                    sample = read_sample(fields, len(row), state, tip, manipulator, where)
                    if isinstance(sample, str):
                        faults.append(sample)
                    else:
                        found.append((*sample, reader.line_num))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputFaults(path, [f"cannot be read: {reason}"]) from None
    if len(found) > MOST_SAMPLES:
        faults.append(f"more than {MOST_SAMPLES} samples")
    if faults or not found:
        raise InputFaults(path, faults[:MOST_FAULTS] or ["no samples"])
    configurations, tips, lines = zip(*found, strict=True)
    return Samples(np.array(configurations), np.array(tips), "th" in tip or "qw" in tip, np.array(lines))


def checked_columns(path: Path, columns: Sequence[str], *, planar: bool) -> tuple[str, list[str]]:
    """Returns which column tells the arm's state, and those of the tip, in the file's order.

    Raises:
        InputFaults: they are others.
    """
    states, tip = [c for c in columns if c in STATES], [c for c in columns if c not in STATES]
    known = (PLANAR[:2], PLANAR) if planar else (SPATIAL[:3], SPATIAL)
    if len(states) != 1 or sorted(tip) not in [sorted(names) for names in known]:
        forms = " or ".join(",".join(names) for names in known)
        given = ",".join(columns) or "none"
        raise InputFaults(path, [f"columns {' or '.join(STATES)}, and {forms}, are needed for this arm, got {given}"])
    return states[0], tip


def read_sample(
    row: dict[str, str], count: int, state: str, tip: Sequence[str], manipulator: Manipulator, where: str
) -> tuple[Configuration, Frame] | str:
    """Returns the configuration (B,) and the tip (4, 4) in a row of `count` fields, or what is wrong."""
    if count != 1 + len(tip):
        return f"{where}: {1 + len(tip)} fields are needed, got {count}; a configuration with commas stands in quotes"
    try:
        if state == "configuration":
            configuration = parse_configuration(manipulator, row[state])
        else:
            configuration = manipulator.configuration(actuator_states(row[state]))
    except ValueError as error:
        return f"{where}: {state}: {error}"
    faults: list[str] = []
    still = {"th": "0", "qx": "0", "qy": "0", "qz": "0", "qw": "1"}
    every = PLANAR if manipulator.planar else SPATIAL
    frame = read_row([row[name] if name in row else still[name] for name in every], every, where, faults)
    return faults[0] if frame is None else (configuration, frame)


def actuator_states(text: str) -> NDArray[np.int8]:
    """Returns the states (A,) that a text of 0 and 1 spells.

    Raises:
        ValueError: it holds anything else.
    """
    if set(text.strip()) - {"0", "1"}:
        raise ValueError(f"a 0 or 1 for each actuator is needed, got {text!r}")
    return np.array([int(digit) for digit in text.strip()], dtype=np.int8)
