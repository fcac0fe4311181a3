"""The confusion matrix of the diagnosis study as a picture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from html import escape

from tests.helpers.judging import Judgement
from tests.helpers.truth_rig import MECHANISMS, UNLISTED

_CELL, _LEFT, _TOP = 22, 230, 200


def confusion_svg(found: Sequence[Judgement]) -> str:
    """Rows: what was hidden; columns: the first cause named, or the verdict. Darker: a larger share of the row."""
    rows = ["nothing", *MECHANISMS, *UNLISTED]
    columns = ["none", *MECHANISMS, "unknown"]
    counts: dict[str, Counter[str]] = {row: Counter() for row in rows}
    for j in found:
        if len(j.hidden) < 2 and j.verdict != "not detectable":
            counts[j.hidden[0] if j.hidden else "nothing"][j.first] += 1
    width, height = _LEFT + _CELL * len(columns) + 20, _TOP + _CELL * len(rows) + 20
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="system-ui, sans-serif" font-size="12" role="img">',
        "<title>What was hidden against what was named first</title>",
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for j, column in enumerate(columns):
        x = _LEFT + _CELL * (j + 0.5)
        parts.append(
            f'<text transform="translate({x + 4:.0f},{_TOP - 6}) rotate(-60)" fill="#333">{escape(_words(column))}</text>'
        )
    for i, row in enumerate(rows):
        y = _TOP + _CELL * i
        total = sum(counts[row].values())
        parts.append(f'<text x="{_LEFT - 8}" y="{y + 15}" text-anchor="end" fill="#333">{escape(_words(row))}</text>')
        for j, column in enumerate(columns):
            x, n = _LEFT + _CELL * j, counts[row][column]
            share = n / total if total else 0.0
            right = (
                column == row or (row == "nothing" and column == "none") or (row in UNLISTED and column == "unknown")
            )
            base = (0, 90, 156) if right else (190, 70, 0)
            fill = "#" + "".join(f"{round(255 - (255 - c) * share):02x}" for c in base)
            parts.append(
                f'<rect x="{x}" y="{y}" width="{_CELL - 1}" height="{_CELL - 1}" fill="{fill}" stroke="#e4e4e4"/>'
            )
            if n:
                colour = "#fff" if share > 0.5 else "#333"
                parts.append(
                    f'<text x="{x + _CELL / 2:.0f}" y="{y + 15}" text-anchor="middle" fill="{colour}" font-size="10">{n}</text>'
                )
    parts.append("</svg>")
    return "\n".join(parts) + "\n"


def _words(name: str) -> str:
    return name.replace("_", " ")
