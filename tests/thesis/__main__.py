"""Asks a lab for every figure and table of the thesis: `python -m tests.thesis LAB` writes the results that the README of the
reports shows. LAB is the demonstration's (`make demo`: demo/lab).
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import duckdb

from schemas.numbers import compact
from tests.thesis.statements import STATEMENTS, Statement, Value

RESULTS = Path(__file__).with_name("results.json")


def ask(connection: duckdb.DuckDBPyConnection, statement: Statement) -> Value:
    """Value, lower and upper limit of a statement; None for what is not there.

    Raises
    ------
    ValueError
        Its query gives more than one row.
    """
    if statement.answer is None:
        return None, None, None
    if callable(statement.answer):
        return statement.answer()
    rows = connection.execute(statement.answer).fetchall()
    if len(rows) > 1:
        raise ValueError(f"{statement.where}, {statement.what}: {len(rows)} rows, expected one")
    value, low, high = rows[0] if rows else (None, None, None)
    return tuple(None if v is None or not math.isfinite(float(v)) else float(v) for v in (value, low, high))  # type: ignore[return-value]


def judge(statement: Statement, value: Value) -> str:
    """`same`, `differs`, `no number` (none is printed, or a picture) or `missing` (the lab has no such result)."""
    if statement.answer is None or statement.thesis is None:
        return "no number" if statement.answer is None or value[0] is not None else "missing"
    if value[0] is None:
        return "missing"
    low = value[0] if value[1] is None else value[1]
    high = value[0] if value[2] is None else value[2]
    slack = statement.accuracy + 1e-9 * abs(statement.thesis)
    return "same" if low <= statement.thesis + slack and high >= statement.thesis - slack else "differs"


def table() -> str:
    """The table of the README: every statement with its page, query, numbers and verdict, from the results as they were written."""
    if not RESULTS.is_file():
        return "Nothing has been asked yet: `python -m tests.thesis demo/lab`."
    kept = {(r["where"], r["what"]): r for r in json.loads(RESULTS.read_text(encoding="utf-8"))}
    found = [(s, kept.get((s.where, s.what), {})) for s in STATEMENTS]
    verdicts = [r.get("verdict", "missing") for _, r in found]
    counts = ", ".join(f"{verdicts.count(v)} {v}" for v in ("same", "differs", "no number", "missing") if v in verdicts)
    lines = [
        f"{len(STATEMENTS)} entries: {counts}.",
        "",
        "| in the thesis | what | page | ours (95 %) | thesis | same or why not | query |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [_line(s, r) for s, r in found]
    return "\n".join(lines)


def _line(statement: Statement, row: Mapping[str, Any]) -> str:
    verdict = row.get("verdict", "missing")
    said = {"same": "same", "no number": statement.why, "missing": "no result in this lab"}.get(verdict, statement.why)
    if verdict == "same" and statement.why:
        said = f"same; {statement.why}"
    query = ""
    if isinstance(statement.answer, str):
        query = f"`{statement.answer}`"
    elif statement.answer is not None:
        query = "computed"
    cells = (
        statement.where, statement.what, f"`{statement.page}`", _number(row, statement.unit),
        "–" if statement.thesis is None else _printed(statement), said, query,
    )  # fmt: skip
    return "| " + " | ".join(cell.replace("|", "&#124;") for cell in cells) + " |"


def _number(row: Mapping[str, Any], unit: str) -> str:
    if row.get("value") is None:
        return "–"
    text = compact(row["value"], 3)
    if row.get("lower") is not None and row.get("upper") is not None:
        text += f" ({compact(row['lower'], 3)} to {compact(row['upper'], 3)})"
    return f"{text} {unit}".strip()


def _printed(statement: Statement) -> str:
    assert statement.thesis is not None
    known = f" ± {compact(statement.accuracy, 1)}" if statement.accuracy > 1e-3 * abs(statement.thesis) else ""
    return f"{compact(statement.thesis, 3)}{known} {statement.unit}".strip()


def main(lab: Path) -> int:
    """Writes the results; exit status 1 where one is missing or differs without a reason, or its page is not there."""
    rows = []
    with duckdb.connect(str(lab / "results.duckdb"), read_only=True) as connection:
        for statement in STATEMENTS:
            value = ask(connection, statement)
            names = dict(zip(("value", "lower", "upper"), (_short(v) for v in value), strict=True))
            rows.append({"where": statement.where, "what": statement.what, **names, "verdict": judge(statement, value)})
    RESULTS.write_text("[\n" + ",\n".join(json.dumps(r, ensure_ascii=False) for r in rows) + "\n]\n", encoding="utf-8")
    wrong = [
        f"{s.where}, {s.what}: {r['verdict']} ({r['value']} against {s.thesis})"
        for s, r in zip(STATEMENTS, rows, strict=True)
        if r["verdict"] == "missing" or (r["verdict"] == "differs" and not s.why)
    ]
    wrong += [
        f"{page}: no such part of the report"
        for page in dict.fromkeys(s.page for s in STATEMENTS)
        if not _is_there(lab, page)
    ]
    for text in wrong:
        print(text, file=sys.stderr)
    return int(bool(wrong))


def _is_there(lab: Path, page: str) -> bool:
    """The report has that page with that part."""
    name, _, part = page.partition("#")
    path = lab / "reports" / name
    return path.is_file() and (not part or f'labelledby="{part}"' in path.read_text(encoding="utf-8"))


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.5g}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("usage: python -m tests.thesis LAB")
    sys.exit(main(Path(sys.argv[1])))
