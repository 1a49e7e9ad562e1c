"""Line segments of an arm, and its density as a picture, computed for the page."""

import base64
import math
import struct
import zlib
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.described import described
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.manipulator.module import Module
from hyperbit.controller.manipulator.notation import parse_configuration
from hyperbit.controller.messages.arm import Density, Description

DIGITS = 5  # coordinates are rounded to this number of digits of the arm's length
MOST_PIXELS = 100_000_000  # a forged one would fill the memory
MOST_POINTS = 4000  # points of a spatial density


class Drawing:
    """Structure of an arm, built from its description with `drawing`."""

    def __init__(self, arm: Description) -> None:
        """Builds the chain. Raises LookupError, TypeError or ValueError if the parts are not of one arm."""
        self.manipulator = described(arm)
        modules = self.manipulator.modules
        self.lines = [module.body.shape[1] for module in modules]  # number of line segments of each module, shape (B,)
        self._starts = np.cumsum([0, *(len(module.actuators) for module in modules)])
        self._digits = DIGITS - int(np.floor(np.log10(max(self.manipulator.length, 1e-9))))

    def of_actuators(self, states: Sequence[int | None], guesses: Sequence[int | None] = ()) -> list[float] | None:
        """Returns the coordinates of all line segments for actuator states, flat; None if there are no states.

        A module is drawn in the state that agrees with most of its `states` (A,), then with most of its `guesses` (A,),
        such as the last known states. None: unknown.
        """
        if len(states) != self._starts[-1] or all(state is None for state in (*states, *guesses)):
            return None
        known, guessed = (
            np.array([-1 if x is None else x for x in it]) for it in (states, guesses or [None] * len(states))
        )
        configuration = np.empty(len(self.lines), dtype=np.int64)
        for k, (module, first, last) in enumerate(self._modules()):
            agreeing = (module.bits == known[first:last]).sum(axis=1) * (last - first + 1)
            configuration[k] = (agreeing + (module.bits == guessed[first:last]).sum(axis=1)).argmax()
        return self.of_configuration(configuration)

    def unknown_modules(self, states: Sequence[int | None]) -> list[int]:
        """Returns the indices of the modules that have an actuator of unknown state."""
        return [k for k, (_, first, last) in enumerate(self._modules()) if None in states[first:last]]

    def _modules(self) -> Iterator[tuple[Module, int, int]]:
        """Yields each module with the number of its first actuator, and of the next module's first."""
        return zip(self.manipulator.modules, self._starts.tolist(), self._starts[1:].tolist(), strict=False)

    def of_text(self, text: str) -> list[float] | None:
        """Returns the coordinates of a configuration's text; None if the arm has no such configuration."""
        try:
            return self.of_configuration(parse_configuration(self.manipulator, text))
        except ValueError:
            return None

    def of_configuration(self, configuration: Configuration) -> list[float]:
        body = self.manipulator.body(configuration)[:, :, : self.manipulator.dimension]
        return self.rounded(body)

    def rounded(self, coordinates: NDArray[np.float64]) -> list[float]:
        return [float(x) for x in np.round(coordinates.ravel(), self._digits)]


def shades_of(density: Density) -> NDArray[np.uint8]:
    """Decodes the `density` of `arm`: pixels (z, y, x), 0 outside the workspace, else 1 to 255.

    Raises ValueError if it has another form.
    """
    size = math.prod(density.shape)
    if size > MOST_PIXELS:
        raise ValueError(f"a density of {size} pixels, at most {MOST_PIXELS} are drawn")
    try:
        data = zlib.decompressobj().decompress(base64.b64decode(density.values), size + 1)
    except zlib.error as error:
        raise ValueError(f"a density that is not compressed: {error}") from None
    return np.frombuffer(data, dtype=np.uint8).reshape(density.shape)


def picture(density: Density) -> bytes:
    """Returns a planar density as a gray PNG with opacity; the first row has the greatest y."""
    shades = shades_of(density)[0][::-1].astype(float)
    most = max(density.greatest, 1.0)
    depth = np.clip(
        (shades / 255.0 - 1.0) * most / np.log(1000.0) + 1.0, 0.0, 1.0
    )  # lightest at 1/1000 of the greatest density
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


def cloud(density: Density) -> list[list[float]]:
    """Returns points (n, 4) of a spatial density: x, y, z in the base's frame, and density from 0 to 1."""
    shades = shades_of(density)
    z, y, x = np.nonzero(shades)
    if len(x) > MOST_POINTS:
        chosen = np.random.default_rng(0).choice(len(x), MOST_POINTS, replace=False)
        z, y, x = z[chosen], y[chosen], x[chosen]
    points = np.array(density.first) + density.pixel * np.column_stack([x, y, z])
    result: list[list[float]] = np.round(np.column_stack([points, shades[z, y, x] / 255.0]), 4).tolist()
    return result
