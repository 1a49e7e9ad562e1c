"""ROS 2's own messages, hashes and action server beside those of the wire: make ros2-test."""

import json
import os
import random
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from scipy.spatial.transform import Rotation

from hyperbit.controller.arm.arm import load
from hyperbit.controller.ros2.robot import urdf
from hyperbit.controller.ros2.wire.cdr import deserialize, message, serialize
from hyperbit.controller.ros2.wire.types import Types

ENVIRONMENTS = Path(__file__).parents[3] / ".venv"
ARMS = Path(__file__).parents[3] / "deploy"
CHECK_URDF = shutil.which("check_urdf")
ORACLE = Path(__file__).with_name("with_rclpy.py")
ABSENT = ("tf2_msgs", "control_msgs")  # packages without wheels
PLACEHOLDER, EMPTY = "structure_needs_at_least_one_member", b"\0\1\0\0\0"  # of a message without fields
# If the program lets none of the chosen goals be canceled, the wire answers 1, as CancelGoal.srv says, and rclpy 0.
DIFFERENT = {"rejected cancel": [0, []]}
LARGEST = {"int8": 7, "int16": 15, "int32": 31, "int64": 63, "uint8": 8, "uint16": 16, "uint32": 32, "uint64": 64}


@pytest.fixture(params=["jazzy", "kilted"])
def distribution(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    if not (ENVIRONMENTS / f"ros2-{name}").exists():
        pytest.skip("ROS 2's wheels are not installed: make ros2-test")
    return name


def asked(distribution: str, job: str, text: str = "") -> Any:
    python = ENVIRONMENTS / f"ros2-{distribution}" / "bin" / "python"
    settings = {**os.environ, "ROS_DOMAIN_ID": str(os.getpid() % 90 + 10), "ROS_LOCALHOST_ONLY": "1"}
    for name in ("PYTHONPATH", "ZENOH_CONFIG_OVERRIDE"):
        settings.pop(name, None)
    done = subprocess.run([python, ORACLE, job], input=text, capture_output=True, text=True, env=settings, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)


def filled(desc: FieldDesc, types: Types, draw: random.Random) -> Any:
    if desc[0] == Nodetype.NAME:
        entries = types.store.get_msgdef(desc[1]).fields
        return {name: filled(entry, types, draw) for name, entry in entries if name != PLACEHOLDER}
    if desc[0] == Nodetype.BASE:
        kind = desc[1][0]
        if kind == "string":
            return "".join(draw.choices("aé/ ", k=draw.randrange(4)))
        if kind == "bool":
            return draw.random() < 0.5
        if kind.startswith("float"):
            return float(draw.randrange(-(2**20), 2**20)) / 8
        return draw.randrange(2 ** LARGEST.get(kind, 7))
    element, length = desc[1]
    count = length if desc[0] == Nodetype.ARRAY else draw.randrange(4)
    return [filled(element, types, draw) for _ in range(count)]


def test_ros_2_reads_all_messages_and_has_the_same_hashes(distribution: str) -> None:
    types, draw = Types(distribution), random.Random(1)
    names = [name for name in types.hashes if name.split("/")[0] not in ABSENT]
    parts = [it for name in names for it in ((name,) if "/msg/" in name else (f"{name}_Request", f"{name}_Response"))]
    sent = []
    for name in parts:
        for _ in range(10):
            value = message(filled((Nodetype.NAME, name), types, draw), name, types)
            sent.append((name, serialize(value, name, types)))
    told = asked(distribution, "messages", json.dumps([[name, data.hex()] for name, data in sent]))
    assert len(told) == len(sent) > 800
    for (name, data), (type_hash, answer) in zip(sent, told, strict=True):
        if name in types.hashes:
            assert type_hash == types.hash(name), name
        # rclpy's buffers may have further bytes, and bytes of any value between the fields.
        back = deserialize(bytes.fromhex(answer)[: len(data)], name, types)
        if data != EMPTY:  # its one byte may have any value, too
            assert serialize(back, name, types) == data, name


@pytest.mark.parametrize("arm", sorted(ARMS.glob("*.yaml")), ids=lambda it: it.stem)
def test_ros_2_reads_the_description_of_the_robot(distribution: str, arm: Path) -> None:
    manipulator = load(arm).manipulator
    types, text = Types(distribution), urdf("arm", "world", manipulator)
    data = serialize(message({"data": text}, "std_msgs/msg/String", types), "std_msgs/msg/String", types)
    name, root, joints = asked(distribution, "robot", data.hex())
    assert (name, root) == ("arm", "world")
    assert [it[0] for it in joints if it[1] == "prismatic"] == list(manipulator.actuators)
    frame, at = np.eye(4), "world"
    fixed = {parent: (child, xyz, rpy) for _, kind, parent, child, xyz, rpy in joints if kind == "fixed"}
    while at in fixed:
        at, xyz, rpy = fixed[at]
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = Rotation.from_euler("xyz", rpy).as_matrix(), xyz
        frame = frame @ step
    assert at == "arm/tip"
    contracted = manipulator.tip(np.zeros(len(manipulator.modules), dtype=np.int64))
    np.testing.assert_allclose(frame, contracted, atol=1e-6 * manipulator.length)


@pytest.mark.skipif(CHECK_URDF is None, reason="RViz's own parser is not installed: apt-get install liburdfdom-tools")
@pytest.mark.parametrize("arm", sorted(ARMS.glob("*.yaml")), ids=lambda it: it.stem)
def test_rvizs_parser_reads_the_description_of_the_robot(arm: Path, tmp_path: Path) -> None:
    manipulator, file = load(arm).manipulator, tmp_path / "arm.urdf"
    file.write_text(urdf("arm", "world", manipulator))
    done = subprocess.run([str(CHECK_URDF), file], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "root Link: world" in done.stdout
    assert len(re.findall(r"child\(\d", done.stdout)) == 2 + len(manipulator.modules) + len(manipulator.actuators)


def test_rclpy_behaves_as_the_script_expects(distribution: str) -> None:
    """tests/ros2/wire has the wire's side."""
    different = {what: seen for what, seen, expected in asked(distribution, "action") if seen != expected}
    assert different == DIFFERENT
