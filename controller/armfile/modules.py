"""The entries of `modules` of an arm's file: modules by type, groups that repeat, and the chain that they make."""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

from msgspec import Meta, Struct, field

from hyperbit.controller.armfile.fields import (
    Angle,
    Coordinate,
    Count,
    Diagonal,
    Direction,
    Pair,
    Positive,
    Quaternion,
    SpatialDirection,
    Vector,
)

MOST_MODULES = 10_000  # of a chain


class FrameSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """A frame: planar with an angle [rad], or spatial with a quaternion x, y, z, w."""

    position: Vector
    orientation: Angle | Quaternion = 0.0


class VgtLengths(Struct, forbid_unknown_fields=True, frozen=True):
    """Contracted and extended length of each actuator of a truss module."""

    left: Pair
    diagonal: Pair
    right: Pair


class VgtSettings(Struct, tag_field="type", tag="vgt", forbid_unknown_fields=True, frozen=True):
    """`count` truss modules of the paper's section 4; the diagonals alternate, beginning with `first_diagonal`."""

    width: Positive
    lengths: Pair | VgtLengths
    count: Count = 1
    first_diagonal: Diagonal = "BC"


class RevoluteSettings(Struct, tag_field="type", tag="revolute", forbid_unknown_fields=True, frozen=True):
    """`count` revolute joints at one of the angles, or turned by cylinders in series [rad], each followed by a link."""

    angles: Annotated[list[Angle], Meta(min_length=2, max_length=4096)] | None = None
    cylinders: Annotated[list[tuple[Angle, Angle]], Meta(min_length=1, max_length=12)] | None = None
    axis: SpatialDirection = field(default_factory=lambda: [0.0, 0.0, 1.0])
    link: FrameSettings = FrameSettings([0.0, 0.0])
    count: Count = 1


class PrismaticSettings(Struct, tag_field="type", tag="prismatic", forbid_unknown_fields=True, frozen=True):
    """`count` prismatic joints at one of the lengths, or moved by cylinders in series, each followed by a link."""

    axis: Direction
    lengths: Annotated[list[Coordinate], Meta(min_length=2, max_length=4096)] | None = None
    cylinders: Annotated[list[tuple[Coordinate, Coordinate]], Meta(min_length=1, max_length=12)] | None = None
    link: FrameSettings = FrameSettings([0.0, 0.0])
    count: Count = 1


class PlatformSettings(Struct, tag_field="type", tag="platform", forbid_unknown_fields=True, frozen=True):
    """`count` platforms on legs: lower joints in the frame below, upper joints in the frame above, lengths of a leg."""

    base: Annotated[list[Vector], Meta(min_length=3, max_length=6)]
    top: Annotated[list[Vector], Meta(min_length=3, max_length=6)]
    lengths: Pair
    count: Count = 1


class TransformsSettings(Struct, tag_field="type", tag="transforms", forbid_unknown_fields=True, frozen=True):
    """`count` modules whose states are frames, listed here or in a CSV file beside the arm's file."""

    states: Annotated[list[FrameSettings], Meta(min_length=2, max_length=4096)] | None = None
    table: str | None = None
    count: Count = 1


ModuleSettings = VgtSettings | RevoluteSettings | PrismaticSettings | PlatformSettings | TransformsSettings


class GroupSettings(Struct, tag_field="type", tag="group", forbid_unknown_fields=True, frozen=True):
    """`count` repetitions of a list of modules, such as a slide and a joint. A file may leave `type: group` out."""

    modules: Annotated[list[ModuleSettings], Meta(min_length=1)]
    count: Count = 1


EntrySettings = ModuleSettings | GroupSettings


class ChainEntry(NamedTuple):
    """Modules of one entry in their place of the chain."""

    path: str  # of the entry in the file, such as modules[1].modules[0]
    repetition: int  # of the group around, from 1; 0 outside of groups
    settings: ModuleSettings

    @property
    def place(self) -> str:
        """The entry in words; positions count from 1 after `places`."""
        return self.path + (f" in repetition {self.repetition}" if self.repetition else "")


def with_group_types(document: Any) -> Any:
    """Returns the value of a file with `type: group` for each entry that has `modules` and no type."""
    if not isinstance(document, dict) or not isinstance(document.get("modules"), list):
        return document
    group = {"type": "group"}
    named = [group | it if isinstance(it, dict) and "modules" in it else it for it in document["modules"]]
    return {**document, "modules": named}


def count_modules(entries: Sequence[EntrySettings]) -> int:
    """Returns the number of modules of a chain."""
    groups = (entry for entry in entries if isinstance(entry, GroupSettings))
    single = sum(entry.count for entry in entries if not isinstance(entry, GroupSettings))
    return single + sum(group.count * sum(own.count for own in group.modules) for group in groups)


def chain(entries: Sequence[EntrySettings]) -> list[ChainEntry]:
    """Returns the entries of a chain, base first, with those of groups as often as the group repeats."""
    found: list[ChainEntry] = []
    for g, entry in enumerate(entries):
        if not isinstance(entry, GroupSettings):
            found.append(ChainEntry(f"modules[{g}]", 0, entry))
            continue
        for k in range(entry.count):
            found += [ChainEntry(f"modules[{g}].modules[{j}]", k + 1, own) for j, own in enumerate(entry.modules)]
    return found


def places(entries: Sequence[EntrySettings]) -> list[ChainEntry]:
    """Returns the entry of each module of a chain, base first."""
    return [entry for entry in chain(entries) for _ in range(entry.settings.count)]
