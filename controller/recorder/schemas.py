"""JSON schemas of recorded messages: the arm's keys, and three message types of Foxglove.

Foxglove and Lichtblick identify a message type by the name of its schema. The schemas contain only the fields that this
package writes.
"""

from functools import cache
from typing import Any

import msgspec

Schema = dict[str, Any]

NUMBER: Schema = {"type": "number"}
INTEGER: Schema = {"type": "integer"}
TEXT: Schema = {"type": "string"}
BOOLEAN: Schema = {"type": "boolean"}
ANYTHING: Schema = {}


def array(items: Schema) -> Schema:
    """Returns the schema of a list."""
    return {"type": "array", "items": items}


def optional(schema: Schema) -> Schema:
    """Returns the schema of a value that may be null."""
    return {"anyOf": [schema, {"type": "null"}]}


def fields(**properties: Schema) -> Schema:
    """Returns the schema of an object with these fields; further fields are allowed."""
    return {"type": "object", "properties": properties}


POSITION = optional(array(NUMBER))
ORIENTATION = optional({"anyOf": [NUMBER, array(NUMBER)]})
STATES = optional(array(optional(INTEGER)))  # of the actuators: 0 contracted, 1 extended, null unknown
FAULT = fields(code=TEXT, source=TEXT, message=TEXT)
TARGET = fields(position=POSITION, orientation=ORIENTATION)
REACHED = {
    "configuration": optional(TEXT),
    "position": POSITION,
    "orientation": ORIENTATION,
    "error": optional(NUMBER),
    "orientation_error": optional(NUMBER),
}
WAYPOINT = fields(t=NUMBER, position=POSITION, orientation=ORIENTATION, configuration=TEXT)
GOAL = fields(id=TEXT, stamp=NUMBER, waypoints=array(WAYPOINT), tolerance=fields(position=NUMBER, orientation=NUMBER))
ANSWER = fields(
    accepted=BOOLEAN, id=optional(TEXT), code=INTEGER, reason=TEXT, message=TEXT, waypoints=array(fields(**REACHED))
)

TOPICS: dict[str, Schema] = {
    "state": fields(
        stamp=NUMBER,
        mode=TEXT,
        reason=TEXT,
        simulated=BOOLEAN,
        configuration=optional(TEXT),
        commanded=STATES,
        measured=STATES,
        tip=optional(TARGET),
        goal=optional(TEXT),
        waypoint=optional(INTEGER),
        poses=INTEGER,
        faults=array(FAULT),
        degraded=array(fields(actuator=TEXT, state=INTEGER)),
    ),
    "feedback": fields(id=TEXT, waypoint=INTEGER, waypoints=INTEGER, switches=INTEGER, stages=INTEGER, **REACHED),
    "result": fields(
        id=optional(TEXT),
        status=TEXT,
        code=INTEGER,
        reason=TEXT,
        message=TEXT,
        switches=INTEGER,
        repeated=BOOLEAN,
        **REACHED,
    ),
    "diagnostics": fields(
        stamp=NUMBER,
        loop=fields(),
        buses=array(fields()),
        boards=array(fields()),
        queues=fields(),
        setpoint=fields(),
        switches=INTEGER,
        counts=array(INTEGER),
        waits=INTEGER,
        dropped=INTEGER,
        ledger=TEXT,
        real_time=TEXT,
        executor=TEXT,
    ),
    "goal": GOAL,
    "setpoint": fields(position=POSITION, stamp=NUMBER),
    "measured_tip": fields(position=POSITION, orientation=ORIENTATION, stamp=NUMBER),
    "jog": fields(actuators=fields()),
    "degrade": fields(actuator=TEXT, state=optional(INTEGER)),
    "obstacles": fields(regions=array(fields())),
    "fault": fields(fault=TEXT),
    "request": fields(stamp=NUMBER, key=TEXT, payload=optional(fields()), text=TEXT, answer=ANSWER),
    "alive": fields(alive=BOOLEAN),
    "arm": fields(name=TEXT, version=TEXT, dimension=INTEGER, length=NUMBER, actuators=array(TEXT), simulated=BOOLEAN),
    "other": fields(key=TEXT, value=ANYTHING, text=TEXT),
}

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
    return name, msgspec.json.encode({"title": name, **TOPICS.get(topic, fields())})
