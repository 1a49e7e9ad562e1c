"""Reads measured tips from CSV files, one sample a row; each fault names its line."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.tables import PLANAR, SPATIAL, read_row
from hyperbit.controller.armfile.csv_files import read_csv
from hyperbit.controller.armfile.strict import MOST_FAULTS, InputFaults
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.manipulator.notation import parse_configuration

MOST_SAMPLES = 5000
STATES = ("configuration", "actuators")


@dataclass(frozen=True, eq=False)
class Samples:
    """The measurements."""

    configurations: NDArray[np.int64]  # configurations of the arm, shape (n, B)
    tips: Frame  # measured frames in the world, shape (n, 4, 4); not turned if only positions were measured
    oriented: bool  # whether orientations were measured
    lines: NDArray[np.int64]  # line of each sample in the file, shape (n,)

    def only(self, chosen: NDArray[np.bool_]) -> "Samples":
        """Returns the samples of a mask (n,)."""
        return replace(
            self, configurations=self.configurations[chosen], tips=self.tips[chosen], lines=self.lines[chosen]
        )


def read_samples(path: Path, manipulator: Manipulator) -> Samples:
    """Returns the samples in a CSV file.

    The first line names the columns, in any order. The state is `configuration`, as `hyperbit fk` takes it, or
    `actuators`, a 0 or 1 for each actuator in the arm's order. The tip is x, y with an optional th [rad] for a planar
    arm. For a spatial arm it is x, y, z with an optional quaternion qx, qy, qz, qw. Raises InputFaults with all faults.
    """
    faults: list[str] = []
    found: list[tuple[Configuration, Frame, int]] = []
    file = read_csv(path, MOST_SAMPLES)
    state, tip = checked_columns(path, file.columns, planar=manipulator.planar)
    for row in file.rows:
        fields = dict(zip(file.columns, row.fields, strict=True))
        sample = read_sample(fields, state, manipulator, f"line {row.line}")
        if isinstance(sample, str):
            faults.append(sample)
        else:
            found.append((*sample, row.line))
    if len(found) > MOST_SAMPLES:
        faults.append(f"more than {MOST_SAMPLES} samples")
    if faults or not found:
        raise InputFaults(path, faults[:MOST_FAULTS] or ["no samples"])
    configurations, tips, lines = zip(*found, strict=True)
    return Samples(np.array(configurations), np.array(tips), "th" in tip or "qw" in tip, np.array(lines))


def checked_columns(path: Path, columns: Sequence[str], *, planar: bool) -> tuple[str, list[str]]:
    """Returns the column of the arm's state and those of the tip, in the file's order. Raises InputFaults."""
    states, tip = [c for c in columns if c in STATES], [c for c in columns if c not in STATES]
    known = (PLANAR[:2], PLANAR) if planar else (SPATIAL[:3], SPATIAL)
    if len(states) != 1 or sorted(tip) not in [sorted(names) for names in known]:
        forms = " or ".join(",".join(names) for names in known)
        given = ",".join(columns) or "none"
        raise InputFaults(path, [f"columns {' or '.join(STATES)}, and {forms}, are needed for this arm, got {given}"])
    return states[0], tip


def read_sample(
    row: dict[str, str], state: str, manipulator: Manipulator, where: str
) -> tuple[Configuration, Frame] | str:
    """Returns the configuration (B,) and the tip (4, 4) of a row, or a fault."""
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
    """Returns the states (A,) of a text of 0 and 1. Raises ValueError if the text has other characters."""
    if set(text.strip()) - {"0", "1"}:
        raise ValueError(f"a 0 or 1 for each actuator is needed, got {text!r}")
    return np.array([int(digit) for digit in text.strip()], dtype=np.int8)
