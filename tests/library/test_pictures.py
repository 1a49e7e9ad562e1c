"""Pictures and animations of the library, in files, in axes of the caller and in notebooks."""

import base64
import io
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

import hyperbit as hb
from tests.commands.test_without_matplotlib import HIDE

Drawn = Callable[[hb.Arm, hb.Path], Any]


@pytest.fixture(scope="module")
def path(arm: hb.Arm) -> hb.Path:
    return hb.Solver(arm).follow([arm.position(row) for row in arm.sample(2, seed=2)])


@pytest.fixture(scope="module")
def spatial() -> hb.Arm:
    return hb.Arm([hb.revolute([-0.5, 0.5], axis=(1, 0, 0), link=(0.0, 0.0, 0.2), count=3)], unit="cm")


DRAWN: dict[str, tuple[Drawn, list[str]]] = {
    "nothing": (lambda arm, path: None, []),
    "path": (lambda arm, path: path, ["point 1", "point 2"]),
    "solution": (lambda arm, path: path.solutions[0], ["solution"]),
    "configuration": (lambda arm, path: arm.home, ["configuration"]),
    "text": (lambda arm, path: "0123", ["configuration"]),
    "configurations": (lambda arm, path: arm.sample(11), [f"configuration {k}" for k in (1, 3, 5, 7, 9, 11)]),
    "solutions": (lambda arm, path: ["0000", *path.solutions], [f"configuration {k}" for k in (1, 2, 3)]),
    "names": (lambda arm, path: {"home": arm.home, "end": path.solutions[1]}, ["home", "end"]),
}


@pytest.mark.parametrize("drawn", DRAWN)
def test_whatever_has_configurations_is_drawn(arm: hb.Arm, path: hb.Path, drawn: str, tmp_path: Path) -> None:
    given, names = DRAWN[drawn]
    figure = hb.plot(arm, given(arm, path), obstacles=[hb.Disc((2.0, 2.0), 0.1)], targets=[(0.1, 0.8)])
    labels = figure.axes[0].get_legend_handles_labels()[1]
    assert [label for label in labels if label not in ("targets", "waypoints", "keep out")] == names
    figure.savefig(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 1000


def test_a_spatial_arm_is_drawn_without_its_density(spatial: hb.Arm) -> None:
    figure = hb.plot(spatial, {"home": spatial.home}, obstacles=[hb.Sphere((1, 1, 1), 0.2)])
    assert figure.axes[0].get_zlabel() == "z [cm]"
    assert "_densities" not in vars(spatial)


def test_axes_of_the_caller_are_used(arm: hb.Arm, spatial: hb.Arm, path: hb.Path, tmp_path: Path) -> None:
    figure = Figure()
    canvas = FigureCanvasAgg(figure)
    flat, deep = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
    assert hb.plot(arm, path, ax=flat) is hb.plot(spatial, spatial.home, ax=deep) is figure
    assert (flat.get_title(), deep.get_title()) == ("short", "arm")
    hb.animate(spatial, spatial.sample(2), ax=deep).save(tmp_path / "arm.gif")
    assert figure.canvas is canvas, "the caller's window stays his"
    for wrong, kind in ((lambda: hb.plot(arm, ax=deep), "planar"), (lambda: hb.animate(spatial, "000", ax=flat), "3d")):
        with pytest.raises(hb.PictureError, match=f"ax: this arm is .*{kind}"):
            wrong()


@pytest.mark.parametrize("suffix", ["gif", "png", "webp"])
def test_an_animation_moves_through_the_configurations(arm: hb.Arm, path: hb.Path, suffix: str, tmp_path: Path) -> None:
    hb.animate(arm, [arm.home, *path.solutions], density=False).save(tmp_path / f"arm.{suffix}")
    with Image.open(tmp_path / f"arm.{suffix}") as image:
        assert image.n_frames == 1 + 2 * 4
        first = image.convert("RGB").tobytes()
        image.seek(8)
        assert image.convert("RGB").tobytes() != first


def test_an_animation_is_one_of_matplotlib(arm: hb.Arm, tmp_path: Path) -> None:
    film = hb.animate(arm, arm.sample(2), density=False)
    film.save(tmp_path / "arm.gif", writer="pillow", dpi=30)
    with Image.open(tmp_path / "arm.gif") as image:
        assert image.n_frames > 1
    for name in ("arm.nothing", "missing/arm.gif"):
        with pytest.raises(hb.PictureError, match=f"{name}: cannot be written"):
            film.save(tmp_path / name)
    with pytest.raises(hb.ConfigurationError, match="motion: at least one"):
        hb.animate(arm, arm.sample(0))


def test_notebooks_show_figures_animations_solutions_and_paths(arm: hb.Arm, path: hb.Path) -> None:
    with Image.open(io.BytesIO(hb.plot(arm, path)._repr_png_())) as image:
        assert image.format == "PNG"
    html = hb.animate(arm, path, density=False)._repr_html_()
    data = re.fullmatch(r'<img alt="animation" src="data:image/gif;base64,(.*)">', html)
    assert data is not None
    with Image.open(io.BytesIO(base64.b64decode(data[1]))) as image:
        assert image.n_frames > 1
    assert path._repr_html_().startswith("<p>2 goals, ")
    assert path._repr_html_().count("<tr>") == 3
    missed = hb.Solver(arm, obstacles=[hb.Disc((9, 9), 0.1, "wall")]).solve((9, 9))
    assert "the goal is in disc &#x27;wall&#x27;" in missed._repr_html_()


def test_without_matplotlib_the_extra_is_named() -> None:
    library = HIDE.partition("from hyperbit")[0]
    code = f"""{library}
import hyperbit as hb
arm = hb.Arm([hb.vgt(width=0.2, lengths=(0.2, 0.25))])
for act in (lambda: hb.plot(arm), lambda: hb.animate(arm, arm.home)):
    try:
        act()
    except hb.PictureError as error:
        print(error)
print(arm._repr_html_())"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr == ""
    line = "pictures need matplotlib: pip install 'hyperbit[pictures]'"
    assert done.stdout.splitlines() == [
        line,
        line,
        "<p><code>Arm(&#x27;arm&#x27;: planar, 1 modules, 3 actuators)</code></p>",
    ]
