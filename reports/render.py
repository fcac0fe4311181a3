"""Pages from blocks: the templates, escaping everything that is not marked up by us."""

from __future__ import annotations

import base64
import functools
import hashlib
import json
import re
from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from reports.blocks import Page
from reports.names import Verbatim

_HERE = Path(__file__).parent


@functools.cache
def _environment(script: str) -> Environment:
    environment = Environment(
        loader=FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        finalize=unbroken,
    )
    environment.globals |= {"script": Markup(script), "hash": _digest(script)}  # noqa: S704
    return environment


def _digest(script: str) -> str:
    """How a policy names the one script that may run."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")


_CODE_OR_TEXT = re.compile(r"(<code>.*?</code>|<[^<>]*>)|([^<]+)", re.S)
_QUANTITY = re.compile(
    r"(?<=\d) (?=%|°C|Ω|(?:[kmµn]?(?:N|V|m|s|g|W|J)|[kMG]?(?:Hz|Pa|Ω)|[pn]F|min|h|d|K|eV|SD)\b)|(?<=\bln) (?=[A-Za-z]\b)"
)
_PROSE = re.compile(r"<(h[1-3]|p|figcaption)\b[^>]*>.*?</\1>", re.S)
_RANGE = re.compile(r"\(?−?\d[\d.\u202f]*–\d[\d.\u202f]*\)?")


def unbroken(value: object) -> object:
    """No-break spaces between numbers and units; code, markup and what must stay as typed (`Verbatim`) are left alone."""
    if not isinstance(value, str) or isinstance(value, Verbatim):
        return value
    if isinstance(value, Markup):
        return Markup(_CODE_OR_TEXT.sub(lambda m: m[1] or _QUANTITY.sub("\u00a0", m[2]), value))  # noqa: S704
    return _QUANTITY.sub("\u00a0", value)


def keep_ranges(page: str) -> str:
    """The page with ranges such as `(6.40–7.00)` in its prose kept on one line: a browser breaks it after the dash. Cells are kept anyway."""

    def keep(found: re.Match[str]) -> str:
        return _CODE_OR_TEXT.sub(
            lambda m: m[1] or _RANGE.sub(lambda r: f'<span class="one">{r[0]}</span>', m[2]), found[0]
        )

    return _PROSE.sub(keep, page)


@functools.cache
def _script() -> str:
    """The script of pages that may be asked, comments and indentation left out; it is ours and holds no data."""
    text = (_HERE / "interactive.js").read_text(encoding="utf-8")
    lines = (line.strip() for line in text.splitlines())
    return str(unbroken(Markup("\n".join(line for line in lines if line and not line.startswith("// ")))))  # noqa: S704


@functools.cache
def _style(*names: str) -> Markup:
    """The style sheets, comments and indentation left out; they are ours and hold no data."""
    text = "".join((_HERE / name).read_text(encoding="utf-8") for name in names)
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
    return Markup(re.sub(r"\s*\n\s*", "\n", text).strip())  # noqa: S704


def html(page: Page, *, interactive: bool = False, site: Sequence[tuple[str, str]] = ()) -> str:
    """The page's bytes as text; `interactive` with the script, and what a search in `site` finds: words → address."""
    style = _style("style.css", "interactive.css") if interactive else _style("style.css")
    entries = json.dumps(site, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c") if site else ""
    template = _environment(_script() if interactive else "").get_template("page.html.j2")
    return keep_ranges(template.render(page=page, style=style, entries=Markup(entries)))  # noqa: S704
