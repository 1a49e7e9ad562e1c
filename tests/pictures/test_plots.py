"""Pictures: what is drawn, and that all of it is inside."""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.testing import assert_allclose

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.manipulator.notation import parse_configuration
from hyperbit.controller.obstacles.obstacles import box, half_space, sphere, together
from hyperbit.controller.pictures import figure5
from hyperbit.controller.pictures.plots import COLOURS, Subplot, figure, save
from hyperbit.controller.search.method import PAPER_METHODS
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import spatial_arm

STRAIGHT, BENT = np.full(16, 7), np.full(16, 4)
FAR = [(6.0, -5.0)]
CURVE = [(-7.0, 0.0), (-7.5, 1.0)]
TURNED = frames.planar(0, 0, np.pi / 2)[:3, :3]


@pytest.fixture(scope="module")
def rows(arm, densities):
    return figure5.experiment(arm, densities)


@pytest.mark.parametrize("base", [np.eye(4), frames.planar(5, -2, 1)], ids=["origin", "moved"])
def test_everything_is_inside_the_axes(manipulator, densities, base):
    moved = Manipulator(manipulator.modules, base)
    subplot = Subplot("both", {"straight": STRAIGHT, "bent": BENT}, FAR, CURVE)
    (axes,) = [a for a in figure(moved, densities, [subplot], "mm").axes if a.get_title() == "both"]
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    bodies = [moved.body(c)[:, :, :2].reshape(-1, 2) for c in (STRAIGHT, BENT)]
    for points in (*bodies, FAR, CURVE):
        assert ((left, bottom) < np.array(points)).all()
        assert (np.array(points) < (right, top)).all()
    assert axes.get_aspect() == 1
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [mm]", "y [mm]")
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["straight", "bent", "waypoints", "targets"]


@pytest.mark.parametrize("configurations", [{"flat": [0, 0]}, {"flat": [0, 0], "high": [1, 1]}], ids=["flat", "high"])
def test_the_legend_is_below_the_name_of_the_axis(configurations):
    states = [frames.planar(3.0, 0.0, 0.0), frames.planar(0.0, 3.0, 0.0)]
    arm = Manipulator([transforms(states, planar=True)] * 2)
    drawn = {name: np.array(states) for name, states in configurations.items()}
    picture = figure(arm, None, [Subplot("arm", drawn)])
    FigureCanvasAgg(picture).draw()
    (axes,) = picture.axes
    name, legend = axes.xaxis.label.get_window_extent(), axes.get_legend().get_window_extent()
    assert legend.y1 <= name.y0
    assert legend.y0 >= 0


def test_the_density_lies_where_the_base_puts_it(manipulator, densities):
    moved = Manipulator(manipulator.modules, frames.planar(5, -2, 1))
    axes = figure(moved, densities, [Subplot()]).axes[0]
    (image,) = axes.images
    # From the image's own coordinates, those of F_0, to the world.
    to_world = (image.get_transform() - axes.transData).transform
    assert_allclose(to_world((0.3, 0.4)), (moved.base @ [0.3, 0.4, 0, 1])[:2], atol=1e-9)
    low, high = densities.box(0)
    assert_allclose(image.get_extent(), (low[0], high[0], low[1], high[1]))


def test_high_densities_share_the_darkest_gray(manipulator, densities):
    (image,) = figure(manipulator, densities, [Subplot()]).axes[0].images
    values = densities.level(0)[0]
    gray = image.to_rgba(image.get_array())
    assert len(np.unique(gray[values > values.max() - np.log(100)], axis=0)) == 1
    assert (gray[values < 0][:, 3] == 0).all()  # nothing is drawn where nothing reaches


def test_panels_and_colours_stand_side_by_side(manipulator, densities):
    names = [str(k) for k in range(len(COLOURS))]
    subplots = [Subplot(str(k), dict.fromkeys(names, BENT)) for k in range(3)]
    axes = figure(manipulator, densities, subplots).axes
    assert [a.get_title() for a in axes] == ["0", "1", "2", ""]  # the last is the colour bar
    assert [line.get_color() for line in axes[0].get_legend().get_lines()] == list(COLOURS)


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_pictures_are_written_by_their_suffix(tmp_path, manipulator, densities, suffix):
    path = tmp_path / f"arm.{suffix}"
    save(path, manipulator, densities, [Subplot("", {"bent": BENT})])
    beginnings = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    assert path.read_bytes().startswith(beginnings[suffix])


def test_a_spatial_arm_is_drawn_in_space(tmp_path):
    manipulator = spatial_arm(4)
    densities = map_densities(manipulator, 0.1, 10_000)
    subplot = Subplot("space", {"up": [4] * 4, "bent": [0] * 4}, [(0.3, 0.2, 0.9)], [(0, 0, 1.2), (0.1, 0, 1.2)])
    axes = figure(manipulator, densities, [subplot]).axes[0]
    limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
    points = np.concatenate([manipulator.body(c).reshape(-1, 3) for c in subplot.configurations.values()])
    assert (limits[:, 0] < points).all()
    assert (points < limits[:, 1]).all()
    assert axes.get_zlabel() == "z [unit of the arm's file]"
    save(tmp_path / "arm.png", manipulator, densities, [subplot, subplot])
    assert (tmp_path / "arm.png").stat().st_size > 10_000


def test_importing_plots_does_not_import_matplotlib():
    check = "import sys, hyperbit.controller.pictures.plots"
    check += ", hyperbit.controller.pictures.figure5; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


def test_figure_5_has_three_methods_times_three_targets_in_order(manipulator, rows):
    assert [(row.method, row.target) for row in rows] == [(m, t) for m in PAPER_METHODS for t in figure5.TARGETS]
    for row in rows:
        tip = manipulator.tip(parse_configuration(manipulator, row.configuration))
        assert (row.x, row.y, row.theta) == pytest.approx((tip[0, 3], tip[1, 3], frames.angle(tip)))
        assert row.error == pytest.approx(np.hypot(row.x - row.target[0], row.y - row.target[1]))
        assert row.error <= 0.003


def test_figure_5_starts_contracted_and_goes_on_from_what_it_reached(manipulator, rows):
    for method in PAPER_METHODS:
        previous = np.zeros(16, dtype=int)
        for row in (row for row in rows if row.method == method):
            configuration = parse_configuration(manipulator, row.configuration)
            assert row.switches == manipulator.switches(previous, configuration)
            previous = configuration


def test_figure_5_is_one_picture(tmp_path, arm, densities, rows):
    figure5.save(tmp_path / "figure5.png", arm, densities, rows)
    assert (tmp_path / "figure5.png").read_bytes().startswith(b"\x89PNG")


def test_regions_are_drawn_where_they_are(manipulator, densities):
    floor = half_space("floor", [0, -0.5], [0, 1])
    obstacles = together([sphere("disc", [1, 2], 0.3), box("box", [-1, 1], [0.8, 0.2], TURNED), floor])
    axes = figure(manipulator, densities, [Subplot("", {"bent": BENT})], obstacles=obstacles).axes[0]
    drawn = [patch.get_transform().transform_path(patch.get_path()).vertices for patch in axes.patches]
    disc, turned, below = ((axes.transData.inverted().transform(path)) for path in drawn)
    assert_allclose(np.linalg.norm(disc - [1, 2], axis=1).min(), 0.3, atol=0.01)
    assert_allclose([turned.min(axis=0), turned.max(axis=0)], [[-1.1, 0.6], [-0.9, 1.4]], atol=1e-9)
    assert_allclose(below[:, 1].max(), -0.5)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["bent", "keep out"]


def test_a_half_plane_beyond_the_picture_is_not_drawn(manipulator, densities):
    far = half_space("floor", [0, -50], [0, 1])
    assert len(figure(manipulator, densities, [Subplot()], obstacles=far).axes[0].patches) == 0


def test_regions_in_space_are_drawn_translucent(tmp_path):
    arm = spatial_arm(4)
    shapes = [sphere("s", [0, 0.3, 0.5], 0.1), box("b", [0.3, 0, 0.5], [0.1, 0.2, 0.3])]
    obstacles = together([*shapes, half_space("h", [0, 0, 0.1], [0, 0.1, 1]), half_space("far", [0, 0, -9], [0, 0, 1])])
    densities = map_densities(arm, 0.1, 4000)
    (axes,) = figure(arm, densities, [Subplot("", {"bent": np.zeros(4, int)})], obstacles=obstacles).axes
    balls, boxes, plane = axes.collections[1:]
    assert all(shape.get_alpha() is None and shape.get_facecolor()[0][3] < 0.3 for shape in (balls, boxes, plane))
    assert_allclose(np.unique(abs(np.concatenate(boxes._faces) - [0.3, 0, 0.5]).round(9), axis=0), [[0.05, 0.1, 0.15]])
    assert_allclose(obstacles.depths(plane._faces[0])[:, 2], 0, atol=1e-9)
