"""Rows for a terminal, a spreadsheet, a program. What people wrote into their metadata cannot control the terminal."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from datetime import date, datetime, timedelta
from decimal import Decimal
from typing import TYPE_CHECKING, Any

from schemas.visible import shown

if TYPE_CHECKING:
    import pyarrow as pa

_WIDEST = 80
"""Longest text of a cell; a cell that is alone in its row is shown in full."""


def as_table(rows: pa.Table) -> str:
    """Columns aligned for reading; NULL is left empty."""
    names = rows.column_names
    if _is_plan(names):
        return "\n".join(str(text) for text in rows.column("explain_value").to_pylist())
    cells = [[_write_cell(value) for value in row.values()] for row in rows.to_pylist()]
    limit = _WIDEST if len(names) > 1 else None
    cells = [[_shorten(cell, limit) for cell in row] for row in cells]
    widths = [max([len(name), *(len(row[i]) for row in cells)]) for i, name in enumerate(names)]
    right = [_is_number(field) for field in rows.schema]
    lines = [_join_cells(names, widths, right), "  ".join("─" * width for width in widths)]
    lines += [_join_cells(row, widths, right) for row in cells]
    lines.append(f"({len(cells)} row{'' if len(cells) == 1 else 's'})")
    return "\n".join(lines)


def as_csv(rows: pa.Table) -> str:
    """RFC 4180 with a header; NULL is empty, times are ISO 8601, lists and structures are JSON."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(rows.column_names)
    for row in rows.to_pylist():
        writer.writerow(["" if value is None else _write_plainly(value) for value in row.values()])
    return text.getvalue().rstrip("\n")


def as_json(rows: pa.Table) -> str:
    """A list of objects; NULL, NaN and infinity are null, times are ISO 8601."""
    return json.dumps([_make_plain(row) for row in rows.to_pylist()], ensure_ascii=False, indent=1)


def as_parquet(rows: pa.Table) -> bytes:
    """A Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(rows, sink, compression="zstd")
    content: bytes = sink.getvalue().to_pybytes()
    return content


FORMATS: Mapping[str, Callable[[pa.Table], str | bytes]] = {
    "table": as_table,
    "csv": as_csv,
    "json": as_json,
    "parquet": as_parquet,
}


def _join_cells(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    parts = zip(cells, widths, right, strict=True)
    return "  ".join(c.rjust(w) if r else c.ljust(w) for c, w, r in parts).rstrip()


def _write_cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}"
    return shown(_write_plainly(value))


def _shorten(text: str, limit: int | None) -> str:
    return text if limit is None or len(text) <= limit else text[: limit - 1] + "…"


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
