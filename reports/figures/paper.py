"""Figures for a paper: as wide as a column, in files with their fonts and their finding, the same bytes each time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

from reports.figures.panel import TEXT, Drawing, Sheet, on_sheet, styled

WIDTHS_MM = {"single": 85.0, "double": 175.0}
"""Widths of a figure in one and in two columns of a journal, mm."""
SINGLE, DOUBLE = "single", "double"
ENDINGS = {".pdf": "pdf", ".svg": "svg", ".png": "png"}
"""Endings of files that a figure can be written to, and matplotlib's name of their format."""

_TEXT_PT = 7.0
"""Size of text in a column, pt."""
_PNG_DPI = 300
_TRIES = 3
"""How often room is made for text that reaches over an edge: less of a panel can bring other ticks."""


def draw_for_column(draw: Callable[[], Drawing], width: str) -> Drawing:
    """The figure in that width; panels leave the room that the text beside them takes in the font of the file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    unit = _TEXT_PT / TEXT
    sheet = Sheet(unit, WIDTHS_MM[width] / 25.4 * 72 / unit)
    for _ in range(_TRIES):
        with styled(), on_sheet(sheet):
            drawing = draw()
            left, right = drawing.overhang(FigureCanvasAgg(drawing.figure).get_renderer())
        if left < 1 and right < 1:
            break
        sheet = replace(sheet, left=sheet.left + left, right=sheet.right + right)
    return drawing


def write_figure(drawing: Drawing, file: Path | IO[bytes], form: str, *, title: str, finding: str) -> None:
    """Writes its figure as `pdf`, `svg` or `png`; title and finding stand in the file for who cannot see it."""
    known: Mapping[str, dict[str, Any]] = {
        "pdf": {"Title": title, "Subject": finding, "Creator": "dealab", "Producer": None, "CreationDate": None},
        "svg": {"Title": title, "Description": finding, "Creator": "dealab", "Date": None, "Format": None, "Type": None},
        "png": {"Title": title, "Description": finding, "Software": None},
    }  # fmt: skip
    with styled():
        drawing.figure.savefig(file, format=form, dpi=_PNG_DPI, metadata=known[form])
