"""How printed figures look, and how they become files: sizes, type, lines, and what a file says of itself.

Nothing here reads or changes the state of pyplot. The same data give the same bytes: no date, no random names, the font that
comes with matplotlib.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.palette import INK, SECOND

WIDTHS_MM = {"single": 85.0, "double": 175.0}
"""Widths of a figure in one and in two columns of a journal, mm."""
SINGLE, DOUBLE = "single", "double"
ENDINGS = {".pdf": "pdf", ".svg": "svg", ".png": "png"}
"""Endings of files that a figure can be written to, and matplotlib's name of their format."""

TEXT_PT, TICK_PT = 7.0, 6.3
CURVE_PT, FINE_PT, POINT_PT = 1.3, 0.6, 2.7
_PNG_DPI = 300
_MM = 1 / 25.4

_STYLE: Mapping[str, Any] = {
    "font.family": ["DejaVu Sans"],
    "font.size": TEXT_PT,
    "mathtext.fontset": "dejavusans",
    "text.color": INK,
    "axes.edgecolor": SECOND,
    "axes.labelcolor": INK,
    "axes.labelsize": TEXT_PT,
    "axes.titlesize": TEXT_PT,
    "axes.titlelocation": "left",
    "axes.titlepad": 5.0,
    "axes.linewidth": FINE_PT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "xtick.color": SECOND,
    "ytick.color": SECOND,
    "xtick.labelsize": TICK_PT,
    "ytick.labelsize": TICK_PT,
    "xtick.major.width": FINE_PT,
    "ytick.major.width": FINE_PT,
    "xtick.minor.width": 0.8 * FINE_PT,
    "ytick.minor.width": 0.8 * FINE_PT,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "xtick.minor.size": 1.8,
    "ytick.minor.size": 1.8,
    "lines.solid_capstyle": "round",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "figure.constrained_layout.w_pad": 0.03,
    "figure.constrained_layout.h_pad": 0.03,
    "pdf.fonttype": 42,  # TrueType, embedded: journals refuse type 3
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "dealab",
}


@contextmanager
def styled() -> Iterator[None]:
    """Within it, what is drawn or written has the style of the house; the style of the caller comes back after it."""
    with matplotlib.rc_context():
        matplotlib.rcParams.update(matplotlib.rcParamsDefault)
        matplotlib.rcParams.update(_STYLE)
        yield


def open_axes(width: str, height_mm: float, heights: Sequence[float] = (1.0,), columns: int = 1) -> tuple[Figure, Any]:
    """A figure of that width and height, and its axes, (rows, columns) with rows of these relative heights."""
    figure = Figure(figsize=(WIDTHS_MM[width] * _MM, height_mm * _MM), layout="constrained")
    grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    axes = np.empty((len(heights), columns), dtype=object)
    for i in range(len(heights)):
        for j in range(columns):
            axes[i, j] = figure.add_subplot(grid[i, j])
    return figure, axes


def find_figure(axes: Axes) -> Figure:
    """The figure that the axes are in."""
    figure = axes.get_figure(root=True)
    if figure is None:
        raise ValueError("these axes are in no figure")
    return figure


def is_wide(axes: Axes) -> bool:
    """The figure of these axes is made for two columns."""
    return bool(find_figure(axes).get_figwidth() > 1.5 * WIDTHS_MM[SINGLE] * _MM)


def write_figure(figure: Figure, file: Path | IO[bytes], form: str, *, title: str, finding: str) -> None:
    """Writes a figure as `pdf`, `svg` or `png`; title and finding stand in the file for who cannot see it."""
    known: dict[str, dict[str, Any]] = {
        "pdf": {"Title": title, "Subject": finding, "Creator": "dealab", "Producer": None, "CreationDate": None},
        "svg": {"Title": title, "Description": finding, "Creator": "dealab", "Date": None, "Format": None, "Type": None},
        "png": {"Title": title, "Description": finding, "Software": None},
    }  # fmt: skip
    with styled():
        figure.savefig(file, format=form, dpi=_PNG_DPI, metadata=known[form])
