"""A figure of a page that remembers what it was drawn from, so that the same data can leave the page as a printed figure."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec, Self

from markupsafe import Markup

from reports.figures.svg import Image

P = ParamSpec("P")


class Picture(Image):
    """A figure as HTML; `kind` is what it shows, `data` and `options` are what it was drawn from, `finding` is its alt text."""

    kind: str
    data: tuple[Any, ...]
    options: Mapping[str, Any]
    finding: str

    @classmethod
    def keep(cls, image: Markup, kind: str, data: tuple[Any, ...], options: Mapping[str, Any]) -> Self:
        """The HTML with what it was drawn from; `options` without the alt text, which is the finding."""
        picture = cls(image)
        if isinstance(image, Image):
            picture.drawing = image.drawing
        picture.kind, picture.data = kind, data
        picture.options = {name: value for name, value in options.items() if name != "alt"}
        picture.finding = str(options["alt"])
        return picture


def pictured(kind: str) -> Callable[[Callable[P, Markup]], Callable[P, Picture]]:
    """Makes a function that draws for pages keep its data beside what it draws."""

    def keep_data(draw: Callable[P, Markup]) -> Callable[P, Picture]:
        @functools.wraps(draw)
        def draw_and_keep(*data: P.args, **options: P.kwargs) -> Picture:
            return Picture.keep(draw(*data, **options), kind, data, options)

        return draw_and_keep

    return keep_data
