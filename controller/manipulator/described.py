"""The chain of modules from a daemon's description of its arm, for programs that do not read the arm's file."""

from collections.abc import Mapping
from typing import Any

import numpy as np

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
