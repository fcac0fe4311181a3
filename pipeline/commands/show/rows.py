"""Rows for a terminal, a spreadsheet, a program. What people wrote into their metadata cannot control the terminal."""

from __future__ import annotations

import csv
import io
import json
import math
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from datetime import date, datetime, timedelta
from decimal import Decimal
from typing import TYPE_CHECKING, Any

from schemas.errors import UsageError
from schemas.numbers import NBSP, THIN
from schemas.visible import make_safe, shown

if TYPE_CHECKING:
    import pyarrow as pa

_WIDEST = 80
"""Longest text of a cell; a cell that is alone in its row is shown in full."""
_NARROWEST = 12
"""Letters to which a text may be shortened so that a row fits into a line."""
_BETWEEN = "  "


def as_table(rows: pa.Table, *, width: int | None = None, expanded: bool = False) -> str:
    """Columns aligned for reading; NULL is left empty.

    Parameters
    ----------
    rows : what a query gave
    width : of the terminal: texts are shortened until a row fits into a line
    expanded : each value in a line of its own, in full, as also where no shortening makes a row fit
    """
    names = rows.column_names
    if _is_plan(names):
        return "\n".join(str(text) for text in rows.column("explain_value").to_pylist())
    whole = [[_write_cell(value) for value in row.values()] for row in _list_rows(rows)]
    right = [_is_number(field) for field in rows.schema]
    limit = _WIDEST if len(names) > 1 else None
    cells = [[_shorten(cell, limit) for cell in row] for row in whole]
    widths = [max([_measure(name), *(_measure(row[i]) for row in cells)]) for i, name in enumerate(names)]
    fitting = widths if width is None or len(names) == 1 else _fit_widths(widths, names, right, width)
    if expanded or fitting is None:
        return _write_expanded(names, whole, width)
    cells = [[_shorten(cell, room) for cell, room in zip(row, fitting, strict=True)] for row in cells]
    cells = cells if len(names) > 1 else whole
    lines = [_join_cells(names, fitting, right), _BETWEEN.join("─" * room for room in fitting)]
    lines += [_join_cells(row, fitting, right) for row in cells]
    return "\n".join([*lines, _count_rows(len(cells))])


def _fit_widths(widths: Sequence[int], names: Sequence[str], right: Sequence[bool], width: int) -> list[int] | None:
    """Widths with which a row fits into a line, None for none: texts give way, numbers and names do not."""
    fitting = list(widths)
    least = [w if r else min(w, max(_NARROWEST, _measure(n))) for w, n, r in zip(widths, names, right, strict=True)]
    room = width - len(_BETWEEN) * (len(widths) - 1)
    while sum(fitting) > room:
        free = [i for i, (now, floor) in enumerate(zip(fitting, least, strict=True)) if now > floor]
        if not free:
            return None
        fitting[max(free, key=lambda i: fitting[i])] -= 1
    return fitting


def _write_expanded(names: Sequence[str], cells: Sequence[Sequence[str]], width: int | None) -> str:
    """A line for each value, a block for each row."""
    longest = max((_measure(name) for name in names), default=0)
    lines = []
    for number, row in enumerate(cells, start=1):
        title = f"── row {number} "
        lines.append(title + "─" * max(2, min(width or _WIDEST, _WIDEST) - len(title)))
        lines += [
            f"{_pad(name, longest, False)}{_BETWEEN}{cell}".rstrip() for name, cell in zip(names, row, strict=True)
        ]
    return "\n".join([*lines, _count_rows(len(cells))])


def _count_rows(count: int) -> str:
    return f"({count} row{'' if count == 1 else 's'})"


def _measure(text: str) -> int:
    """Columns of a terminal that a text takes: Chinese, Japanese and Korean letters take two, combining marks none."""
    return len(text) if text.isascii() else sum(_measure_letter(letter) for letter in text)


def _measure_letter(letter: str) -> int:
    return 0 if unicodedata.combining(letter) else 2 if unicodedata.east_asian_width(letter) in "WF" else 1


def _pad(text: str, width: int, right: bool) -> str:
    blanks = " " * max(0, width - _measure(text))
    return blanks + text if right else text + blanks


def as_csv(rows: pa.Table) -> str:
    """RFC 4180 with a header; NULL is empty, times are ISO 8601, lists and structures are JSON."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(rows.column_names)
    for row in _list_rows(rows):
        writer.writerow(["" if value is None else _write_plainly(value) for value in row.values()])
    return text.getvalue().rstrip("\n")


def as_json(rows: pa.Table) -> str:
    """A list of objects; NULL, NaN and infinity are null, times are ISO 8601."""
    return json.dumps([_make_plain(row) for row in _list_rows(rows)], ensure_ascii=False, indent=1)


def as_finite_json(value: Any) -> str:
    """JSON of nested objects and lists; NaN and infinity are null."""

    def finite(one: Any) -> Any:
        if isinstance(one, dict):
            return {key: finite(member) for key, member in one.items()}
        if isinstance(one, list | tuple):
            return [finite(member) for member in one]
        return None if isinstance(one, float) and not math.isfinite(one) else one

    return json.dumps(finite(value), ensure_ascii=False, indent=1)


def in_plain(text: str) -> str:
    """Text for a terminal: plain spaces, and nothing that controls it."""
    return make_safe(text.replace(NBSP, " ").replace(THIN, " "))


def as_parquet(rows: pa.Table) -> bytes:
    """A Parquet file. Raises `UsageError` for columns of types that Parquet does not have."""
    import pyarrow as pa

    try:
        return _write_parquet(rows)
    except pa.ArrowNotImplementedError:
        strange = [field for field in rows.schema if not _fits_parquet(field)]
        raise UsageError(
            f"Parquet has no type for {', '.join(f'{shown(field.name)} ({field.type})' for field in strange)}",
            remedy="Ask for text: CAST(column AS VARCHAR); or take another --format",
        ) from None


def _write_parquet(rows: pa.Table) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(rows, sink, compression="zstd")
    content: bytes = sink.getvalue().to_pybytes()
    return content


def _fits_parquet(field: pa.Field) -> bool:
    import pyarrow as pa

    try:
        _write_parquet(pa.schema([field]).empty_table())
    except pa.ArrowNotImplementedError:
        return False
    return True


FORMATS: Mapping[str, Callable[[pa.Table], str | bytes]] = {
    "table": as_table,
    "csv": as_csv,
    "json": as_json,
    "parquet": as_parquet,
}


def _list_rows(rows: pa.Table) -> list[dict[str, Any]]:
    """The rows in Python's values; dates and times that Python does not have are texts."""
    try:
        found: list[dict[str, Any]] = rows.to_pylist()
    except (OverflowError, ValueError):
        columns = [[_read_value(value) for value in column] for column in rows.columns]
        return [dict(zip(rows.column_names, values, strict=True)) for values in zip(*columns, strict=True)]
    return found


def _read_value(value: pa.Scalar) -> Any:
    import pyarrow as pa

    try:
        return value.as_py()
    except (OverflowError, ValueError):
        if pa.types.is_struct(value.type):
            return {name: _read_value(value[name]) for name in value}
        if pa.types.is_nested(value.type):
            return [_read_value(member) for member in value.values]
        most = (1 << (value.type.bit_width - 1)) - 1
        number = value.cast(pa.int32() if value.type.bit_width == 32 else pa.int64()).as_py()
        if abs(number) == most:  # as DuckDB stores it
            return "infinity" if number > 0 else "-infinity"
        return value.cast(pa.string()).as_py()


def _join_cells(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    parts = zip(cells, widths, right, strict=True)
    return _BETWEEN.join(_pad(c, w, r) for c, w, r in parts).rstrip()


def _write_cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}"
    return shown(_write_plainly(value))


def _shorten(text: str, limit: int | None) -> str:
    if limit is None or _measure(text) <= limit:
        return text
    while text and _measure(text) > limit - 1:
        text = text[: min(len(text) - 1, limit - 1)]
    return text + "…"


def _write_plainly(value: Any) -> str:
    plain = _make_plain(value)
    if isinstance(plain, str):
        return plain
    if isinstance(value, float):
        return repr(value)
    return json.dumps(plain, ensure_ascii=False)


def _make_plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, datetime | date):
        return value.isoformat()
    if isinstance(value, timedelta):
        return str(value)
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, Mapping):
        return {str(key): _make_plain(member) for key, member in value.items()}
    if isinstance(value, list | tuple):
        return [_make_plain(member) for member in value]
    return str(value)


def _is_number(field: pa.Field) -> bool:
    import pyarrow as pa

    kind = field.type
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind))


def _is_plan(names: Sequence[str]) -> bool:
    return list(names) == ["explain_key", "explain_value"]
