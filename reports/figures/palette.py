"""Colours and signs, each with one meaning in all reports. A colour never speaks alone: a sign and a word go with it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

INK = "#1b1f23"
SECOND = "#525a63"
RAW = "#8d96a0"
RULE = "#c9ced4"
BAND = "#eef0f2"
MODEL = "#0069a8"
LOWER = "#4f9fd6"
LOWEST = "#8d96a0"
WRONG = "#b8420a"
BETTER = "#00735a"
DAMAGED = "#7d5700"
REFUSED = "#8c2f6b"

_MISFIT = ((0.0, "#ffffff"), (0.2, "#fbe3d1"), (0.4, "#f0aa7b"), (0.6, "#cf6222"), (0.8, "#8a2f05"), (1.0, "#571b00"))


@dataclass(frozen=True)
class Group:
    """How a group of a campaign is drawn: colour, marker of the figures, the same marker as a sign in text, dashes of its lines."""

    colour: str
    marker: str
    sign: str
    dash: str | None = None


_FIRST = (
    Group("#94386d", "circle", "●"),
    Group("#8a6400", "square", "■"),
    Group("#0069a8", "triangle", "▲"),
    Group("#3f6212", "diamond", "◆"),
    Group("#5b3f9e", "down", "▼"),
    Group("#525a63", "cross", "✖"),
)
_MORE = (("left", "◀"), ("right", "▶"), ("star", "★"), ("plus", "✚"), ("pentagon", "⬟"), ("hexagon", "⬢"))
"""Markers of the second row, and their signs: more colours that are told apart on white, also without colour vision, there are not."""
GROUPS = (*_FIRST, *(Group(g.colour, marker, sign, "8 3") for g, (marker, sign) in zip(_FIRST, _MORE, strict=True)))


def group(index: int) -> Group:
    """The drawing of the index-th group: from the seventh on the colours come again, with other markers and dashed lines; from the
    thirteenth on they repeat, so the name must stand beside."""
    return GROUPS[index % len(GROUPS)]


def number_colour(index: int) -> int:
    """Which of the colours the index-th group has, as the style sheet numbers them."""
    return index % len(_FIRST)


def misfit(value: float) -> str:
    """Colour of a misfit in SD: white up to 1.3, then through vermilion to near black at 7."""
    share = min(1.0, max(0.0, (value - 1.3) / 5.5))
    for (low, first), (high, second) in itertools.pairwise(_MISFIT):
        if share <= high:
            return _between(first, second, (share - low) / (high - low))
    return _MISFIT[-1][1]


def _between(first: str, second: str, share: float) -> str:
    pairs = ((int(first[i : i + 2], 16), int(second[i : i + 2], 16)) for i in (1, 3, 5))
    return "#" + "".join(f"{round(a + (b - a) * share):02x}" for a, b in pairs)
