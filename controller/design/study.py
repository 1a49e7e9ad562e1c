"""A study: parameters of an arm, targets, and what makes one design better than another."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from hyperbit.controller.arm.arm import build, load
from hyperbit.controller.arm.saving import listed
from hyperbit.controller.armfile.documents import read_yaml
from hyperbit.controller.armfile.places import placed_faults
from hyperbit.controller.armfile.settings import parse_settings, with_wiring
from hyperbit.controller.armfile.strict import InputFaults, check
from hyperbit.controller.armfile.units import factors
from hyperbit.controller.design.merit import Judged, Target, judged
from hyperbit.controller.design.settings import (
    ParameterSettings,
    StudySettings,
    TargetSettings,
    dimension_faults,
    faults_of,
)
from hyperbit.controller.design.template import Value, Values, filled
from hyperbit.controller.manipulator import frames

Build = Callable[[Values], Judged]

MOST_IMPOSSIBLE = 200  # draws in a row
LOOKED_AT = 32  # random arms whose length is compared with the distances of targets
DIGITS = 10  # of values
NAME = "design"  # of arms before they are saved


class Impossible(ValueError):
    """The values of a design describe no arm; the text is the fault, with the path of its field."""


class Compared(NamedTuple):
    """An arm that exists, for comparison."""

    name: str
    arm: Judged


@dataclass(frozen=True, eq=False)
class Study:
    """A study that can be searched. It can be pickled if its function `build` can be.

    Attributes:
        settings: fields of the study; its `arm` and `targets` are used up.
        build: returns the arm of a design. Raises Impossible.
        targets: of the search.
        fresh: of the same boxes, for finalists; empty if the study has no boxes.
        compared: arms for comparison.
        digest: of all that the figures depend on.
    """

    settings: StudySettings
    build: Build
    targets: tuple[Target, ...]
    fresh: tuple[Target, ...]
    compared: tuple[Compared, ...]
    digest: str

    @property
    def stuck(self) -> bool:
        """Whether the study asks for reach with a stuck actuator."""
        return "stuck" in (*self.settings.objectives, *self.settings.require)

    def warnings(self) -> list[str]:
        """Returns a warning for each target that no arm of several random ones is long enough for."""
        arms = [arm for arm in some_arms(self.build, self.settings, LOOKED_AT) if isinstance(arm, Judged)]
        reaches = [(arm.manipulator.base[:3, 3], arm.manipulator.length + arm.arm.tolerance) for arm in arms]
        far = [
            np.round(target.position, 4).tolist()
            for target in self.targets
            if not any(np.linalg.norm(padded(target.position) - base) <= reach for base, reach in reaches)
        ]
        words = f"more than the length of each of {len(arms)} random arms from the base"
        return [f"target {position} is {words}" for position in far] if arms else []


@dataclass(frozen=True)
class Template:
    """Builds arms from the fields of an arm's file with `$name` for parameters."""

    fields: Mapping[str, Any]

    def __call__(self, values: Values) -> Judged:
        """Returns the arm of some values. Raises Impossible."""
        faults: list[str] = []
        settings = parse_settings({"name": NAME, **filled(self.fields, values)}, Path(), faults)
        if settings is None:
            raise Impossible(faults[0])
        try:
            arm = build(settings, Path(NAME), faults)
        except InputFaults as error:
            raise Impossible(error.faults[0]) from None
        return judged(arm)


def read_study(path: Path) -> Study:
    """Reads the file of a study. Paths in it are relative to its folder.

    Raises:
        InputFaults: the file is missing or wrong; each fault has its line.
    """
    with placed_faults(path):
        faults: list[str] = []
        raw = read_yaml(path)
        settings = check(raw, StudySettings, faults, factors(unit_of(raw)))
        faults += [] if settings is None else faults_of(settings)
        if settings is None or faults:
            raise InputFaults(path, faults)
        template = Template(with_tables(settings.arm, path))
        if faults := certain_faults(template, settings.parameters):
            raise InputFaults(path, faults)
        compared = tuple(Compared(Path(name).stem, judged(load(path.parent / name))) for name in settings.arms)
        plain = msgspec.to_builtins(msgspec.structs.replace(settings, arm=template.fields, evaluations=1, seed=0))
        content = [plain, settings.seed, [one.arm.arm.digest for one in compared]]
        study, faults = opened(settings, template, compared, digest_of(content))
        if study is None:
            raise InputFaults(path, faults)
        return study


def opened(
    settings: StudySettings, build_arm: Build, compared: Sequence[Compared], digest: str
) -> tuple[Study | None, list[str]]:
    """Returns the study of checked fields and its arms, or None and faults."""
    random, faults = np.random.default_rng(settings.seed), list[str]()
    for found in some_arms(build_arm, settings, MOST_IMPOSSIBLE):
        if isinstance(found, Judged):
            break
        faults.append(found)
    else:
        return None, [all_impossible(faults)]
    dimension = found.manipulator.dimension
    wrong = dimension_faults(settings.targets, dimension)
    for k, other in enumerate(compared):
        if other.arm.manipulator.dimension != dimension:
            kinds = ("planar", "spatial") if dimension == 2 else ("spatial", "planar")
            wrong.append(f"arms[{k}]: the designs are {kinds[0]}, and {other.name} is {kinds[1]}")
    if wrong:
        return None, wrong
    targets = [target for own in settings.targets for target in targets_of(own, own.count or 1, random)]
    fresh = list(fresh_targets(settings))
    return Study(settings, build_arm, tuple(targets), tuple(fresh), tuple(compared), digest), []


def some_arms(build_arm: Build, settings: StudySettings, count: int) -> Iterator[Judged | str]:
    """Yields random arms, or the faults of those that are impossible."""
    random = np.random.default_rng(0)
    for _ in range(count):
        try:
            yield build_arm(random_values(settings, random))
        except Impossible as error:
            yield str(error)


def all_impossible(faults: Sequence[str]) -> str:
    """Returns the fault of a study after impossible draws only; it names the place that most of them name."""
    places = Counter(fault.partition(": ")[0] for fault in faults)
    place, count = places.most_common(1)[0]
    example = next(fault for fault in faults if fault.partition(": ")[0] == place).partition(": ")[2]
    words = f"{len(faults)} random designs in a row were impossible, {count} of them here, the first as {example}"
    return f"arm.{place}: {words}"


def random_values(settings: StudySettings, random: np.random.Generator) -> Values:
    """Returns random values of all parameters."""
    return {name: drawn(own, random) for name, own in settings.parameters.items()}


def drawn(own: ParameterSettings, random: np.random.Generator) -> Value:
    """Returns a random value of a parameter."""
    if own.among is not None:
        return own.among[int(random.integers(len(own.among)))]
    low, high = own.between or (0, 0)
    if own.whole:
        step = int(own.step or 1)
        return int(low) + step * int(random.integers(int(high - low) // step + 1))
    if own.step is not None:
        return rounded(low + own.step * int(random.integers(int((high - low) / own.step + 1e-9) + 1)))
    return rounded(float(random.uniform(low, high)))


def rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def targets_of(own: TargetSettings, count: int, random: np.random.Generator) -> Iterator[Target]:
    """Yields a target, or `count` random ones of its box."""
    for _ in range(count):
        if own.box is None:
            position = np.array(own.position, dtype=float)
        else:
            centre, size = np.array(own.box.centre, dtype=float), np.array(own.box.size, dtype=float)
            position = centre + size * (random.random(len(centre)) - 0.5)
        yield Target(goal_of(position, own.orientation), own.tolerance, own.angle_tolerance, own.weight)


def goal_of(position: Any, orientation: Any) -> Any:
    """Returns a position (2,) or (3,), or the frame (4, 4) of a pose."""
    if orientation is None:
        return position
    if isinstance(orientation, list):
        return frames.spatial(position, orientation)
    return frames.planar(float(position[0]), float(position[1]), float(orientation))


def fresh_targets(settings: StudySettings) -> Iterator[Target]:
    """Yields new targets of the boxes; each box has its share of them."""
    boxes = [own for own in settings.targets if own.box is not None]
    total, random = sum(own.count or 1 for own in boxes), np.random.default_rng([settings.seed, 1])
    done = seen = 0
    for own in boxes:
        seen += own.count or 1
        until = round(settings.finalists.targets * seen / total)
        yield from targets_of(own, until - done, random)
        done = until


def certain_faults(template: Template, parameters: Mapping[str, ParameterSettings]) -> list[str]:
    """Returns the faults of the arm that no values change, with their paths in the study's file."""
    each = list[set[str]]()
    for pick in (0, -1):
        ends = {name: (own.between or own.among or [0])[pick] for name, own in parameters.items()}
        faults: list[str] = []
        parse_settings({"name": NAME, **filled(template.fields, ends)}, Path(), faults)
        each.append(set(faults))
    return [f"arm.{fault}" for fault in sorted(each[0] & each[1])]


def with_tables(fields: Mapping[str, Any], path: Path) -> Mapping[str, Any]:
    """Returns an arm's fields with the content of its CSV files, which workers elsewhere need."""
    faults: list[str] = []
    own = dict(with_wiring(fields, path.parent, faults))
    if "actuators" in own:
        own.pop("wiring", None)
    modules = own.get("modules")
    if isinstance(modules, list) and all(isinstance(entry, dict) for entry in modules):
        own["modules"] = listed(modules, path.parent, faults)
    if faults:
        raise InputFaults(path, [f"arm.{fault}" for fault in faults])
    return own


def unit_of(raw: Any) -> Any:
    """Returns the unit that the arm of a study's file names."""
    arm = raw.get("arm") if isinstance(raw, dict) else None
    return arm.get("unit") if isinstance(arm, dict) else None


def digest_of(content: Any) -> str:
    """Returns a digest of plain values."""
    return hashlib.sha256(msgspec.json.encode(content, order="sorted")).hexdigest()


def padded(position: Any) -> Any:
    return np.append(position, [0.0] * (3 - len(position)))
