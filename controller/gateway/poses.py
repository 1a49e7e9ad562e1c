"""Named poses of an arm: goals that operators saved, kept in a file beside the ledger. "home" is always among them."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from hyperbit.controller.host.files import read_kept
from hyperbit.controller.host.keeper import write_whole
from hyperbit.controller.messages.arm import NamedPose
from hyperbit.controller.messages.goals import Answer, done
from hyperbit.controller.motion.decoding.payloads import parse
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

MOST_POSES = 200  # of an arm
MOST_BYTES, MOST_STORED = 100_000, 500_000  # of a payload, and of all poses: each answer to `arm` has them
HOME = "home"

Name = Annotated[str, Meta(pattern=r"^[\w.-]([\w .-]{0,38}[\w.-])?\Z")]
SavedGoal = dict[str, Any]  # the payload of a goal without id and stamp


class PosesMessage(Struct, forbid_unknown_fields=True, frozen=True):
    save: Name | None = None  # a pose of this name is replaced
    goal: SavedGoal | None = None  # needed with `save`
    remove: Name | None = None


class Poses:
    """The named poses of one arm. For any thread.

    A change is written to the file before it is answered. A damaged file is set aside, and a new one begun.
    `home` is the configuration of "home", unless an operator saves another one.
    """

    def __init__(self, path: Path, home: str) -> None:
        self._path, self._lock = path, threading.Lock()
        self._home: SavedGoal = {"waypoints": [{"configuration": home}]}
        self._saved = read_kept(path, dict[Name, SavedGoal], "its poses are not known") or {}

    def listed(self) -> list[NamedPose]:
        """Returns all poses, home first, the others by name, each with its goal."""
        with self._lock:
            every = {HOME: self._home, **dict(sorted(self._saved.items()))}
        return [NamedPose(name, goal) for name, goal in every.items()]

    def change(self, message: PosesMessage) -> Answer:
        with self._lock:
            saved = dict(self._saved)
            if message.save is not None and message.goal is not None:
                saved[message.save], words = message.goal, f"saved pose {message.save!r}"
            elif saved.pop(message.remove or "", None) is None:
                known = ", ".join(sorted(saved)) or "none"
                raise Refusal(Reason.UNKNOWN_POSE, name=repr(message.remove), known=known)
            else:
                words = f"removed pose {message.remove!r}"
            if len(saved) > MOST_POSES:
                raise Refusal(Reason.TOO_MANY_POSES, most=MOST_POSES)
            self._write(saved)
            self._saved = saved
        return done(words)

    def _write(self, saved: dict[str, SavedGoal]) -> None:
        """Replaces the file, or raises Refusal; a crash leaves the old file or the new one."""
        content = msgspec.json.format(msgspec.json.encode(saved), indent=1)
        if len(content) > MOST_STORED:
            raise Refusal(Reason.TOO_LARGE, what="the saved poses", size=len(content), most=MOST_STORED)
        try:
            write_whole(self._path, content)
        except OSError as error:
            raise Refusal(Reason.POSES_UNWRITTEN, why=f"{self._path}: {error.strerror}") from None


def decode_poses(payload: bytes) -> PosesMessage:
    """Parses a `poses` payload, but not the goal's own fields. Raises only Refusal, which names the field."""
    message = parse(payload, PosesMessage, "poses", MOST_BYTES)
    saves, removes = message.save is not None and message.goal is not None, message.remove is not None
    if saves == removes or (message.save is None) != (message.goal is None):
        raise Refusal(Reason.INVALID_FIELDS, faults="either save and goal, or remove, are needed")
    if message.goal is not None and (extra := {"id", "stamp"} & message.goal.keys()):
        raise Refusal(Reason.INVALID_FIELDS, faults=f"goal.{min(extra)}: a saved goal has none")
    return message
