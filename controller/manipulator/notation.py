"""Text forms of configurations and poses.

A configuration is a row of digits, base first. Numbers with commas are used if a module has more than ten states.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator


def parse_configuration(manipulator: Manipulator, text: str) -> Configuration:
    """Returns the configuration (B,) of a text. Raises ValueError if the text does not match the arm."""
    digits = "," not in text and manipulator.states.max() <= 10
    parts = list(text.strip()) if digits else text.strip().split(",")
    try:
        states = [int(part) for part in parts]
    except ValueError:
        raise ValueError(f"configuration {text!r}: every module state must be a whole number") from None
    if len(states) != len(manipulator.modules):
        raise ValueError(f"configuration {text!r} has {len(states)} modules, the arm has {len(manipulator.modules)}")
    for i, (state, count) in enumerate(zip(states, manipulator.states, strict=True)):
        if not 0 <= state < count:
            raise ValueError(f"configuration {text!r}: module {i + 1} has states 0 to {count - 1}, not {state}")
    return np.array(states, dtype=np.int64)


def format_configuration(manipulator: Manipulator, configuration: ArrayLike) -> str:
    """Returns the text of a configuration (B,); parse_configuration reads it."""
    separator = "" if manipulator.states.max() <= 10 else ","
    return separator.join(str(state) for state in np.asarray(configuration).tolist())


def pose(manipulator: Manipulator, tip: Frame) -> dict[str, Any]:
    """Returns the position and the orientation (an angle or a quaternion) of a frame (4, 4) for JSON."""
    orientation = frames.angle(tip) if manipulator.planar else frames.quaternion(tip).tolist()
    return {"position": tip[: manipulator.dimension, 3].tolist(), "orientation": orientation}
