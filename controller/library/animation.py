"""Animations of arms. Import this late: matplotlib takes half a second."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any

from matplotlib.animation import FuncAnimation

from hyperbit.controller.library.arguments import typed
from hyperbit.controller.library.errors import PictureError
from hyperbit.controller.pictures.animation import FRAME, Film

OWN_FORMATS = (".gif", ".png", ".webp")  # small files, by Pillow


class Animation(FuncAnimation):
    """A matplotlib animation that notebooks show, and that needs no writer for GIF, APNG and WebP."""

    def __init__(self, film: Film) -> None:
        frames = [k for k, duration in enumerate(film.durations) for _ in range(round(duration / FRAME))]
        super().__init__(film.figure, film.draw, frames, interval=FRAME)
        self._film = film

    @typed(PictureError)
    def save(self, filename: str | Path, *args: Any, **kwargs: Any) -> None:
        """Writes the animation; formats other than .gif, .png and .webp, and options, are those of matplotlib.

        Raises:
            PictureError: the file cannot be written, or nothing writes its format.
        """
        path = Path(filename)
        if not path.suffix:
            raise PictureError(f"filename: a suffix such as .gif is needed, got {path}")
        try:
            if path.suffix.lower() in OWN_FORMATS and not args and not kwargs:
                self._draw_was_started = True  # else matplotlib warns that nothing was shown
                self._film.write(path)
            else:
                super().save(filename, *args, **kwargs)
        except (OSError, ValueError) as error:
            raise PictureError(f"{path}: cannot be written: {error}") from None

    def _repr_html_(self) -> str:
        picture = io.BytesIO()
        self._draw_was_started = True
        self._film.write(picture, "gif")
        data = base64.b64encode(picture.getvalue()).decode()
        return f'<img alt="animation" src="data:image/gif;base64,{data}">'
