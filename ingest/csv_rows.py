"""The rows below the header of a text file as columns of text, and what is wrong with some of them.

A cut file. Recorders that are switched off leave a last line without its line end, and a cut number looks like a whole
one. So, unless the mapping says `final_newline = false`:

- a last line with fewer fields than the others is left out, a problem;
- a last line with all its fields is kept, with a note, when its last field shows that it is whole: it ends with the
  same delimiter as the other lines, or stands in quotes, or is written like all others of its column (same number of
  decimals; for whole numbers the same number of digits), or the column is not mapped;
- otherwise the line is left out, a problem.

"""

from __future__ import annotations

import csv
import io
import itertools
import re
from collections import Counter
from collections.abc import Sequence

import pyarrow as pa
import pyarrow.csv as pacsv

from ingest.csv_dialect import Dialect
from schemas.errors import RefusedError

_WRITTEN = re.compile(r"[+-]?(\d*)(?:[.,](\d*))?(?:[eE]([+-]?\d+))?")
_COMPARED = 1000
"""Rows before the last that tell how a column is written."""
_HABIT, _HABIT_SHARE = 3, 0.02
"""Rows of the same wrong length, and their share of all, that are how a machine writes and no damage."""


def checked_end(
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


def cut_reason(column: pa.Array) -> str:
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


def parsed_rows(
    body: bytes, names: Sequence[str], positions: Sequence[int], dialect: Dialect, where: str, *, keep_blank: bool
) -> tuple[pa.Table, list[str], list[str]]:
    """The wanted columns as text, problems and notes.

    `keep_blank`: a blank line is a sample that was lost, where rows count as time; blank lines at the end are none.
    """
    if keep_blank:
        body = body.rstrip(b"\r\n \t")
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
                delimiter=dialect.separator,
                quote_char=dialect.quote or False,
                invalid_row_handler=leave_out,
                ignore_empty_lines=not keep_blank,
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
    if not wrong:
        return table, [], []
    return _parsed_one_by_one(body, len(names), positions, dialect, where, keep_blank=keep_blank)


def _parsed_one_by_one(
    body: bytes, width: int, positions: Sequence[int], dialect: Dialect, where: str, *, keep_blank: bool
) -> tuple[pa.Table, list[str], list[str]]:
    """As `parsed_rows`, for a file whose rows have not all the same number of fields.

    Empty fields behind the last name are those of a trailing delimiter. Rows that are short by habit, always by as many
    fields, lack those of the last columns: their cells are empty. Any other row of a wrong length is damaged: it has
    lost its values, and where rows count as time it still counts.
    """
    text = body.decode("utf-8", "replace")
    rows = _fields_of_lines(text, dialect)
    rows, footer = _without_footer(rows, width)
    lengths = Counter(len(row) for row in rows if row)
    usual = max(_HABIT, _HABIT_SHARE * len(rows))
    habits = {k for k, n in lengths.items() if k < width and n >= usual} if lengths[width] >= _HABIT else set()
    kept: list[list[str]] = []
    damaged: list[tuple[int, list[str]]] = []
    padded, blank = 0, 0
    for number, row in enumerate(rows, start=1):
        whole = row[:width] if len(row) > width and not any(field.strip() for field in row[width:]) else row
        if not whole or whole == [""]:
            blank += 1
            whole = [""] * width if keep_blank else []
        elif len(whole) in habits:
            padded += 1
            whole = whole + [""] * (width - len(whole))
        elif len(whole) != width:
            damaged.append((number, whole))
            whole = [""] * width if keep_blank else []
        if whole:
            kept.append(whole)
    _check_lengths(damaged, len(kept), width, dialect, where)
    nothing = {"", *dialect.missing}
    table = pa.table(
        {
            str(i): pa.array([None if row[i].strip() in nothing else row[i] for row in kept], pa.string())
            for i in positions
        }
    )
    problems = []
    notes = [f'the file ends with the words "{" ".join(footer)[:60]}"'] if footer else []
    if damaged:
        number, row = damaged[0]
        lost = "their values are lost" if keep_blank else "left out"
        problems.append(
            f"{len(damaged)} rows do not have {width} fields (row {number} of the data has {len(row)}): {lost}"
        )
    if blank and keep_blank:
        problems.append(f"{blank} rows are blank: samples that were lost")
    if padded:
        short = ", ".join(map(str, sorted(habits)))
        notes.append(f"{padded} rows have {short} of {width} fields: the cells of the last columns are empty there")
    return table, problems, notes


def _without_footer(rows: list[list[str]], width: int) -> tuple[list[list[str]], list[str]]:
    """The rows without what is said below them, and the fields of its first line: it has lost no value.

    That is a last line of words alone (`Ende der Daten`), or the lines after a blank one that begin with a word and are shorter than the
    rows (`Fmax;2,479;N`).
    """
    blank = [not any(field.strip() for field in row) for row in rows]
    filled = [i for i, is_blank in enumerate(blank) if not is_blank]
    if not filled:
        return rows, []
    first = filled[-1]
    while first and not blank[first - 1]:
        first -= 1
    block = rows[first : filled[-1] + 1]
    if first and all(_says(row, width) for row in block):
        return rows[:first], [field.strip() for field in block[0] if field.strip()]
    words = [field.strip() for field in rows[filled[-1]] if field.strip()]
    if _says(rows[filled[-1]], width) and not any(c.isdigit() for field in words for c in field):
        return rows[: filled[-1]], words
    return rows, []


def _says(row: Sequence[str], width: int) -> bool:
    """Whether a line says something below a table: shorter than its rows, a word first."""
    first = row[0].strip() if row else ""
    return len(row) < width and first[:1].isalpha() and not any(c.isdigit() for c in first)


def _fields_of_lines(text: str, dialect: Dialect) -> list[list[str]]:
    """The fields of each row. A cell in quotation marks may hold line ends; a lone mark spoils its own line only."""
    if not dialect.quote:
        return [line.split(dialect.separator) for line in text.splitlines()]
    lines = io.StringIO(text, newline="")
    try:
        return list(csv.reader(lines, delimiter=dialect.separator, quotechar=dialect.quote, strict=True))
    except csv.Error:  # a mark that nothing closes, or that something but a delimiter follows
        return [dialect.fields(line) for line in text.splitlines()]


def _check_lengths(
    damaged: Sequence[tuple[int, Sequence[str]]], kept: int, width: int, dialect: Dialect, where: str
) -> None:
    """Refuses rows of a wrong length that are no damage: most rows, or those with a delimiter inside large numbers."""
    if len(damaged) > kept:
        raise RefusedError(
            f"{len(damaged)} of {len(damaged) + kept} rows do not have {width} fields",
            where=where,
            expected=f'rows of fields with the delimiter "{dialect.delimiter}"',
            remedy="Check delimiter and skip_rows in the mapping TOML",
        )
    grouped = [(number, row) for number, row in damaged if len(row) > width and _has_thousands(row)]
    if len(grouped) >= _HABIT and 2 * len(grouped) > len(damaged):
        number, row = grouped[0]
        raise RefusedError(
            f"{len(grouped)} rows have more than {width} fields, such as row {number} of the data:"
            f' "{dialect.separator.join(row)[:60]}"',
            where=where,
            expected=f'numbers without "{dialect.separator}" inside, or in quotation marks',
            remedy="Export without thousands separators, or with another delimiter",
        )


def _has_thousands(row: Sequence[str]) -> bool:
    """Whether two neighbouring fields look like one number with a thousands separator between them."""
    pairs = itertools.pairwise(row)
    return any(re.fullmatch(r"\s*[+-]?\d{1,3}", a) and re.fullmatch(r"\d{3}(?:\.\d*)?\s*", b) for a, b in pairs)
