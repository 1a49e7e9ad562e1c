"""Pictures of workspaces: each line of the legend is drawn."""

import numpy as np
import pytest
from matplotlib.contour import ContourSet

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.pictures.workspace_plots import Field, draw_workspace
from tests.arms import paper_arm, spatial_arm

SIZE = 20


def field(manipulator: Manipulator, least: float) -> Field:
    """A block of pixels with at least 10^least configurations, inside a box of empty pixels."""
    shape = (1 if manipulator.planar else SIZE, SIZE, SIZE)
    counts = np.full(shape, -np.inf)
    inner = slice(None) if manipulator.planar else slice(4, -4)
    counts[inner, 4:-4, 4:-4] = least + np.linspace(0, 2, SIZE - 8)
    return Field("positions", counts, np.zeros(3), 0.1)


@pytest.mark.parametrize("manipulator", [paper_arm(2), spatial_arm(2)], ids=["planar", "spatial"])
@pytest.mark.parametrize("least", [-5.0, -1.0, 0.0, 3.0])
def test_the_line_of_one_configuration_is_drawn_where_the_legend_has_it(manipulator: Manipulator, least: float) -> None:
    picture = draw_workspace(manipulator, [field(manipulator, least)])
    lines = [path.vertices for contours in picture.findobj(ContourSet) for path in contours.get_paths()]
    named = [text.get_text() for part in picture.subfigs for legend in part.legends for text in legend.get_texts()]
    drawn = any(len(line) > 4 for line in lines)
    assert drawn == ("one configuration" in named) == (least + 2 >= 0)
