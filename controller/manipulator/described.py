"""The chain of modules from a daemon's description of its arm, for programs that do not read the arm's file.

The description has the unit of the arm's file. ROS 2 and Foxglove want metres.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hyperbit.controller.armfile.units import metres_of
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module


def described(answer: Mapping[str, Any]) -> Manipulator:
    """Returns the chain of an arm from the payload of the answer to `arm`, with its `drawing`.

    Raises LookupError, TypeError or ValueError if the answer has another form, as that of another version.
    """
    kinds, planar = answer["drawing"]["kinds"], answer["dimension"] == 2
    names: list[list[str]] = [[] for _ in answer["frames"]]
    for label in answer["actuators"]:
        module, _, name = label.partition(".")
        names[int(module) - 1].append(name)
    modules = [
        Module(
            np.array(frames, dtype=float),
            np.array(kinds[kind]["bits"], dtype=np.uint8),
            tuple(own),
            np.array(kinds[kind]["body"], dtype=float),
            planar,
        )
        for frames, kind, own in zip(answer["frames"], answer["drawing"]["modules"], names, strict=True)
    ]
    return Manipulator(modules, np.array(answer["base"], dtype=float))


def in_metres(answer: Mapping[str, Any]) -> Mapping[str, Any]:
    """Returns the payload of the answer to `arm` with chain, drawing and obstacles in metres.

    Raises LookupError, TypeError or ValueError if the answer has another form, or its unit is unknown.
    """
    metres = metres_of(answer.get("unit"))
    if metres == 1.0:
        return answer

    def placed(frames: Any) -> Any:
        array = np.array(frames, dtype=float)
        array[..., :3, 3] *= metres
        return array.tolist()

    drawing = answer["drawing"]
    kinds = [{**kind, "body": (np.array(kind["body"], dtype=float) * metres).tolist()} for kind in drawing["kinds"]]
    regions = {
        key: [scaled(it, metres) for it in answer[key]] for key in ("obstacles", "sent_obstacles") if key in answer
    }
    return {
        **answer,
        **regions,
        "unit": "m",
        "length": answer["length"] * metres,
        "base": placed(answer["base"]),
        "frames": [placed(frames) for frames in answer["frames"]],
        "drawing": {**drawing, "kinds": kinds},
    }


def scaled(region: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """Returns an obstacle with its lengths times a factor; directions, angles and names stay."""
    lengths = ("centre", "size", "point", "radius")
    return {
        shape: {key: (np.array(it) * factor).tolist() if key in lengths else it for key, it in body.items()}
        if isinstance(body, dict)
        else body
        for shape, body in region.items()
    }
