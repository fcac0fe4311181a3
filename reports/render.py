"""Pages from blocks: the templates, escaping everything that is not marked up by us."""

from __future__ import annotations

import functools
import re
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from reports.blocks import Page
from reports.names import Verbatim

_HERE = Path(__file__).parent


@functools.cache
def _environment() -> Environment:
    return Environment(
        loader=FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        finalize=unbroken,
    )


_CODE_OR_TEXT = re.compile(r"(<code>.*?</code>|<[^<>]*>)|([^<]+)", re.S)
_QUANTITY = re.compile(r"(?<=\d) (?=(?:%|(?:Hz|kV|mN|mm|N|pF|s|ms|min|h|SD|MPa|kg)\b))")


def unbroken(value: object) -> object:
    """No-break spaces between numbers and units; code, markup and what must stay as typed (`Verbatim`) are left alone."""
    if not isinstance(value, str) or isinstance(value, Verbatim):
        return value
    if isinstance(value, Markup):
        return Markup(_CODE_OR_TEXT.sub(lambda m: m[1] or _QUANTITY.sub("\u00a0", m[2]), value))  # noqa: S704
    return _QUANTITY.sub("\u00a0", value)


@functools.cache
def _style() -> Markup:
    """The style sheet, comments and indentation left out; it is ours and holds no data."""
    text = (_HERE / "style.css").read_text(encoding="utf-8")
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
    return Markup(re.sub(r"\s*\n\s*", "\n", text).strip())  # noqa: S704


def html(page: Page) -> str:
    """The page's bytes as text."""
    return _environment().get_template("page.html.j2").render(page=page, style=_style())
