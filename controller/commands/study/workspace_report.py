"""The figures of the command `workspace`, as fields for JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.manipulator.frames import quaternion

if TYPE_CHECKING:
    from hyperbit.controller.workspace.coverage import Coverage, Range
    from hyperbit.controller.workspace.densities import Densities
    from hyperbit.controller.workspace.locked_reach import LockedReach, Reach
    from hyperbit.controller.workspace.orientations import Orientations

FIGURES = ("reach", "covered", "log10_redundancy")
DRAWN = "random draws, weighted by the Mapping Algorithm's densities; a grid over orientations would be far too coarse"
COUNTED = {
    "listing": "the arm has few configurations, all are listed",
    "halves": "configurations are counted exactly, as pairs of two lists",
    "draws": "random draws, weighted by the Mapping Algorithm's densities; the arm has too many configurations to list",
}
LOCKED = "a lock changes only the intermediate workspaces below its module; the others are mapped once"


class WorkspaceStudy(NamedTuple):
    """What was found on the workspace of an arm: of the reduced arm, and with locked actuators."""

    arm: Arm
    densities: Densities
    coverage: Coverage
    tolerance: float
    point: list[float] | None  # at which orientations were counted, shape (dimension,)
    orientations: Orientations | None
    locks: int  # number of locked actuators; 0: none
    locked_reach: LockedReach | None


def describe_study(study: WorkspaceStudy) -> dict[str, Any]:
    arm, found, reach = study.arm, study.orientations, study.locked_reach
    fields: dict[str, Any] = {"arm": arm.settings.name, "tolerance": study.tolerance}
    fields["positions"] = positions(study.coverage)
    if found is not None:
        fields["at"] = {"position": study.point, **orientations(found, planar=arm.manipulator.planar)}
    if reach is not None:
        fields["locked"] = locks(arm, reach, study.locks)
    return fields


def positions(found: Coverage) -> dict[str, Any]:
    """Returns the figures of positions. Names of logarithms begin with `log10_`."""
    return {
        "method": found.method,
        "why": COUNTED[found.method],
        "positions": found.positions,
        "log10_configurations": found.log10_configurations,
        "covered": limits(found.area),
        "log10_redundancy": limits(found.log10_median),
        "log10_greatest_redundancy": found.log10_greatest,
        "densest": found.densest.tolist(),
    }


def limits(figure: Range) -> dict[str, float]:
    return {"lower": figure.lower, "estimate": figure.middle, "upper": figure.upper}


def orientations(found: Orientations, *, planar: bool) -> dict[str, Any]:
    from hyperbit.controller.pictures.orientation_plots import angles_of, arcs, directions, twists

    exact = found.draws == 0
    fields: dict[str, Any] = {
        "method": "enumeration" if exact else "mapping",
        "why": "the arm has few configurations, all are enumerated" if exact else DRAWN,
        "configurations": found.total,
        "standard_error": found.deviation,
        "draws": found.draws,
        "mean": None,
        "spread": None,
    }
    if len(found.counts) == 0:
        return fields
    frame = np.eye(4)
    frame[:3, :3] = found.mean
    fields["mean"] = float(angles_of(frame[None, :3, :3])[0]) if planar else quaternion(frame).tolist()
    fields["spread"] = found.spread
    if planar:
        return fields | {"angles": arcs(angles_of(found.rotations), found.counts).tolist()}
    return fields | {
        "directions": directions(found).tolist(),
        "twists": arcs(twists(found.rotations), found.counts).tolist(),
    }


def locks(arm: Arm, found: LockedReach, locked: int) -> dict[str, Any]:
    return {
        "method": "mapping",
        "why": LOCKED,
        "actuators": locked,
        "every": found.every,
        "impossible": found.impossible,
        "pixel": found.pixel,
        "free": figures(found.free),
        "mean": {name: finite(found.mean(name)) for name in FIGURES},
        "worst": {name: choice(arm, found.worst(name)) for name in FIGURES},
        "choices": [choice(arm, one) for one in found.choices],
    }


def figures(reach: Reach) -> dict[str, float | None]:
    return {name: finite(getattr(reach, name)) for name in FIGURES}


def choice(arm: Arm, reach: Reach) -> dict[str, Any]:
    """Returns the figures of one choice of locked actuators, and the locked states by label."""
    labels = zip(arm.manipulator.actuators, reach.locked.tolist(), strict=True)
    return {"locked": {label: STATES[state] for label, state in labels if state >= 0}, **figures(reach)}


def finite(value: float) -> float | None:
    """Returns a number, or None if it is infinite: JSON has no infinity."""
    return value if math.isfinite(value) else None
