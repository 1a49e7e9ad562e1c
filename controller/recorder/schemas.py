"""JSON schemas of recorded messages: the arm's keys, and three message types of Foxglove.

Foxglove and Lichtblick identify a message type by the name of its schema. A schema allows further fields.
"""

from functools import cache
from typing import Any

import msgspec
from msgspec import UNSET, Struct, UnsetType

from hyperbit.controller.messages.reading import MESSAGES
from hyperbit.controller.motion.decoding.goal import GoalMessage
from hyperbit.controller.motion.decoding.requests import DegradeMessage, FaultMessage, JogMessage, ObstaclesMessage
from hyperbit.controller.motion.decoding.setpoint import SetpointMessage
from hyperbit.controller.motion.tracking.bias import MeasuredTipMessage

Schema = dict[str, Any]


class Alive(Struct):
    """Whether the daemon is there, at each change."""

    alive: bool


class Other(Struct):
    """A message that is no JSON object, or whose key has no topic."""

    key: str
    value: Any | UnsetType = UNSET
    text: str | UnsetType = UNSET  # of a message that is no JSON


TOPICS: dict[str, type[Struct]] = {
    **MESSAGES,
    **{"goal": GoalMessage, "setpoint": SetpointMessage, "measured_tip": MeasuredTipMessage, "jog": JogMessage},
    **{"degrade": DegradeMessage, "obstacles": ObstaclesMessage, "fault": FaultMessage},
    **{"alive": Alive, "other": Other},
}


NUMBER: Schema = {"type": "number"}
INTEGER: Schema = {"type": "integer"}
TEXT: Schema = {"type": "string"}
BOOLEAN: Schema = {"type": "boolean"}


def array(items: Schema) -> Schema:
    """Returns the schema of a list."""
    return {"type": "array", "items": items}


def fields(**properties: Schema) -> Schema:
    """Returns the schema of an object with these fields."""
    return {"type": "object", "properties": properties}


TIME = fields(sec=INTEGER, nsec=INTEGER)
VECTOR = fields(x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = fields(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
POSE = fields(position=VECTOR, orientation=QUATERNION)
COLOUR = fields(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
SOLID = fields(pose=POSE, size=VECTOR, color=COLOUR)
LINES = fields(
    type=INTEGER,
    pose=POSE,
    thickness=NUMBER,
    scale_invariant=BOOLEAN,
    points=array(VECTOR),
    color=COLOUR,
    colors=array(COLOUR),
    indices=array(INTEGER),
)
ENTITY = fields(
    timestamp=TIME,
    frame_id=TEXT,
    id=TEXT,
    lifetime=TIME,
    frame_locked=BOOLEAN,
    metadata=array(fields(key=TEXT, value=TEXT)),
    arrows=array(fields()),
    cubes=array(SOLID),
    spheres=array(SOLID),
    cylinders=array(fields(pose=POSE, size=VECTOR, bottom_scale=NUMBER, top_scale=NUMBER, color=COLOUR)),
    lines=array(LINES),
    triangles=array(fields()),
    texts=array(fields()),
    models=array(fields()),
)
TRANSFORM = fields(timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=VECTOR, rotation=QUATERNION)

SCENE, TRANSFORMS, LOG = "foxglove.SceneUpdate", "foxglove.FrameTransforms", "foxglove.Log"
FOXGLOVE: dict[str, Schema] = {
    SCENE: fields(deletions=array(fields(timestamp=TIME, type=INTEGER, id=TEXT)), entities=array(ENTITY)),
    TRANSFORMS: fields(transforms=array(TRANSFORM)),
    LOG: fields(timestamp=TIME, level=INTEGER, message=TEXT, name=TEXT, file=TEXT, line=INTEGER),
}


@cache
def schema_of(topic: str) -> tuple[str, bytes]:
    """Returns name and text of the schema of a topic: a Foxglove type, a key of the arm, or any object."""
    if topic in FOXGLOVE:
        return topic, msgspec.json.encode({"title": topic, **FOXGLOVE[topic]})
    name = f"hyperbit.{topic}" if topic in TOPICS else "hyperbit.any"
    return name, msgspec.json.encode({**schema_of_type(TOPICS.get(topic, dict)), "title": name})


def schema_of_type(kind: type) -> Schema:
    """Returns the JSON schema of messages of a type."""
    (schema,), parts = msgspec.json.schema_components([kind])
    found: Schema = inlined(schema, parts)
    return found


def inlined(schema: Any, parts: dict[str, Schema]) -> Any:
    """Returns a schema of msgspec without references, which Foxglove does not read, and open to further fields."""
    if isinstance(schema, list):
        return [inlined(it, parts) for it in schema]
    if not isinstance(schema, dict):
        return schema
    if (reference := schema.get("$ref")) is not None:
        schema = parts[reference.rpartition("/")[2]] | {key: it for key, it in schema.items() if key != "$ref"}
    closed = schema.get("additionalProperties") is False
    return {
        key: inlined(it, parts)
        for key, it in schema.items()
        if key != "$defs" and not (closed and key == "additionalProperties")
    }
