"""Pictures of the orientations of the tip at a point, and their histograms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.workspace.orientations import Orientations

Array = NDArray[np.float64]

ARCS = 36  # of a histogram of angles
LATITUDES, LONGITUDES = 24, 48  # cells of equal area of a histogram of directions
ORANGE = "#D55E00"


def draw_angles(axes: Any, found: Orientations) -> None:
    """Draws the density of a planar arm's orientations on polar axes, zero to the right, counter-clockwise."""
    shares = arcs(angles_of(found.rotations), found.counts)
    width = 2 * math.pi / ARCS
    axes.bar(-math.pi + width * (np.arange(ARCS) + 0.5), shares, width=width, color=ORANGE, edgecolor="white")
    axes.set_title("orientations at the point, share of configurations")
    axes.set_thetalim(-math.pi, math.pi)
    axes.set_rlabel_position(math.degrees(-math.pi + width * (int(shares.argmin()) + 0.5)))
    axes.set_yticks([tick for tick in axes.get_yticks() if tick > 0][::2])
    axes.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}" if share >= 0.01 else f"{share:.1%}")


def draw_rotations(figure: Any, found: Orientations) -> None:
    """Draws the density of a spatial arm's orientations: direction of the tip's z axis, and rotation about it.

    Directions are drawn in Lambert's azimuthal equal-area projection, centred at the z axis of the world.
    """
    figure.suptitle("orientations at the point")
    axes = figure.add_subplot(1, 3, 1, projection="polar")
    shares = directions(found)[::-1]  # first row: around the z axis
    polar = np.arccos(np.linspace(1, -1, LATITUDES + 1))
    longitudes = np.linspace(-math.pi, math.pi, LONGITUDES + 1)
    shown = np.where(shares > 0, shares, np.nan)
    radii = 2 * np.sin(polar / 2)
    mesh = axes.pcolormesh(longitudes, radii, shown, cmap="Oranges", vmin=0, edgecolors="none", rasterized=True)
    last = int(np.flatnonzero(shares.sum(axis=1) > 0).max()) + 1
    axes.set_rlim(0, radii[min(last + 2, LATITUDES)])
    degrees = [angle for angle in (15, 30, 45, 60, 90, 120, 180) if polar[last] * 1.2 >= math.radians(angle)]
    axes.set_yticks([2 * math.sin(math.radians(angle) / 2) for angle in degrees], [f"{angle}°" for angle in degrees])
    axes.grid(alpha=0.3)
    axes.set_title("tip's z axis: angle from the z axis, and longitude", fontsize="medium")
    figure.colorbar(mesh, ax=axes, shrink=0.7, pad=0.1, label="share of configurations", format="{x:.1%}")
    twist = figure.add_subplot(1, 3, (2, 3))
    turns = np.degrees(-math.pi + 2 * math.pi / ARCS * (np.arange(ARCS) + 0.5))
    twist.bar(turns, arcs(twists(found.rotations), found.counts), width=360 / ARCS, color=ORANGE, edgecolor="white")
    twist.set(xlabel="turn about the tip's z axis [°]", ylabel="share of configurations", xlim=(-180, 180))
    twist.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}" if share >= 0.01 else f"{share:.1%}")


def angles_of(rotations: Array) -> Array:
    """Returns the angles of rotations about z, shape (n,)."""
    return np.asarray(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))


def twists(rotations: Array) -> Array:
    """Returns the twist angles (n,) of rotations (n, 3, 3) about their own z axis."""
    qz, qw = rotations[:, 1, 0] - rotations[:, 0, 1], 1 + np.trace(rotations, axis1=1, axis2=2)
    return np.asarray(2 * np.arctan2(qz, qw) + math.pi) % (2 * math.pi) - math.pi


def arcs(angles: Array, counts: Array) -> Array:
    """Returns the share of the counts (n,) in each of ARCS equal arcs from -pi on."""
    found = np.histogram(angles, ARCS, (-math.pi, math.pi), weights=counts)[0]
    return np.asarray(found / max(float(found.sum()), 1e-300))


def directions(found: Orientations) -> Array:
    """Returns the share of configurations by direction of the tip's z axis, shape (latitudes, longitudes)."""
    axis = found.rotations[:, :, 2]
    longitude = np.arctan2(axis[:, 1], axis[:, 0])
    bounds = [(-1.0, 1.0), (-math.pi, math.pi)]
    counts = np.histogram2d(axis[:, 2], longitude, (LATITUDES, LONGITUDES), bounds, weights=found.counts)[0]
    return np.asarray(counts / max(float(counts.sum()), 1e-300))
