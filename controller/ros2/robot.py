"""The arm as a URDF: a link for each module frame, and a joint for each actuator.

URDF knows rigid links only. Frames of modules are fixed in the contracted configuration; /tf has the measured frames. A
joint of an actuator moves a link without geometry from 0 (contracted) to 1 (extended), as in joint_states. Lengths are
metres.
"""

from xml.etree import ElementTree

import numpy as np

from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.manipulator import Manipulator


def urdf(arm: str, world: str, manipulator: Manipulator) -> str:
    """Returns the URDF of an arm [m]. Links of module frames are "<arm>/0" to "<arm>/B", as in /tf, and "<arm>/tip"."""
    robot = ElementTree.Element("robot", name=arm)
    ElementTree.SubElement(robot, "link", name=world)
    frames = [manipulator.base, *(module.frames[0] for module in manipulator.modules), np.eye(4)]
    names = [world, *(f"{arm}/{k}" for k in range(len(manipulator.modules) + 1)), f"{arm}/tip"]
    for parent, child, frame in zip(names, names[1:], frames, strict=False):
        _add(robot, f"{parent} to {child}", "fixed", (parent, child), frame)
    for label in manipulator.actuators:
        module = int(label.partition(".")[0])
        joint = _add(robot, label, "prismatic", (f"{arm}/{module - 1}", f"{arm}/actuator {label}"), np.eye(4))
        ElementTree.SubElement(joint, "axis", xyz="1 0 0")
        ElementTree.SubElement(joint, "limit", lower="0", upper="1", effort="0", velocity="0")
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True)


def _add(robot: ElementTree.Element, name: str, kind: str, ends: tuple[str, str], frame: Frame) -> ElementTree.Element:
    parent, child = ends
    ElementTree.SubElement(robot, "link", name=child)
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    position = " ".join(f"{x:.9g}" for x in frame[:3, 3])
    ElementTree.SubElement(joint, "origin", xyz=position, rpy=" ".join(f"{x:.9g}" for x in angles(frame)))
    return joint


def angles(frame: Frame) -> tuple[float, float, float]:
    """Returns roll, pitch and yaw [rad] of a frame (4, 4), about fixed axes x, y, z in turn."""
    turned = frame[:3, :3]
    pitch = float(np.arctan2(0.0 - turned[2, 0], np.hypot(turned[0, 0], turned[1, 0])))
    if abs(abs(pitch) - np.pi / 2) < 1e-9:  # gimbal lock: all of the turn is roll
        return float(np.arctan2(-turned[1, 2], turned[1, 1])), pitch, 0.0
    return float(np.arctan2(turned[2, 1], turned[2, 2])), pitch, float(np.arctan2(turned[1, 0], turned[0, 0]))
