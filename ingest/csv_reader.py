"""Delimited text: pyarrow's parser under an explicit dialect from the mapping TOML. Nothing is guessed.

The file is read once. Encoding, preamble, header and unit row are dealt with here and in `ingest.csv_dialect`, the rows
by pyarrow as text (`ingest.csv_rows`), and only mapped columns become numbers (`ingest.notations`). What belongs to no
format (units, time, metadata) is in `ingest.assemble`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ingest.columns import Numbers, OwnTime, named_column, plain_name
from ingest.compressed import find_suffix, read_plain_content
from ingest.csv_dialect import UNREADABLE, WHITESPACE, Dialect, as_utf8, wrong_encoding
from ingest.csv_remarks import without_comments, without_remarks
from ingest.csv_rows import checked_end, cut_reason, parsed_rows
from ingest.mapping import ColumnName, FileMapping, column_label
from ingest.notations import read_cell, read_column
from ingest.repeats import REPEATED, find_repeated_heads, is_head
from schemas.arrays import Float
from schemas.errors import RefusedError

_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$|^[+-]?(?i:nan|inf|infinity)$"
_LONGEST = 1 << 20
"""Bytes of the longest line: pyarrow reads blocks of that size. A hundred thousand columns take less."""
_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\n|\r|\Z)")


@dataclass(frozen=True)
class CsvFile:
    """A parsed text file; a `ColumnFile`. `table` holds the wanted columns as text, named by their position."""

    where: str
    dialect: Dialect
    header: tuple[str, ...]
    units: tuple[str, ...]
    table: pa.Table
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        return self.header

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        cells = self._text(column, index)
        empty = np.asarray(pc.is_null(cells))
        foreign = None
        if self.dialect.decimal == ",":
            foreign = pc.fill_null(pc.match_substring(cells, "."), False)
            plain = pc.replace_substring(cells, ",", ".")
        else:
            plain = cells
        try:
            if foreign is None or not pc.any(foreign).as_py():
                return Numbers(_doubles(plain), empty)
        except pa.ArrowInvalid:
            pass
        is_number = pc.fill_null(pc.match_substring_regex(plain, _NUMBER), False)
        if foreign is not None:
            is_number = pc.and_not(is_number, foreign)
        others = pc.and_not(pc.is_valid(cells), is_number)
        return read_column(
            _doubles(pc.if_else(is_number, plain, pa.scalar(None, pa.string()))),
            empty,
            np.flatnonzero(np.asarray(others)),
            pc.filter(cells, others).to_pylist(),
            column,
            self.where,
            decimal=self.dialect.decimal,
            thousands=self.dialect.thousands,
        )

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        cells = [text or "" for text in self._text(column, index).to_pylist()]
        if any(UNREADABLE in cell for cell in cells):
            raise wrong_encoding(f"the text of column {column_label(column)} is", self.dialect, self.where)
        return cells

    def unit(self, column: ColumnName) -> str | None:
        position = named_column(self.header, column, self.where)
        return self.units[position] if position < len(self.units) else None

    def own_time(self, column: ColumnName) -> OwnTime | None:
        return None

    def own_frequency(self, column: ColumnName) -> Float | None:
        return None

    def _text(self, column: ColumnName, index: int | None) -> pa.Array:
        if index is not None:
            raise RefusedError(f"index is {index}", where=self.where, expected="no index: text files have no matrices")
        cells = self.table[str(named_column(self.header, column, self.where))].combine_chunks()
        cells = pc.utf8_trim_whitespace(cells)
        return pc.if_else(pc.equal(cells, ""), pa.scalar(None, pa.string()), cells)


def read_csv(path: Path, mapping: FileMapping) -> CsvFile:
    """The columns of a text file that a mapping names.

    Raises `RefusedError` when the dialect cannot be that of the file or a mapped column is missing.
    """
    dialect = Dialect.parse(mapping.options, suffix=find_suffix(path).lower(), where=mapping.source)
    wanted = mapping.columns_of_file()
    keep_blank = mapping.counts_rows_as_time
    plain = read_plain_content(path)
    file = parse_csv(plain.content, dialect, where=path.name, wanted=wanted, keep_blank=keep_blank)
    return replace(file, problems=plain.problems + file.problems)


def parse_csv(
    content: bytes,
    dialect: Dialect,
    *,
    where: str,
    wanted: Sequence[ColumnName] | None = None,
    keep_blank: bool = False,
) -> CsvFile:
    """The columns of a text file's content, all where `wanted` is None. `keep_blank`: a blank line is a sample."""
    text, unreadable = as_utf8(content, dialect, where)
    body, commented = _without_extras(text, dialect, rows_are_time=keep_blank)
    header: list[str] = []
    units: list[str] = []
    if dialect.header:
        header, body = _row(body, dialect, where)
    if dialect.unit_row:
        units, body = _row(body, dialect, where)
    body, again = _without_repeated_heads(body, header, dialect)
    first = next((line for line in _lines(body) if line.strip()), None)
    if first is None:
        raise RefusedError("there are no rows of data", where=where, expected="rows after the header")
    _refuse_length(first, where)
    fields = dialect.fields(first.decode("utf-8", "replace"))
    names = _fitted(_without_constants(header, units, len(fields)), fields, dialect, where)
    _check_names(names, wanted, dialect, where)
    positions = range(len(names)) if wanted is None else sorted({named_column(names, w, where) for w in wanted})
    body, remarks = without_remarks(body, positions, dialect) if keep_blank else (body, [])
    body, suspect, problems, notes = checked_end(body, len(names), positions, dialect)
    notes += [*unreadable, *again, *commented, *remarks]
    table, wrong, odd = parsed_rows(body, names, positions, dialect, where, keep_blank=keep_blank)
    if suspect and table.num_rows:
        reason = cut_reason(table[str(len(names) - 1)].combine_chunks())
        if reason:
            table = table.slice(0, table.num_rows - 1)
            problems.append(f"the last line has no line end and {reason}: it may be cut and is left out")
        else:
            notes.append("the last line has no line end; its last number is written like the others and was kept")
    problems += wrong
    notes += odd
    if not table.num_rows:
        raise RefusedError("; ".join(["there are no whole rows of data", *problems]), where=where, expected="rows")
    return CsvFile(where, dialect, tuple(names), tuple(units), table, tuple(problems), tuple(notes))


def _check_names(names: Sequence[str], wanted: Sequence[ColumnName] | None, dialect: Dialect, where: str) -> None:
    """A mapped name that is missing because the names are not of the encoding is a matter of the encoding."""
    if wanted is not None and any(UNREADABLE in name for name in names):
        plain = {plain_name(name) for name in names}
        if any(isinstance(w, str) and plain_name(w) not in plain for w in wanted):
            raise wrong_encoding("the names of the columns are", dialect, where)


def _without_extras(text: bytes, dialect: Dialect, *, rows_are_time: bool) -> tuple[bytes, list[str]]:
    """The text from the header on: preamble and comment lines gone, runs of blanks one tab where they delimit; and notes."""
    start = 0
    for _ in range(dialect.skip_rows):
        start = _LINE.match(text, start).end()  # type: ignore[union-attr]  # the pattern matches everywhere
    text = text[start:]
    if dialect.delimiter == WHITESPACE:
        text = re.sub(
            rb"[ \t]+", b"\t", text
        )  # first: looking for the end of a line behind each blank takes its square
        text = re.sub(rb"(?m)^\t|\t(?=\r?$)", b"", text)
    return without_comments(text, dialect, rows_are_time=rows_are_time)


def _row(body: bytes, dialect: Dialect, where: str) -> tuple[list[str], bytes]:
    """The fields of the next line that is not blank, and what follows it. A quoted field may hold line ends."""
    start = next((match.start() for match in _LINE.finditer(body) if match.group().strip()), len(body))
    quotes = _Quotes(dialect)
    end = start
    while end < min(len(body), start + _LONGEST) and (end == start or quotes.is_open):
        following = _LINE.match(body, end).end()  # type: ignore[union-attr]
        _refuse_length(body[end:following], where)
        quotes.read(body[end:following].decode("utf-8", "replace"))
        end = following
    if quotes.is_open:
        raise RefusedError(
            "a quotation mark in the header is never closed",
            where=where,
            expected="names with none, or in pairs of them",
            remedy='Where it is part of a name, say quote = "" in [csv] of the mapping TOML',
        )
    line = body[start:end].decode("utf-8", "replace").rstrip("\r\n")
    fields = dialect.fields(re.sub(r"[\r\n]+", " ", line))
    return [" ".join(field.split()) for field in fields], body[end:]


def _refuse_length(line: bytes, where: str) -> None:
    """Raises `RefusedError` for a line that is longer than any row, before its fields are made."""
    if len(line) > _LONGEST:
        raise RefusedError(
            f"a line is {len(line)} bytes long",
            where=where,
            expected=f"lines of at most {_LONGEST} bytes",
            remedy="Check delimiter, skip_rows and quote in the mapping TOML; export fewer columns at once",
        )


def _without_repeated_heads(body: bytes, header: Sequence[str], dialect: Dialect) -> tuple[bytes, list[str]]:
    """The rows without heads that are said again between them, and a note where there were some."""
    telling = [name.encode() for name in sorted(header, key=len)[-2:]]
    if len(telling) < 2 or not all(name and name in body for name in telling):
        return body, []
    lines = list(_lines(body))
    likely = (line for line in lines if all(name in line for name in telling))  # fields of all lines take long
    if not any(is_head(dialect.fields(line.decode("utf-8", "replace").rstrip("\r\n")), header) for line in likely):
        return body, []
    fields = [dialect.fields(line.decode("utf-8", "replace").rstrip("\r\n")) for line in lines]
    repeated = find_repeated_heads(fields, header, dialect.decimal)
    if not repeated:
        return body, []
    kept = b"".join(line for i, line in enumerate(lines) if i not in repeated)
    return kept, [REPEATED.format(rows=len(repeated))]


class _Quotes:
    """Whether a field that begins with a quotation mark does not end where reading has come to, asked line by line.

    A mark inside a field (`G"`) opens nothing.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self.is_open, self._at_start = False, True

    def read(self, text: str) -> None:
        """Goes on over more text."""
        quote, separator = self._dialect.quote, self._dialect.separator
        if not quote or (self.is_open and quote not in text):
            return
        for character in text:
            if character == quote and (self.is_open or self._at_start):
                self.is_open, self._at_start = not self.is_open, self.is_open
            elif not self.is_open:
                self._at_start = character == separator or (self._at_start and character == " ")


def _lines(body: bytes) -> Any:
    return (match.group() for match in _LINE.finditer(body))


def _without_constants(header: list[str], units: list[str], count: int) -> list[str]:
    """The names of columns: scopes write constants (`Start`, `Increment`) behind them, with a number in the row of units."""
    beyond = units[count:]
    if len(header) > count and any(beyond) and all(read_cell(unit) is not None for unit in beyond if unit):
        return header[:count]
    return header


def _fitted(header: list[str], first: list[str], dialect: Dialect, where: str) -> list[str]:
    """The header with as many names as the rows have fields; a trailing delimiter makes a column without a name."""
    count = len(first)
    if not dialect.header:
        return [""] * count
    if len(header) > count and not any(header[count:]):
        return header[:count]
    if len(header) < count and not any(field.strip() for field in first[len(header) :]):
        return header + [""] * (count - len(header))
    if len(header) == count:
        return header
    raise RefusedError(
        f"the header has {len(header)} names, the first row {count} fields",
        where=where,
        expected="as many names as fields",
        remedy="Check delimiter, skip_rows, header and unit_row in the mapping TOML",
    )


def _doubles(cells: pa.Array) -> Any:
    values = pc.cast(cells, pa.float64())
    return np.array(values.to_numpy(zero_copy_only=False), dtype=np.float64)
