"""Messages for Foxglove and their schemas agree with Foxglove's own definitions, published as Protocol Buffers."""

from typing import Any

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.json_format import ParseDict

from hyperbit.controller.arm.arm import load
from hyperbit.controller.pictures.scene import FoxgloveScene, shown_of
from hyperbit.controller.recorder.schemas import FOXGLOVE, LOG, SCENE, TIME, TRANSFORMS, Schema
from tests.keys import DEPLOY
from tests.told import read_arm, read_state

OFFICIAL: dict[str, Any] = {SCENE: SceneUpdate, TRANSFORMS: FrameTransforms, LOG: Log}
TIMES = ("google.protobuf.Timestamp", "google.protobuf.Duration")  # in JSON Foxglove writes {sec, nsec}
KINDS = {
    "number": {FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT},
    "integer": {
        FieldDescriptor.CPPTYPE_ENUM,
        FieldDescriptor.CPPTYPE_INT32,
        FieldDescriptor.CPPTYPE_INT64,
        FieldDescriptor.CPPTYPE_UINT32,
        FieldDescriptor.CPPTYPE_UINT64,
    },
    "string": {FieldDescriptor.CPPTYPE_STRING},
    "boolean": {FieldDescriptor.CPPTYPE_BOOL},
}


def unlike(schema: Schema, official: Descriptor) -> list[str]:
    """The fields of a schema that Foxglove's type does not have, or has with another type."""
    wrong: list[str] = []
    for name, part in schema["properties"].items():
        field, path = official.fields_by_name.get(name), f"{official.full_name}.{name}"
        if field is None or field.is_repeated != (part["type"] == "array"):
            wrong.append(path)
            continue
        part = part["items"] if field.is_repeated else part
        if part["type"] in KINDS:
            wrong += [] if field.cpp_type in KINDS[part["type"]] else [path]
        elif field.message_type is None:
            wrong.append(path)
        elif field.message_type.full_name in TIMES:
            wrong += [] if part == TIME else [path]
        else:
            wrong += unlike(part, field.message_type)
    return wrong


def as_protobuf(value: Any) -> Any:
    """A message with its times as Protocol Buffers write them in JSON."""
    if isinstance(value, dict):
        return None if value.keys() == {"sec", "nsec"} else {key: as_protobuf(part) for key, part in value.items()}
    return [as_protobuf(part) for part in value] if isinstance(value, list) else value


@pytest.mark.parametrize("name", [SCENE, TRANSFORMS, LOG])
def test_schemas_have_the_fields_of_foxgloves_types(name: str) -> None:
    assert OFFICIAL[name].DESCRIPTOR.full_name == name
    assert unlike(FOXGLOVE[name], OFFICIAL[name].DESCRIPTOR) == []


@pytest.mark.parametrize("name", ["planar16", "platform8", "motor12"])
def test_messages_are_foxgloves(name: str) -> None:
    arm = load(DEPLOY / f"{name}.yaml")
    sphere = {"centre": [0.5] * arm.manipulator.dimension, "radius": 0.3}
    known = read_arm(arm, obstacles=[{"disc" if arm.manipulator.dimension == 2 else "sphere": sphere}])
    scene, home = FoxgloveScene(known), [0] * len(arm.manipulator.modules)
    target = {"position": [0.5] * arm.manipulator.dimension, "orientation": None}
    now = shown_of(read_state(arm, home, stamp=5.25, target=target))
    update, transforms = scene.update(now, 5.25), scene.transforms(now, 5.25)
    assert len(ParseDict(as_protobuf(update), SceneUpdate()).entities) == len(update["entities"]) > len(home)
    assert len(ParseDict(as_protobuf(transforms), FrameTransforms()).transforms) == len(transforms["transforms"])
