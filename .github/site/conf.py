"""How Sphinx makes the site from what `tests/tools/site.py` has laid out: local files alone, docstrings as this house writes them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from pygments.lexers.special import TextLexer

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import schemas.arrays  # noqa: E402
from tests.tools.docstrings import as_rst  # noqa: E402

project = "dealab"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
master_doc = "index"
myst_heading_anchors = 6
highlight_language = "none"
pygments_style = "friendly"
smartquotes = False

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in vars(schemas.arrays) if name[0].isupper()}
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 100
add_module_names = False
suppress_warnings = ["ref.python"]  # a name in a signature that several modules have is no link

html_theme = "basic"
html_title = "dealab"
templates_path = ["."]
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_sidebars = {"**": ["searchbox.html", "contents.html"]}
html_show_sphinx = False
html_show_copyright = False
html_show_sourcelink = False
html_copy_source = False
html_domain_indices = False
html_use_index = True
html_permalinks = False


def translate(_app: Any, _what: str, _name: str, _thing: Any, _options: Any, lines: list[str]) -> None:
    """A docstring in our words as Sphinx understands it."""
    lines[:] = as_rst(lines)


def setup(app: Any) -> None:
    app.connect("autodoc-process-docstring", translate)
    app.add_lexer("csv", TextLexer)
