"""Docstrings of this house as reStructuredText, for the site.

They are plain text with `code` between single marks, *stress* between stars, lists, pictures that are indented, and sections underlined as numpydoc has
them, whose entries are `names : text`. Nothing else means anything: every other sign of reStructuredText is taken as it stands.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

_CODE = re.compile(r"(``[^`]+``|`[^`\n]+`)")
_LIST = re.compile(r"(-|\d+\.) ")
_SIGN = re.compile(r"((?<!\w)\*\w[^*\n]*\*(?!\w))|[\\*|`<]|_(?!\w)")
"""Words that are stressed by stars, which stay, and signs that would mean something."""
_LISTED = ("Parameters", "Raises", "Attributes")
"""Sections that are lists of entries; the others are text."""


def as_rst(lines: Sequence[str]) -> list[str]:
    """The lines of a docstring, without their common indentation, as reStructuredText."""
    made: list[str] = []
    for block in _list_blocks(lines):
        if len(block) > 1 and re.fullmatch("-{3,}", block[1]):
            made += [f".. rubric:: {block[0]}", ""]
            block = block[2:]
            if block and made[-2].endswith(_LISTED):
                made += [*_entries(block), ""]
                continue
        if not block:
            continue
        if block[0].startswith(" "):
            made += ["::", "", *(f"    {line}".rstrip() for line in block), ""]
        elif any(_LIST.match(line) for line in block):
            made += [*_list(block), ""]
        else:
            made += [*_text(block), ""]
    return made


def _list_blocks(lines: Sequence[str]) -> Iterator[list[str]]:
    """Runs of lines without an empty one between; indented ones that follow each other stay together, as a picture does."""
    block: list[str] = []
    empty = 0
    for line in lines:
        if not line.strip():
            empty += bool(block)
            continue
        if empty:
            if block[0].startswith(" ") and line.startswith(" "):
                block += [""] * empty
            else:
                yield block
                block = []
        empty = 0
        block.append(line.rstrip())
    if block:
        yield block


def _entries(block: list[str]) -> Iterator[str]:
    """Entries of a section as a definition list: `names : text` or a name, and the lines that go on below it."""
    for line in block:
        if line.startswith(" "):
            yield f"    {inline(line.strip())}"
        else:
            names, colon, text = line.partition(" : ")
            yield f"``{names.strip('`')}``"
            yield f"    {inline(text)}" if colon else "    \\"


def _list(block: list[str]) -> Iterator[str]:
    """A list, with the empty line that has to stand between it and the text before."""
    indent = 0
    for line in block:
        mark = _LIST.match(line)
        if mark and not indent:
            yield ""
        indent = len(mark.group()) if mark else indent
        yield f"{mark.group() if mark else ' ' * indent}{inline(line.strip().removeprefix(mark.group() if mark else ''))}"


def _text(block: list[str]) -> Iterator[str]:
    """A paragraph. What is indented below a line of it is shown as it stands."""
    shown = False
    for line in block:
        if line.startswith(" ") != shown:
            yield from ([""] if shown else ["", "::", ""])
            shown = not shown
        yield f"    {line}" if shown else inline(line.removesuffix("::") if line.endswith("::") else line)


def inline(line: str) -> str:
    """A line with its `code` marked and every other sign as it stands."""
    parts = _CODE.split(line)
    for i, part in enumerate(parts):
        if not i % 2:
            parts[i] = _SIGN.sub(lambda found: found.group(1) or f"\\{found.group()}", part)
            continue
        before = "\\ " if parts[i - 1][-1:].isalnum() else ""
        after = "\\ " if parts[i + 1][:1].isalnum() else ""
        parts[i] = f"{before}``{part.strip('` ')}``{after}"
    return "".join(parts)
