"""What a page consists of: blocks of text, figures and tables, and the small marked-up pieces inside them.

The templates turn blocks into HTML; every `str` is escaped there, only `Markup` made by the helpers below is not.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from markupsafe import Markup, escape

from reports.names import Verbatim, short, visible
from schemas.numbers import ABSENT, percent

Piece = str | Markup


@dataclass(frozen=True)
class Text:
    """A paragraph; `kind` is a class of the style sheet (`sub`, `lede`)."""

    block: ClassVar[str] = "text"
    body: Piece
    kind: str = ""


@dataclass(frozen=True)
class Heading:
    """A heading below that of the section."""

    block: ClassVar[str] = "heading"
    body: Piece


@dataclass(frozen=True)
class Next:
    """What to do next."""

    block: ClassVar[str] = "next"
    title: str
    body: Piece


@dataclass(frozen=True)
class Figure:
    """A drawing with its caption and the CSV file of its data (address relative to the page)."""

    block: ClassVar[str] = "figure"
    image: Markup
    caption: Piece
    data: str | tuple[str, ...] = ()
    above: bool = False
    wide: str = ""
    """Name of a figure over the whole width: on a narrow screen it scrolls."""

    @property
    def files(self) -> tuple[Link, ...]:
        """Links to the data files."""
        addresses = (self.data,) if isinstance(self.data, str) else self.data
        return tuple(Link(a.rpartition("/")[2], a) for a in addresses)


@dataclass(frozen=True)
class Pair:
    """Figures side by side."""

    block: ClassVar[str] = "pair"
    figures: tuple[Figure, ...]
    kind: str = "pair"
    """`pair` or `trio`: how many go side by side."""


@dataclass(frozen=True)
class Many:
    """Small multiples."""

    block: ClassVar[str] = "many"
    figures: tuple[Figure, ...]


@dataclass(frozen=True)
class Finding:
    """One finding: `kind` is named, open, fine or group; one with a figure takes the whole width."""

    title: Piece
    body: tuple[Piece, ...]
    kind: str
    next: Next | None = None
    figure: Figure | None = None


@dataclass(frozen=True)
class Findings:
    """The findings of a page, most important first."""

    block: ClassVar[str] = "findings"
    items: tuple[Finding, ...]

    @property
    def lone(self) -> frozenset[int]:
        """Places of findings without a figure that have no neighbour beside them: they take the whole width."""
        found, before = set(), 0
        for i, item in enumerate(self.items):
            before = 0 if item.figure is not None else before + 1
            last = i + 1 == len(self.items) or self.items[i + 1].figure is not None
            if before % 2 and last:
                found.add(i)
        return frozenset(found)


@dataclass(frozen=True)
class Head:
    """A column head; `kind` is `n` for numbers or a class of the style sheet."""

    text: Piece
    kind: str = ""

    @property
    def numeric(self) -> bool:
        return self.kind == "n"


@dataclass(frozen=True)
class Row:
    """Cells of a row, the first its header; `kind` is `sel` (chosen) or `dim`."""

    cells: tuple[Piece, ...]
    kind: str = ""


@dataclass(frozen=True)
class Table:
    """A table with its caption and the SQL that made it."""

    block: ClassVar[str] = "table"
    caption: Piece
    heads: tuple[Head, ...]
    rows: tuple[Row, ...]
    sql: Verbatim = Verbatim()
    note: Piece = ""
    below: Piece = ""
    kind: str = ""


@dataclass(frozen=True)
class Facts:
    """Names and values, such as metadata."""

    block: ClassVar[str] = "facts"
    pairs: tuple[tuple[Piece, Piece], ...]


@dataclass(frozen=True)
class Pre:
    """Text as it stands, such as settings."""

    block: ClassVar[str] = "pre"
    body: Verbatim


@dataclass(frozen=True)
class Count:
    """One number of the tally."""

    number: str
    text: str
    kind: str = ""


@dataclass(frozen=True)
class Tally:
    """The numbers of a night."""

    block: ClassVar[str] = "tally"
    items: tuple[Count, ...]


@dataclass(frozen=True)
class Link:
    """A link of the bar or between pages; without address it is the page at hand."""

    text: str
    href: str = ""
    current: bool = False


@dataclass(frozen=True)
class Pages:
    """Links between the parts of a long list."""

    block: ClassVar[str] = "pages"
    items: tuple[Link, ...]


Block = Text | Heading | Next | Figure | Pair | Many | Findings | Table | Facts | Pre | Tally | Pages


@dataclass(frozen=True)
class Fold:
    """Details that open on demand."""

    block: ClassVar[str] = "fold"
    summary: Piece
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Section:
    """A part of a page: its address on the page, its heading (the finding), its short name in the list of contents."""

    id: str
    heading: Piece
    link: str
    blocks: tuple[Block | Fold, ...]


@dataclass(frozen=True)
class Page:
    """A whole page. `provenance` is the footer."""

    title: str
    heading: Piece
    bar: tuple[Link, ...]
    sections: tuple[Section, ...]
    when: str = ""
    crumbs: tuple[Link, ...] = ()
    lede: Piece = ""
    sub: Piece = ""
    opening: tuple[Block | Fold, ...] = ()
    provenance: tuple[Block | Fold, ...] = ()
    provenance_heading: str = "Provenance"
    files: dict[str, str] = field(default_factory=dict)
    """CSV files beside the page: address from the reports' folder → text."""
    further: tuple[tuple[str, Page], ...] = ()
    """Pages that are made with this one, with their addresses: what would make it too long."""


def filled(heads: Sequence[Head], rows: Sequence[Row]) -> tuple[tuple[Head, ...], tuple[Row, ...]]:
    """Heads and rows without the columns in which no row has anything."""
    kept = [i for i in range(len(heads)) if i == 0 or any(r.cells[i] not in (ABSENT, "") for r in rows)]
    return tuple(heads[i] for i in kept), tuple(Row(tuple(r.cells[i] for i in kept), r.kind) for r in rows)


_SIGNS = {
    "named": "●", "ambiguous": "◐", "unknown": "◇", "none": "○", "damaged": "▲", "refused": "✕",
    "quarantined": "✕", "excluded": "⊘", "duplicate": "=", "pending": "…", "ok": "✓",
}  # fmt: skip


def tag(kind: str, word: str = "") -> Markup:
    """A verdict or status: sign and word together, never colour alone."""
    style = "refused" if kind == "quarantined" else kind
    word = word or style
    return Markup('<span class="tag {}">{}</span>').format(
        style if style in _SIGNS else "", f"{_SIGNS.get(kind, '')} {word}".strip()
    )


def code(text: str) -> Markup:
    """An id, a file name, a command."""
    return Markup("<code>{}</code>").format(visible(text))


def name(text: str | None, limit: int = 48) -> Markup:
    """A name from metadata: on one line, cut, and kept from turning the direction of the text around it."""
    return Markup("<bdi>{}</bdi>").format(short(text, limit)) if text else Markup("{}").format(ABSENT)


def link(text: Piece, href: str) -> Markup:
    """A link to a page of ours; without address the text alone."""
    return Markup('<a href="{}">{}</a>').format(href, text) if href else Markup("{}").format(text)


def sub(symbol: str, index: int | str) -> Markup:
    """k with index 1."""
    return Markup("{}<sub>{}</sub>").format(symbol, index)


_BRACED, _RAISED = re.compile(r"\^\{([^{}]*)\}"), re.compile(r"\^(\w)")
_LOWERED = re.compile(r"(?<=\b\w)_(\w+)")


def equation(text: str) -> Markup:
    """An equation that was stored as plain text: `V_max^p` with its index below and its exponent above."""
    marked = _RAISED.sub(r"<sup>\1</sup>", _BRACED.sub(r"<sup>\1</sup>", str(escape(visible(text)))))
    return Markup(_LOWERED.sub(r"<sub>\1</sub>", marked))  # noqa: S704


def bold(text: Piece) -> Markup:
    """The beginning of a caption."""
    return Markup("<b>{}</b>").format(text)


def bar(share: float, *, chosen: bool, text: str = "") -> Markup:
    """A share from 0 to 1 as text (percent unless another is given) and a horizontal bar."""
    width = min(1.0, max(0.0, share)) * 100
    colour = "#00735a" if chosen else "#9aa2ab"
    return Markup(
        '{}<svg width="100%" height="11" aria-hidden="true"><rect width="{}%" height="11" fill="{}"/></svg>'
    ).format(text or percent(share), f"{max(width, 0.5):.1f}", colour)


def flow(*parts: Piece) -> Markup:
    """Pieces joined without anything between; plain text is escaped."""
    return Markup("").join(parts)


def listed(parts: Sequence[Piece], last: str = " and ") -> Markup:
    """`a, b and c` from marked-up pieces."""
    if len(parts) < 2:
        return flow(*parts)
    return flow(Markup(", ").join(parts[:-1]), last, parts[-1])


def separated(parts: Iterable[Piece]) -> Markup:
    """Pieces with dots between; empty ones are left out."""
    return Markup(" · ").join(p for p in parts if p)
