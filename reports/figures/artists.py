"""What figures are drawn with: parts of matplotlib, each loaded when the first figure that needs it is drawn.

Pages whose figures are as they were are made without them: loading matplotlib takes longer than the work of a night with
nothing new.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib import rc_context as rc_context
    from matplotlib import rcParams as rcParams
    from matplotlib import rcParamsDefault as rcParamsDefault
    from matplotlib.collections import LineCollection as LineCollection
    from matplotlib.figure import Figure as Figure
    from matplotlib.image import BboxImage as BboxImage
    from matplotlib.lines import Line2D as Line2D
    from matplotlib.patches import Polygon as Polygon
    from matplotlib.patches import Rectangle as Rectangle
    from matplotlib.text import Text as Text
    from matplotlib.ticker import FixedFormatter as FixedFormatter
    from matplotlib.ticker import FixedLocator as FixedLocator
    from matplotlib.ticker import NullLocator as NullLocator
    from matplotlib.transforms import Affine2D as Affine2D
    from matplotlib.transforms import Bbox as Bbox
    from matplotlib.transforms import TransformedBbox as TransformedBbox

_HOMES = {
    "matplotlib": ("rc_context", "rcParams", "rcParamsDefault"),
    "matplotlib.collections": ("LineCollection",),
    "matplotlib.figure": ("Figure",),
    "matplotlib.image": ("BboxImage",),
    "matplotlib.lines": ("Line2D",),
    "matplotlib.patches": ("Polygon", "Rectangle"),
    "matplotlib.text": ("Text",),
    "matplotlib.ticker": ("FixedFormatter", "FixedLocator", "NullLocator"),
    "matplotlib.transforms": ("Affine2D", "Bbox", "TransformedBbox"),
}
"""Which module has which parts; who reads the types finds them above."""


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            part = globals()[name] = getattr(importlib.import_module(home), name)
            return part
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
