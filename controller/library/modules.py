"""Modules for arms built in code. Each function returns an entry of `modules` of an arm's file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from msgspec import Struct, to_builtins
from numpy.typing import NDArray

from hyperbit.controller.arm import arm as config
from hyperbit.controller.arm.saving import frame_fields
from hyperbit.controller.armfile.fields import Diagonal
from hyperbit.controller.armfile.modules import (
    EntrySettings,
    FrameSettings,
    GroupSettings,
    PlatformSettings,
    PrismaticSettings,
    RevoluteSettings,
    TransformsSettings,
    VgtSettings,
)
from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.armfile.strict import InputFaults, check
from hyperbit.controller.library.arguments import Count, Number, Numbers, typed
from hyperbit.controller.library.errors import ArmError
from hyperbit.controller.manipulator import frames

S = TypeVar("S", bound=Struct)

Module = EntrySettings
Lengths: TypeAlias = "Sequence[Number] | Mapping[str, Sequence[Number]] | NDArray[Any]"

NO_NAMES: Mapping[str, str] = {}
RIGID = 1e-6  # greatest difference of R^T R from the identity


def checked(kind: type[S], fields: dict[str, Any], where: str, names: Mapping[str, str] = NO_NAMES) -> S:
    """Returns a struct of the arm's file with these fields; fields that are None are omitted.

    `names` are those of arguments by the fields that they became.

    Raises:
        ArmError: a field is wrong.
    """
    faults: list[str] = []
    tag = {"type": kind.__struct_config__.tag} if kind.__struct_config__.tag else {}
    given = {name: value for name, value in fields.items() if value is not None}
    result = check({**tag, **given}, kind, faults)
    if result is None:
        for field, argument in names.items():
            faults = [fault.replace(field, argument) for fault in faults]
        raise ArmError(faults, where)
    return result


def plain(values: Numbers) -> Any:
    """Returns an array as nested lists of floats.

    Raises:
        ArmError: a value is no number, or the rows differ in length.
    """
    try:
        return np.asarray(values, dtype=float).tolist()
    except (TypeError, ValueError):
        raise ArmError([f"an array of numbers is needed, got {values!r:.80}"]) from None


@typed(ArmError)
def vgt(
    first_diagonal: Diagonal = "BC",
    *,
    width: Number,
    lengths: Lengths,
    count: Count = 1,
) -> VgtSettings:
    """Returns `count` variable geometry truss modules (Ebert-Uphoff and Chirikjian 1996, section 4).

    Args:
        first_diagonal: diagonal of the first module, "BC" or "AD"; the diagonals of further modules alternate.
        width: width of base and top, in the arm's unit of length.
        lengths: contracted and extended length of all legs, shape (2,), or one pair for each leg by its name.
        count: number of modules.

    Raises:
        ArmError: a value is out of its bounds.
    """
    legs = {name: plain(pair) for name, pair in lengths.items()} if isinstance(lengths, Mapping) else plain(lengths)
    fields = {"first_diagonal": first_diagonal, "width": plain(width), "lengths": legs, "count": count}
    return checked(VgtSettings, fields, "vgt")


@typed(ArmError)
def revolute(
    angles: Numbers | None = None,
    *,
    cylinders: Numbers | None = None,
    link: Numbers = (0.0, 0.0),
    axis: Numbers = (0.0, 0.0, 1.0),
    count: Count = 1,
) -> RevoluteSettings:
    """Returns `count` revolute joints with K angles, or with n cylinders in series.

    Args:
        angles: shape (K,) [rad].
        cylinders: in place of `angles`: what each cylinder adds contracted and extended, shape (n, 2) [rad].
        link: position of the next module in the turned frame, shape (2,) or (3,), or its frame, shape (4, 4).
        axis: of rotation, shape (3,).
        count: number of modules.

    Raises:
        ArmError: a value is out of its bounds.
    """
    values = {name: plain(it) for name, it in (("angles", angles), ("cylinders", cylinders)) if it is not None}
    fields = {**values, "axis": plain(axis), "link": placement(link), "count": count}
    return checked(RevoluteSettings, fields, "revolute")


@typed(ArmError)
def prismatic(
    axis: Numbers,
    lengths: Numbers | None = None,
    *,
    cylinders: Numbers | None = None,
    link: Numbers = (0.0, 0.0),
    count: Count = 1,
) -> PrismaticSettings:
    """Returns `count` prismatic joints with K lengths, or with n cylinders in series.

    Args:
        axis: direction of sliding, shape (2,) or (3,).
        lengths: shape (K,), ascending.
        cylinders: in place of `lengths`: what each cylinder adds contracted and extended, shape (n, 2).
        link: position of the next module in the moved frame, shape (2,) or (3,), or its frame, shape (4, 4).
        count: number of modules.

    Raises:
        ArmError: a value is out of its bounds.
    """
    values = {name: plain(it) for name, it in (("lengths", lengths), ("cylinders", cylinders)) if it is not None}
    fields = {**values, "axis": plain(axis), "link": placement(link), "count": count}
    return checked(PrismaticSettings, fields, "prismatic")


@typed(ArmError)
def platform(base: Numbers, top: Numbers, lengths: Numbers, *, count: Count = 1) -> PlatformSettings:
    """Returns `count` platforms on two-state legs: planar with three legs, spatial with three or six.

    Args:
        base: joints of the legs in the frame below, shape (L, 2) or (L, 3).
        top: joints of the legs in the frame above, same shape.
        lengths: contracted and extended length of each leg, shape (2,).
        count: number of modules.

    Raises:
        ArmError: a value is out of its bounds.
    """
    fields = {"base": plain(base), "top": plain(top), "lengths": plain(lengths), "count": count}
    return checked(PlatformSettings, fields, "platform")


@typed(ArmError)
def transforms(states: Numbers, *, count: Count = 1) -> TransformsSettings:
    """Returns `count` modules with arbitrary frames; binary actuators "1", "2", ... encode the states.

    Args:
        states: frame of the next module in each of K states, shape (K, 4, 4). The module is planar if all frames stay
            in the plane z = 0.
        count: number of modules.

    Raises:
        ArmError: the frames are not rigid, or a value is out of its bounds.
    """
    stack = np.array(plain(states))
    if stack.ndim != 3 or stack.shape[1:] != (4, 4):
        raise ArmError([f"states: frames of shape (K, 4, 4) are needed, got shape {stack.shape}"], "transforms")
    planar = all(in_plane(frame) for frame in stack)
    listed = [rigid_fields(frame, planar=planar) for frame in stack]
    return checked(TransformsSettings, {"states": listed, "count": count}, "transforms")


@typed(ArmError)
def group(modules: Sequence[Module], count: Count) -> GroupSettings:
    """Returns `count` repetitions of a list of modules, such as a slide and a joint; calibration shares their numbers.

    Args:
        modules: entries of the chain, base first; none of them a group.
        count: number of repetitions.

    Raises:
        ArmError: a module is a group, or the count is out of its bounds.
    """
    return checked(GroupSettings, {"modules": to_builtins(list(modules)), "count": count}, "group")


def placement(given: Numbers) -> dict[str, Any]:
    """Returns a position (2,) or (3,), or a frame (4, 4), in the form of an arm's file."""
    values = np.array(plain(given))
    if values.shape == (4, 4):
        return rigid_fields(values, planar=in_plane(values))
    return {"position": values.tolist()}


def rigid_fields(frame: frames.Frame, *, planar: bool) -> dict[str, Any]:
    """Returns a frame (4, 4) in the form of an arm's file.

    Raises:
        ArmError: the frame is not a rotation and a translation.
    """
    rotation = frame[:3, :3]
    rigid = np.abs(rotation.T @ rotation - np.eye(3)).max() <= RIGID and np.linalg.det(rotation) > 0
    if not rigid or not np.array_equal(frame[3], (0.0, 0.0, 0.0, 1.0)):
        raise ArmError(["a frame must be a rotation and a translation, with the last row 0, 0, 0, 1"], "frame")
    return frame_fields(frame, planar=planar)


def in_plane(frame: frames.Frame) -> bool:
    """Returns whether a frame (4, 4) stays in the plane z = 0."""
    return bool(np.allclose(frame[2], (0.0, 0.0, 1.0, 0.0), atol=1e-12))


def frame_settings(frame: Numbers, name: str) -> FrameSettings:
    """Returns a position (2,) or (3,), or a frame (4, 4), as the field `name` of an arm's file."""
    return checked(FrameSettings, placement(frame), name)


def build(settings: ArmSettings, path: Path) -> config.Arm:
    """Builds the arm of a file's fields.

    Raises:
        ArmError: the fields are wrong.
    """
    try:
        return config.build(settings, path, [])
    except InputFaults as error:
        raise ArmError(error.faults, str(path)) from None
