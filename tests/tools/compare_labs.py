"""Do two labs say the same? Every table of their databases, value by value.

    python -m tests.tools.compare_labs BEFORE/results.duckdb AFTER/results.duckdb [--relative 1e-9]

For changes that must change no result. What says when, where and by which code a result was made is left out; everything else has to be
equal, floating-point numbers to `--relative` (0: to the last bit). Exit status 1 where something differs, with the first differences.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import duckdb

LEFT_OUT_TABLES = frozenset({"runs", "files", "history", "lab", "items"})
"""Tables about nights and code, not about results."""
LEFT_OUT_COLUMNS = frozenset(
    {"run_id", "source_path", "software_version", "code_version", "settings_hash", "input_hash", "seconds", "seen_at"}
)


def compare(before: str, after: str, relative: float) -> Iterator[str]:
    """Differences in words, one a line; none where the labs say the same."""
    with duckdb.connect(before, read_only=True) as old, duckdb.connect(after, read_only=True) as new:
        tables = {name: _columns(old, name) for name in _tables(old)}
        others = {name: _columns(new, name) for name in _tables(new)}
        for name in sorted(tables.keys() | others.keys()):
            if name not in tables or name not in others:
                yield f"{name}: only in the {'first' if name in tables else 'second'} lab"
                continue
            yield from _compare_table(old, new, name, tables[name], others[name], relative)


def _tables(database: duckdb.DuckDBPyConnection) -> list[str]:
    rows = database.execute("SELECT table_name FROM duckdb_tables() ORDER BY 1").fetchall()
    return [name for (name,) in rows if name not in LEFT_OUT_TABLES]


def _columns(database: duckdb.DuckDBPyConnection, table: str) -> list[str]:
    rows = database.execute("SELECT column_name FROM duckdb_columns() WHERE table_name = ?", [table]).fetchall()
    return [name for (name,) in rows if name not in LEFT_OUT_COLUMNS]


def _compare_table(
    old: duckdb.DuckDBPyConnection,
    new: duckdb.DuckDBPyConnection,
    table: str,
    columns: Sequence[str],
    others: Sequence[str],
    relative: float,
) -> Iterator[str]:
    for name in sorted(set(columns) ^ set(others)):
        yield f"{table}.{name}: only in the {'first' if name in columns else 'second'} lab"
    shared = [name for name in columns if name in others]
    quoted = ", ".join('"' + name + '"' for name in shared)
    query = f'SELECT {quoted} FROM "{table}" ORDER BY ALL'
    left, right = old.execute(query).fetchall(), new.execute(query).fetchall()
    if len(left) != len(right):
        yield f"{table}: {len(left)} rows and {len(right)} rows"
        return
    for name, place in zip(shared, range(len(shared)), strict=True):
        differing = [
            i for i, (a, b) in enumerate(zip(left, right, strict=True)) if not _same(a[place], b[place], relative)
        ]
        if differing:
            first = differing[0]
            yield (
                f"{table}.{name}: {len(differing)} of {len(left)} rows differ, first"
                f" {str(left[first][place])[:120]} and {str(right[first][place])[:120]}"
            )


def _same(a: Any, b: Any, relative: float) -> bool:
    if isinstance(a, float) and isinstance(b, float):
        return a == b or (math.isnan(a) and math.isnan(b)) or abs(a - b) <= relative * max(abs(a), abs(b))
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(_same(x, y, relative) for x, y in zip(a, b, strict=True))
    return bool(a == b)


def main() -> int:
    parser = argparse.ArgumentParser(description="Compares all results of two labs")
    parser.add_argument("before")
    parser.add_argument("after")
    parser.add_argument(
        "--relative", type=float, default=0.0, help="relative difference of numbers that is none (default 0)"
    )
    given = parser.parse_args()
    found = list(compare(given.before, given.after, given.relative))
    print("\n".join(found) or "Every table says the same.")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
