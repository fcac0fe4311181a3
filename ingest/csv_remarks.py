"""Lines of a text file that are remarks: what a mapping says of them with `comment`, and what they say themselves.

Where rows count as time a remark must not: everything behind it would be late. A sample that somebody has put behind the mark of
remarks has lost its value, and its time counts: without it everything behind it would be early.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from ingest.csv_dialect import Dialect
from ingest.notations import read_cell

_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\n|\r|\Z)")
_ENDS = b"\r\n"
_UNDECLARED = re.compile(rb"(?m)^[ \t]*(?:#|%|//|!|\*)[^\r\n]*(?:\r\n|\n|\r|\Z)")
"""Lines that begin as remarks do in programs and instruments, where the mapping does not say how they begin."""
_SHOWN = 40
"""Characters of a line that are told."""


def without_comments(text: bytes, dialect: Dialect, *, rows_are_time: bool) -> tuple[bytes, list[str]]:
    """The text without the lines that begin with the mark of the mapping; notes about those that were samples."""
    if not dialect.comment:
        return text, []
    mark = dialect.comment.encode()
    if not rows_are_time or mark not in text:
        return re.sub(rb"(?m)^[ \t]*" + re.escape(mark) + rb"[^\r\n]*(?:\r\n|\n|\r|\Z)", b"", text), []
    kept: list[bytes] = []
    samples: list[bytes] = []
    before = b""
    for line in (match.group() for match in _LINE.finditer(text)):
        bare = line.strip()
        if not bare.startswith(mark):
            kept.append(line)
            before = bare or before
            continue
        width = len(dialect.fields(before.decode("utf-8", "replace"))) if before else 0
        if _is_sample(bare.lstrip(mark), width, dialect):
            samples.append(bare)
            kept.append(dialect.separator.encode() * (width - 1) + line[len(line.rstrip(_ENDS)) :])
    if not samples:
        return b"".join(kept), []
    are, have = ("1 sample stands", "it has") if len(samples) == 1 else (f"{len(samples)} samples stand", "they have")
    note = f'{are} behind "{dialect.comment}" ({_shown(samples[0])}): {have} no value, but time'
    return b"".join(kept), [note]


def without_remarks(body: bytes, positions: Sequence[int], dialect: Dialect) -> tuple[bytes, list[str]]:
    """Rows that count as time without lines that begin as remarks do and hold no number in a mapped column; a note about them."""
    found: list[bytes] = []

    def leave_out(match: re.Match[bytes]) -> bytes:
        fields = dialect.fields(match.group().decode("utf-8", "replace").strip())
        if any(_says_a_value(fields[place], dialect) for place in positions if place < len(fields)):
            return match.group()
        found.append(match.group().strip())
        return b""

    rest = body if dialect.comment else _UNDECLARED.sub(leave_out, body)
    if not found:
        return body, []
    lines = "1 line is a remark" if len(found) == 1 else f"{len(found)} lines are remarks"
    return rest, [f"{lines} and no samples, such as {_shown(found[0])}: they do not count as time"]


def _is_sample(text: bytes, width: int, dialect: Dialect) -> bool:
    """Whether what stands behind the mark is a row of numbers, as wide as the row before it."""
    fields = [field.strip() for field in dialect.fields(text.decode("utf-8", "replace").strip())]
    filled = [field for field in fields if field]
    return len(fields) == width and bool(filled) and all(_says_a_value(field, dialect) for field in filled)


def _says_a_value(field: str, dialect: Dialect) -> bool:
    """Whether a cell holds a number, or a mark that stands for none."""
    return bool(field.strip()) and read_cell(field, dialect.decimal, dialect.thousands) is not None


def _shown(line: bytes) -> str:
    return f'"{line.decode("utf-8", "replace")[:_SHOWN]}"'
