"""The fields of a study's file, and their faults."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

from hyperbit.controller.armfile.fields import (
    Angle,
    AngleTolerance,
    Name,
    Positive,
    Quaternion,
    Sides,
    Vector,
)
from hyperbit.controller.armfile.strict import shown
from hyperbit.controller.design.template import names_in

Objective = Literal["reached", "switches", "stuck", "actuators", "length"]
Work = Annotated[float, Meta(gt=0, le=1e6, description="in units of effort")]
Whole = Annotated[int, Meta(ge=1, le=1000)]
Ends = Annotated[list[int | float], Meta(min_length=2, max_length=2)]
Choices = Annotated[list[int | float | str], Meta(min_length=2, max_length=100)]

MOST_PARAMETERS, MOST_TARGETS = 20, 1000
LARGEST = 1e6  # of a bound


class ParameterSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """A parameter: a number between two ends, whole if both are, in steps if there is a step; or one of some values."""

    between: Ends | None = None
    step: Positive | None = None
    among: Choices | None = None

    @property
    def whole(self) -> bool:
        """Whether each value is a whole number."""
        return all(isinstance(value, int) for value in (*(self.between or ()), *([self.step] if self.step else [])))


class BoxRegion(Struct, forbid_unknown_fields=True, frozen=True):
    """A box parallel to the world's axes."""

    centre: Vector
    size: Sides


class TargetSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """A target, or `count` targets at random in a box; each with a weight, tolerances, and an orientation."""

    position: Vector | None = None
    box: BoxRegion | None = None
    count: Whole | None = None
    orientation: Angle | Quaternion | None = None
    tolerance: Positive | None = None
    angle_tolerance: AngleTolerance | None = None
    weight: Positive = 1.0


class EffortSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """Work for a target, and for one that is missed."""

    search: Work = 20.0
    missed: Work = 200.0


class FinalistSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """Designs that are judged again: most of them, work for a target and a missed one, number of new targets."""

    most: Annotated[int, Meta(ge=1, le=100)] = 20
    search: Work = 200.0
    missed: Work = 1000.0
    targets: Whole = 200


class StudySettings(Struct, forbid_unknown_fields=True, frozen=True):
    """The whole file."""

    name: Name
    parameters: dict[Name, ParameterSettings]
    arm: dict[str, Any]
    targets: list[TargetSettings]
    objectives: Annotated[list[Objective], Meta(min_length=2, max_length=3)] = field(
        default_factory=lambda: ["reached", "switches", "actuators"]
    )
    require: dict[Objective, Annotated[float, Meta(ge=0, le=LARGEST)]] = field(default_factory=dict)
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 0
    evaluations: Annotated[int, Meta(ge=1, le=100_000)] = 300
    effort: EffortSettings = EffortSettings()
    finalists: FinalistSettings = FinalistSettings()
    arms: Annotated[list[str], Meta(max_length=20)] = field(default_factory=list)


def faults_of(settings: StudySettings) -> list[str]:
    """Returns the faults of a study that involve several fields, each with its path."""
    found = parameter_faults(settings) + target_faults(settings.targets)
    twice = [name for k, name in enumerate(settings.objectives) if name in settings.objectives[:k]]
    return found + [f"objectives: {name} occurs twice" for name in twice]


def parameter_faults(settings: StudySettings) -> list[str]:
    """Returns the faults of parameters, and of the places that name them."""
    known, found = settings.parameters, list[str]()
    if not 1 <= len(known) <= MOST_PARAMETERS:
        found.append(f"parameters: 1 to {MOST_PARAMETERS} are needed, got {len(known)}")
    for name, own in known.items():
        if (own.between is None) == (own.among is None):
            found.append(f"parameters.{name}: either between or among is needed")
        elif own.between is not None:
            low, high = own.between
            if not -LARGEST <= low < high <= LARGEST:
                found.append(f"parameters.{name}.between: {low:g} must be less than {high:g}, within {LARGEST:g}")
            elif own.step is not None and own.step > high - low:
                found.append(f"parameters.{name}.step: {own.step:g} is more than from {low:g} to {high:g}")
        elif own.step is not None:
            found.append(f"parameters.{name}.step: only a number between two ends has a step")
        elif len({repr(value) for value in own.among or ()}) < len(own.among or ()):
            found.append(f"parameters.{name}.among: a value occurs twice")
    named = list(names_in(settings.arm))
    names = ", ".join(known) or "no parameter"
    found += [f"arm.{path}: ${name} is no parameter; there are {names}" for name, path in named if name not in known]
    used = {name for name, _ in named}
    return found + [f"parameters.{name}: the arm does not use ${name}" for name in known if name not in used]


def target_faults(targets: Sequence[TargetSettings]) -> list[str]:
    """Returns the faults of targets but for their dimension."""
    found, count = list[str](), 0
    for k, own in enumerate(targets):
        count += own.count or 1
        if (own.position is None) == (own.box is None):
            found.append(f"targets[{k}]: either position or box is needed")
        elif (own.count is None) != (own.box is None):
            found.append(f"targets[{k}].count: a box needs the number of its targets, and a position has none")
        if own.angle_tolerance is not None and own.orientation is None:
            found.append(f"targets[{k}].angle_tolerance: the target has no orientation")
    if not 1 <= count <= MOST_TARGETS:
        found.append(f"targets: 1 to {MOST_TARGETS} are needed, got {count}")
    return found


def dimension_faults(targets: Sequence[TargetSettings], dimension: int) -> list[str]:
    """Returns the faults of targets that do not suit an arm of a dimension, 2 or 3."""
    arm, found = ("a planar arm has 2" if dimension == 2 else "a spatial arm has 3"), list[str]()
    for k, own in enumerate(targets):
        places = {"position": own.position}
        if own.box is not None:
            places |= {"box.centre": own.box.centre, "box.size": own.box.size}
        for name, place in places.items():
            if place is not None and len(place) != dimension:
                found.append(f"targets[{k}].{name}: {arm} coordinates, got {len(place)}")
        if own.orientation is not None and isinstance(own.orientation, list) != (dimension == 3):
            form = "an angle [rad]" if dimension == 2 else "a quaternion x, y, z, w"
            found.append(f"targets[{k}].orientation: {form} is needed, got {shown(own.orientation)}")
        elif isinstance(own.orientation, list) and abs(sum(part**2 for part in own.orientation) - 1) > 2e-3:
            found.append(f"targets[{k}].orientation: a quaternion of length 1 is needed, got {own.orientation}")
    return found
