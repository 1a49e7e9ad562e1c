"""Figures that notebooks show. Import this late: matplotlib takes half a second."""

import io

from matplotlib.figure import Figure


class Picture(Figure):
    """A figure that a notebook shows, also if pyplot was never imported."""

    def _repr_png_(self) -> bytes:
        picture = io.BytesIO()
        self.savefig(picture, format="png")
        return picture.getvalue()
