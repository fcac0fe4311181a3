"""Delimited text: pyarrow's parser under an explicit dialect from the mapping TOML. Nothing is guessed.

The file is read once. Encoding, preamble, header and unit row are dealt with here, the rows by pyarrow as text, and
only mapped columns become numbers. What belongs to no format (units, time, metadata) is in `ingest.assemble`.

A cut file. Recorders that are switched off leave a last line without its line end, and a cut number looks like a whole
one. So, unless the mapping says `final_newline = false`:

- a last line with fewer fields than the others is left out, a problem;
- a last line with all its fields is kept, with a note, when its last field shows that it is whole: it ends with the
  same delimiter as the other lines, or stands in quotes, or is written like all others of its column (same number of
  decimals; for whole numbers the same number of digits), or the column is not mapped;
- otherwise the line is left out, a problem.
"""

from __future__ import annotations

import codecs
import csv
import functools
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv

from ingest.columns import Numbers, OwnTime, named_column, refuse_other_notation
from ingest.mapping import ColumnName, FileMapping, column_label
from schemas.errors import RefusedError

WHITESPACE = "whitespace"
_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$|^[+-]?(?i:nan|inf|infinity)$"
_WRITTEN = re.compile(r"[+-]?(\d*)(?:[.,](\d*))?(?:[eE]([+-]?\d+))?")
_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\n|\r|\Z)")
UNREADABLE = "\ufffd"
"""Stands for bytes that are not of the encoding."""
_WRONG_BYTES = 0.01
"""Largest share of unreadable places that may be damage; beyond it the encoding is another one."""
_COMPARED = 1000
"""Rows before the last that tell how a column is written."""


@dataclass(frozen=True)
class Dialect:
    """How a text file is written. `delimiter` one character or "whitespace" (runs of blanks and tabs)."""

    delimiter: str = ","
    decimal: str = "."
    encoding: str = "utf-8"
    skip_rows: int = 0
    header: bool = True
    unit_row: bool = False
    quote: str = '"'
    comment: str = ""
    missing: tuple[str, ...] = ()
    final_newline: bool = True

    @classmethod
    def parse(cls, options: Mapping[str, Any], *, suffix: str = "", where: str = "") -> Dialect:
        """The dialect from the `[csv]` table of a mapping. Raises `RefusedError` for values that cannot be."""
        keys: dict[str, Any] = {"delimiter": "\t"} if suffix == ".tsv" else {}
        keys |= {k: tuple(map(str, v)) if k == "missing" else v for k, v in options.items()}
        dialect = cls(**keys)
        one = "one character" + (f', or "{WHITESPACE}"' if dialect.delimiter != WHITESPACE else "")
        checks = (
            ("delimiter", dialect.delimiter == WHITESPACE or _is_ascii_character(dialect.delimiter), one),
            ("decimal", dialect.decimal in (".", ","), '"." or ","'),
            ("decimal", dialect.decimal != dialect.delimiter, "another character than the delimiter"),
            ("encoding", _is_encoding(dialect.encoding), "an encoding such as utf-8, cp1252, gbk or utf-16"),
            ("skip_rows", dialect.skip_rows >= 0, "a number from 0"),
            ("quote", dialect.quote == "" or _is_ascii_character(dialect.quote), "one character, or empty for none"),
        )
        for key, right, expected in checks:
            if not right:
                value = str(getattr(dialect, key))[:40]
                raise RefusedError(
                    f'csv.{key} is "{value}"', where=where, expected=expected, remedy="Correct the mapping TOML"
                )
        return dialect

    @property
    def separator(self) -> str:
        """The delimiter after runs of blanks have become one tab."""
        return "\t" if self.delimiter == WHITESPACE else self.delimiter

    def fields(self, line: str) -> list[str]:
        """The fields of one line."""
        if not self.quote:
            return line.split(self.separator)
        rows = csv.reader([line], delimiter=self.separator, quotechar=self.quote)
        return next(rows, [])


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
        wrong = pc.filter(cells, pc.and_not(pc.is_valid(cells), is_number))
        for text in pc.unique(wrong).to_pylist()[:_COMPARED]:
            refuse_other_notation(text, column, self.dialect.decimal, self.where)
        values = _doubles(pc.if_else(is_number, plain, pa.scalar(None, pa.string())))
        return Numbers(values, empty, len(wrong), str(wrong[0])[:40])

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        cells = [text or "" for text in self._text(column, index).to_pylist()]
        if any(UNREADABLE in cell for cell in cells):
            raise _wrong_encoding(f"the text of column {column_label(column)} is", self.dialect, self.where)
        return cells

    def unit(self, column: ColumnName) -> str | None:
        position = named_column(self.header, column, self.where)
        return self.units[position] if position < len(self.units) else None

    def own_time(self, column: ColumnName) -> OwnTime | None:
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
    dialect = Dialect.parse(mapping.options, suffix=path.suffix.lower(), where=mapping.source)
    columns = mapping.columns.values()
    wanted = [
        *([mapping.time.column] if mapping.time is not None else []),
        *(name for c in columns for name in (c.column, c.time)),
        *(s.column for s in mapping.select),
    ]
    return parse_csv(path.read_bytes(), dialect, where=path.name, wanted=[w for w in wanted if w is not None])


def parse_csv(content: bytes, dialect: Dialect, *, where: str, wanted: Sequence[ColumnName] | None = None) -> CsvFile:
    """The columns of a text file's content; all of them where `wanted` is None."""
    text, unreadable = _as_utf8(content, dialect, where)
    body = _without_extras(text, dialect)
    header: list[str] = []
    units: list[str] = []
    if dialect.header:
        header, body = _row(body, dialect)
    if dialect.unit_row:
        units, body = _row(body, dialect)
    first = next((line for line in _lines(body) if line.strip()), None)
    if first is None:
        raise RefusedError("there are no rows of data", where=where, expected="rows after the header")
    names = _fitted(header, dialect.fields(first.decode("utf-8", "replace")), dialect, where)
    positions = range(len(names)) if wanted is None else sorted({named_column(names, w, where) for w in wanted})
    body, suspect, problems, notes = _checked_end(body, len(names), positions, dialect)
    notes += unreadable
    table, wrong = _parsed(body, names, positions, dialect, where)
    if suspect and table.num_rows:
        reason = _cut_reason(table[str(len(names) - 1)].combine_chunks())
        if reason:
            table = table.slice(0, table.num_rows - 1)
            problems.append(f"the last line has no line end and {reason}: it may be cut and is left out")
        else:
            notes.append("the last line has no line end; its last number is written like the others and was kept")
    problems += wrong
    if not table.num_rows:
        raise RefusedError("; ".join(["there are no whole rows of data", *problems]), where=where, expected="rows")
    return CsvFile(where, dialect, tuple(names), tuple(units), table, tuple(problems), tuple(notes))


def _as_utf8(content: bytes, dialect: Dialect, where: str) -> tuple[bytes, list[str]]:
    """The content as UTF-8 without byte-order mark, and a note where some of it is unreadable.

    A few unreadable bytes are damage that the cells around them show; many mean that the encoding is another one.
    """
    if not content.strip(b"\x00 \t\r\n"):
        raise RefusedError("the file is empty", where=where, expected="rows of data")
    codec = codecs.lookup(dialect.encoding).name
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if wide and not codec.startswith(("utf-16", "utf-32")):
        raise RefusedError(
            "the file begins with the byte-order mark of UTF-16",
            where=where,
            expected=f"text in {dialect.encoding}, as the mapping says",
            remedy='Set encoding = "utf-16" in the mapping TOML',
        )
    try:
        text = content.decode(codec)
    except UnicodeDecodeError:
        text = content.decode(codec, "replace")
        wrong = text.count(UNREADABLE)
        if wrong > max(1, _WRONG_BYTES * len(text)):
            raise _wrong_encoding(f"{wrong} places in the text are", dialect, where) from None
        note = f'{wrong} places in the text are not {dialect.encoding}: read as "{UNREADABLE}"'
        return text.removeprefix("\ufeff").encode(), [note]
    if codec in ("utf-8", "utf-8-sig", "ascii"):
        return content.removeprefix(codecs.BOM_UTF8), []
    return text.removeprefix("\ufeff").encode("utf-8", "replace"), []


def _wrong_encoding(place: str, dialect: Dialect, where: str) -> RefusedError:
    return RefusedError(
        f"{place} not {dialect.encoding}",
        where=where,
        expected=f"text in {dialect.encoding}, as the mapping says",
        remedy="Set encoding in the mapping TOML: cp1252 for western Windows, gbk for Chinese, utf-16",
    )


def _without_extras(text: bytes, dialect: Dialect) -> bytes:
    """The text from the header on: preamble lines and comment lines gone, runs of blanks one tab where they delimit."""
    start = 0
    for _ in range(dialect.skip_rows):
        start = _LINE.match(text, start).end()  # type: ignore[union-attr]  # the pattern matches everywhere
    text = text[start:]
    if dialect.comment:
        mark = re.escape(dialect.comment.encode())
        text = re.sub(rb"(?m)^[ \t]*" + mark + rb"[^\r\n]*(?:\r\n|\n|\r|\Z)", b"", text)
    if dialect.delimiter == WHITESPACE:
        text = re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", text)
        text = re.sub(rb"[ \t]+", b"\t", text)
    return text


def _row(body: bytes, dialect: Dialect) -> tuple[list[str], bytes]:
    """The fields of the next line that is not blank, and what follows it. A quoted field may hold line ends."""
    while body and not (match := _LINE.match(body)).group().strip():  # type: ignore[union-attr]
        body = body[match.end() :]  # type: ignore[union-attr]
    end = _LINE.match(body).end()  # type: ignore[union-attr]
    if dialect.quote:
        quote = dialect.quote.encode()
        while body[:end].count(quote) % 2 and end < len(body):
            end = _LINE.match(body, end).end()  # type: ignore[union-attr]
    line = body[:end].decode("utf-8", "replace").rstrip("\r\n")
    fields = dialect.fields(re.sub(r"[\r\n]+", " ", line))
    return [" ".join(field.split()) for field in fields], body[end:]


def _lines(body: bytes) -> Any:
    return (match.group() for match in _LINE.finditer(body))


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


def _checked_end(
    body: bytes, fields: int, positions: Sequence[int], dialect: Dialect
) -> tuple[bytes, bool, list[str], list[str]]:
    """The body without a last line that is surely cut; whether the last line must be looked at; problems, notes."""
    if not dialect.final_newline or body.endswith((b"\n", b"\r")):
        return body, False, [], []
    start = max(body.rfind(b"\n"), body.rfind(b"\r")) + 1
    last = body[start:].decode("utf-8", "replace")
    found = dialect.fields(last)
    if len(found) < fields or "\x00" in last:
        text = last.replace("\x00", "")[-40:]
        cut = f'the file ends in the middle of a line ("{text}", {len(found)} of {fields} fields): the line is left out'
        return body[:start], False, [cut], []
    ends_quoted = bool(dialect.quote) and last.rstrip().endswith(dialect.quote)
    if fields - 1 not in positions or ends_quoted:
        return body, False, [], ["the last line has no line end; its mapped fields are whole"]
    return body, True, [], []


def _cut_reason(column: pa.Array) -> str:
    """Why the last number of a column may be cut; empty when it is written like those before it."""
    texts = [(t or "").strip() for t in column[-_COMPARED - 1 :].to_pylist()]
    last, others = texts[-1], [t for t in texts[:-1] if t]
    if not others:
        return "" if not last and len(texts) > 1 else f'its last field is "{last[:40]}"'
    shapes = {_shape(t) for t in others}
    if shapes == {_shape(last)}:
        return ""
    return f'its last number "{last[:40]}" is not written like all those before it'


def _shape(text: str) -> tuple[int, int] | None:
    """How a number is written: (decimals, digits of the exponent); whole numbers count their digits instead."""
    match = _WRITTEN.fullmatch(text)
    if match is None:
        return None
    whole, decimals, exponent = match.groups()
    return (-len(whole) if decimals is None and exponent is None else len(decimals or "")), len(exponent or "")


def _parsed(
    body: bytes, names: Sequence[str], positions: Sequence[int], dialect: Dialect, where: str
) -> tuple[pa.Table, list[str]]:
    """The wanted columns as text, and what is wrong with rows that had to be left out."""
    wrong: list[pacsv.InvalidRow] = []

    def leave_out(row: pacsv.InvalidRow) -> str:
        wrong.append(row)
        return "skip"

    columns = [str(i) for i in positions]
    try:
        table = pacsv.read_csv(
            io.BytesIO(body),
            read_options=pacsv.ReadOptions(use_threads=False, column_names=[str(i) for i in range(len(names))]),
            parse_options=pacsv.ParseOptions(
                delimiter=dialect.separator, quote_char=dialect.quote or False, invalid_row_handler=leave_out
            ),
            convert_options=pacsv.ConvertOptions(
                include_columns=columns,
                column_types=dict.fromkeys(columns, pa.string()),
                strings_can_be_null=True,
                null_values=["", *dialect.missing],
            ),
        )
    except pa.ArrowInvalid as error:
        raise RefusedError(
            f"the rows cannot be parsed: {str(error)[:200]}", where=where, expected="text rows"
        ) from None
    if len(wrong) > table.num_rows:
        raise RefusedError(
            f"{len(wrong)} of {len(wrong) + table.num_rows} rows do not have {len(names)} fields",
            where=where,
            expected=f'rows of fields with the delimiter "{dialect.delimiter}"',
            remedy="Check delimiter and skip_rows in the mapping TOML",
        )
    if not wrong:
        return table, []
    row = wrong[0]
    first = f"row {row.number} of the data has {row.actual_columns}" if row.number else f"one has {row.actual_columns}"
    return table, [f"{len(wrong)} rows do not have {len(names)} fields ({first}): left out"]


def _doubles(cells: pa.Array) -> Any:
    values = pc.cast(cells, pa.float64())
    return np.array(values.to_numpy(zero_copy_only=False), dtype=np.float64)


def _is_ascii_character(text: str) -> bool:
    return len(text) == 1 and text.isascii() and text not in "\r\n"


@functools.cache
def _is_encoding(name: str) -> bool:
    try:
        return bool(codecs.lookup(name)._is_text_encoding)
    except LookupError:
        return False
