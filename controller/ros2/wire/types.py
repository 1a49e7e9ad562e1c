"""Types of messages, services and actions by distribution: their fields, Python classes and RIHS01 hashes.

The definitions of messages are those of rosbags. Services, actions and control_msgs are in `definitions`.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Fielddefs, Typesdict
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

DEFINITIONS = Path(__file__).with_name("definitions")
# Version of definitions by distribution. Only the feedback of FollowJointTrajectory differs.
VERSIONS = {"jazzy": "jazzy", "kilted": "kilted", "lyrical": "kilted"}
UUID = "unique_identifier_msgs/msg/UUID goal_id\n"
TIME = "builtin_interfaces/msg/Time stamp\n"


class UnknownType(ValueError):
    """A type or a distribution is not known."""


class Types:
    """The types of one distribution: jazzy, kilted or lyrical. Raises UnknownType for another."""

    def __init__(self, distribution: str) -> None:
        if distribution == "humble":
            raise UnknownType(
                "humble is not supported: its rmw_zenoh has no type hashes in keys, so that data never meet"
            )
        if distribution not in VERSIONS:
            raise UnknownType(f"{distribution!r} is no known distribution of ROS 2: {', '.join(VERSIONS)}")
        self._version = VERSIONS[distribution]
        self.store = get_typestore(Stores.ROS2_JAZZY)  # rosbags' store; a service or action is stored as its messages
        self.hashes: dict[str, str] = {}  # RIHS01 hash by name of a message, of a service, or of an action's part
        for path in sorted(DEFINITIONS.glob("*/*/*.*"), key=lambda it: it.suffix != ".msg"):  # others refer to it
            stem, _, version = path.stem.partition(".")
            if version in ("", self._version):
                name = "/".join((*path.parts[-3:-1], stem))
                self._define(name, path.read_text(encoding="utf-8"))
        hashes: dict[str, str] = json.loads((DEFINITIONS / "hashes.json").read_text(encoding="utf-8"))
        for key, value in hashes.items():
            name, _, version = key.partition(".")
            if version in ("", self._version):
                self.hashes[name] = value

    def register(self, name: str, text: str, hashes: Mapping[str, str]) -> None:
        """Adds a type that is not built in.

        Args:
            name: such as example_interfaces/action/Fibonacci.
            text: content of the .msg, .srv or .action file, with full names of types, such as std_msgs/msg/Header.
            hashes: RIHS01 hashes; an action has those of its _SendGoal, _GetResult and _FeedbackMessage.

        Raises:
            UnknownType: the text cannot be read, or refers to a type that is not known.
        """
        self._define(name, text)
        self.hashes.update(hashes)

    def hash(self, name: str) -> str:
        """Returns the RIHS01 hash of a message, a service or an action's part. Raises UnknownType."""
        if name not in self.hashes:
            raise UnknownType(f"the type {name!r} is not known: {len(self.hashes)} are; add it by Types.register")
        return self.hashes[name]

    def message_class(self, name: str) -> type[Any]:
        """Returns the dataclass of a message, or of a service's or action's part. Raises UnknownType."""
        if name not in self.store.types:
            raise UnknownType(f"the message {name!r} is not known")
        return self.store.types[name]

    def _define(self, name: str, text: str) -> None:
        kind = name.split("/")[1]
        parts = [part.strip() + "\n" for part in ("\n" + text).split("\n---")]
        expected = {"msg": 1, "srv": 2, "action": 3}[kind]
        if len(parts) != expected:
            raise UnknownType(f"the definition of {name} has {len(parts)} parts, expected {expected}")
        if kind == "msg":
            texts = {name: parts[0]}
        elif kind == "srv":
            texts = {f"{name}_Request": parts[0], f"{name}_Response": parts[1]}
        else:
            texts = {
                **dict(zip((f"{name}_Goal", f"{name}_Result", f"{name}_Feedback"), parts, strict=True)),
                f"{name}_SendGoal_Request": f"{UUID}{name}_Goal goal\n",
                f"{name}_SendGoal_Response": f"bool accepted\n{TIME}",
                f"{name}_GetResult_Request": UUID,
                f"{name}_GetResult_Response": f"int8 status\n{name}_Result result\n",
                f"{name}_FeedbackMessage": f"{UUID}{name}_Feedback feedback\n",
            }
        found: Typesdict = {}
        try:
            for part, lines in texts.items():
                # rosbags names a type in a folder `srv` as if it were in `msg`. So the name is set here.
                (found[part],) = get_types_from_msg(lines, part).values()
            known = self.store.fielddefs.keys() | found.keys()
            if unknown := {it for _, fields in found.values() for it in _references(fields)} - known:
                raise UnknownType(f"the definition of {name} refers to unknown types: {', '.join(sorted(unknown))}")
            self.store.register(found)
        except TypesysError as error:
            raise UnknownType(f"the definition of {name} cannot be read: {error}") from None


def _references(fields: Fielddefs) -> Iterator[str]:
    """Yields the messages that fields refer to."""
    for _, desc in fields:
        element = desc[1][0] if desc[0] == Nodetype.ARRAY or desc[0] == Nodetype.SEQUENCE else desc
        if element[0] == Nodetype.NAME:
            yield element[1]
