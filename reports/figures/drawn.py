"""Figures that a page had already: what the same data drew before need not be drawn again.

A figure on a page says the digest of what it was drawn from, of the code that draws, and of what came out. When the page is made
anew, those whose data are the same are taken over from the page as it was. So nothing is kept beside the pages, nothing grows
old, and a page that somebody has changed by hand gives nothing back.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import pickle
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from markupsafe import Markup

Drawn = tuple[Markup, Markup]
"""A figure as HTML, and its values as JSON; the latter is empty on pages without a script."""

_FIGURE = re.compile(
    r'(?P<html>(?:<span class="plot">)?<img [^>]* data-drawn="(?P<data>[0-9a-f]{32})-(?P<result>[0-9a-f]{16})">'
    r'(?:<svg class="said".*?</svg>)?(?P<asked></span>)?)'
    r'(?:<script type="application/json" class="values">(?P<values>[^<]*)</script>)?',
    re.S,
)
_NONE: Mapping[str, Drawn] = {}
_BEFORE: ContextVar[Mapping[str, Drawn]] = ContextVar("_BEFORE", default=_NONE)


@contextmanager
def drawn_before(*pages: Path, with_values: bool) -> Iterator[None]:
    """Within it, figures of those pages as they are on disk are taken over; `with_values` where the new page needs their values."""
    found: dict[str, Drawn] = {}
    for page in pages:
        try:
            found |= _read(page.read_text(encoding="utf-8"), with_values=with_values)
        except (OSError, ValueError):
            continue
    token = _BEFORE.set(found)
    try:
        yield
    finally:
        _BEFORE.reset(token)


def _read(text: str, *, with_values: bool) -> Mapping[str, Drawn]:
    found = {}
    for match in _FIGURE.finditer(text):
        html, values = match["html"], match["values"] or ""
        if with_values and match["asked"] and not values:
            continue
        if match["result"] == digest_result(_without_digest(html)):
            found[match["data"]] = (Markup(html), Markup(values))  # noqa: S704
    return found


def find_drawn(digest: str | None) -> Drawn | None:
    """The figure that was drawn from data of this digest; None where it must be drawn."""
    return None if digest is None else _BEFORE.get().get(digest)


def digest_data(*what: Any) -> str | None:
    """The digest of what a figure is drawn from; None where it cannot be told, and the figure is drawn each time."""
    try:
        data = pickle.dumps(what, protocol=5)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    return hashlib.sha256(_code() + data).hexdigest()[:32]


def digest_result(html: str) -> str:
    """The digest of a figure's HTML, the same with the no-break spaces that a page puts into it."""
    return hashlib.sha256(str(html).replace("\u00a0", " ").encode()).hexdigest()[:16]


def mark(html: Markup, digest: str | None) -> Markup:
    """The figure with both digests in it, for the page after this one."""
    if digest is None:
        return html
    before, image, after = str(html).partition("<img ")
    attributes, _, rest = after.partition(">")  # within an attribute it is escaped
    said = f' data-drawn="{digest}-{digest_result(html)}"'
    return Markup(f"{before}{image}{attributes}{said}>{rest}")  # noqa: S704


def _without_digest(html: str) -> str:
    return re.sub(r' data-drawn="[^"]*"', "", html, count=1)


@functools.cache
def _code() -> bytes:
    """Digest of the code that draws, ours and that of the libraries."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    for library in ("matplotlib", "numpy", "pillow"):
        digest.update(f"{library} {importlib.metadata.version(library)}\n".encode())
    return digest.digest()
