"""Line segments of an arm for a page, and its density as a picture: a page only draws."""

import base64
import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.manipulator.module import Module
from controller.manipulator.notation import parse_configuration

Message = dict[str, Any]

DIGITS = 5  # of the arm's length, to which coordinates are rounded
MOST_POINTS = 4000  # of a spatial density


class Drawing:
    """The arm's structure, built from what the daemon tells with `arm`.

    Attributes:
        manipulator: the chain.
        lines: number of line segments of each module, (B,).

    Args:
        told: payload of `arm`, with its `drawing`.
    """

    def __init__(self, told: Message) -> None:
        """Builds the chain.

        Raises:
            KeyError, TypeError, ValueError: it is told otherwise.
        """
        kinds, planar = told["drawing"]["kinds"], told["dimension"] == 2
        names: list[list[str]] = [[] for _ in told["frames"]]
        for label in told["actuators"]:
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
            for frames, kind, own in zip(told["frames"], told["drawing"]["modules"], names, strict=True)
        ]
        self.manipulator = Manipulator(modules, np.array(told["base"], dtype=float))
        self.lines = [module.body.shape[1] for module in modules]
        self._starts = np.cumsum([0, *(len(own) for own in names)])
        self._digits = DIGITS - int(np.floor(np.log10(max(self.manipulator.length, 1e-9))))

    def of_actuators(self, states: Sequence[int | None], fallback: Sequence[int | None] = ()) -> list[float] | None:
        """Returns the coordinates of all segments, one after the other, where actuators are in states (A,).

        A module that these states spell no configuration of is drawn as `fallback` (A,) spells it. Returns None if that
        is none, either.
        """
        configuration = self._configuration(states, fallback)
        return None if configuration is None else self.of_configuration(configuration)

    def of_text(self, text: str) -> list[float] | None:
        """Returns the coordinates of a configuration as messages write it; None if it is none of the arm's."""
        try:
            return self.of_configuration(parse_configuration(self.manipulator, text))
        except ValueError:
            return None

    def of_configuration(self, configuration: Configuration) -> list[float]:
        """Returns the coordinates of a configuration (B,)."""
        body = self.manipulator.body(configuration)[:, :, : self.manipulator.dimension]
        return self.rounded(body)

    def rounded(self, coordinates: NDArray[np.float64]) -> list[float]:
        """Returns coordinates as few digits say them."""
        return [float(x) for x in np.round(coordinates.ravel(), self._digits)]

    def _configuration(self, states: Sequence[int | None], fallback: Sequence[int | None]) -> NDArray[np.int64] | None:
        """Returns the configuration (B,) that states (A,) spell, module by module; None if a module has none."""
        result = list[int]()
        for module, first, last in zip(self.manipulator.modules, self._starts, self._starts[1:], strict=False):
            for spelled in (states[first:last], fallback[first:last]):
                found = None
                if len(spelled) == last - first and None not in spelled:
                    found = np.flatnonzero((module.bits == np.array(spelled)).all(axis=1))
                if found is not None and len(found):
                    result.append(int(found[0]))
                    break
            else:
                return None
        return np.array(result, dtype=np.int64)


def shades_of(density: Message) -> NDArray[np.uint8]:
    """Returns the pixels (z, y, x) of the `density` that `arm` tells: 0 where no configuration ends, else 1 to 255."""
    data = zlib.decompress(base64.b64decode(density["values"]))
    return np.frombuffer(data, dtype=np.uint8).reshape(density["shape"])


def picture(density: Message) -> bytes:
    """Returns a planar density as a PNG of gray with opacity; the first row is the greatest y."""
    shades = shades_of(density)[0][::-1].astype(float)
    most = max(float(density["greatest"]), 1.0)
    depth = np.clip((shades / 255.0 - 1.0) * most / np.log(1000.0) + 1.0, 0.0, 1.0)  # a factor of 1000 below: lightest
    opacity = np.where(shades > 0, 40 + 120 * depth, 0).astype(np.uint8)
    return png(np.stack([np.full_like(opacity, 128), opacity], axis=-1))


def png(pixels: NDArray[np.uint8]) -> bytes:
    """Returns a PNG file of gray and opacity (height, width, 2)."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, _ = pixels.shape
    header = struct.pack(">IIBBBBB", width, height, 8, 4, 0, 0, 0)
    rows = np.concatenate([np.zeros((height, 1), np.uint8), pixels.reshape(height, -1)], axis=1)
    data = zlib.compress(rows.tobytes(), 6)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def cloud(density: Message) -> list[list[float]]:
    """Returns points (n, 4) of a spatial density: x, y, z in the base's frame, and how dense, 0 to 1."""
    shades = shades_of(density)
    z, y, x = np.nonzero(shades)
    if len(x) > MOST_POINTS:
        chosen = np.random.default_rng(0).choice(len(x), MOST_POINTS, replace=False)
        z, y, x = z[chosen], y[chosen], x[chosen]
    points = np.array(density["first"]) + density["pixel"] * np.column_stack([x, y, z])
    result: list[list[float]] = np.round(np.column_stack([points, shades[z, y, x] / 255.0]), 4).tolist()
    return result
