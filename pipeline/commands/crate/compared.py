"""How the results of two crates differ, file by file, in one line each."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Mapping

from pipeline.commands.crate.contents import FIGURES_FOLDER, MODELS_FOLDER, TABLES_FOLDER

_RESULTS = (TABLES_FOLDER, MODELS_FOLDER, FIGURES_FOLDER)


def compare_results(kept: Mapping[str, bytes], made: Mapping[str, bytes]) -> list[str]:
    """A line for each table, model or figure that is not the same, with how far its numbers are apart."""
    names = sorted(n for n in {*kept, *made} if n.split("/")[0] in _RESULTS)
    lines = []
    for name in names:
        if name not in made:
            lines.append(f"{name}: does not come out again")
        elif name not in kept:
            lines.append(f"{name}: comes out and is not in the crate")
        elif kept[name] != made[name]:
            lines.append(f"{name}: {_describe_change(name, kept[name], made[name])}")
    return lines


def _describe_change(name: str, kept: bytes, made: bytes) -> str:
    if not name.endswith(".csv"):
        return "comes out otherwise"
    first, second = (list(csv.reader(io.StringIO(text.decode("utf-8", "replace")))) for text in (kept, made))
    if first[:1] != second[:1]:
        return "has other columns"
    if len(first) != len(second):
        return f"has {len(first) - 1} rows and comes out with {len(second) - 1}"
    pairs = _match(first[1:], second[1:])
    other: Counter[str] = Counter()
    largest, where = 0.0, ""
    for a, b in pairs:
        for column, x, y in zip(first[0], a, b, strict=False):
            if x == y:
                continue
            apart = _measure(x, y)
            if apart is None:
                other[column] += 1
            elif apart > largest:
                largest, where = apart, column
    parts = [f"{n} cells of {c} are other" for c, n in other.most_common(3)]
    if where:
        parts.insert(0, f"numbers are apart by up to {largest:.2g} of their size ({where})")
    return "; ".join(parts) or "its rows are in another order"


def _match(first: list[list[str]], second: list[list[str]]) -> list[tuple[list[str], list[str]]]:
    """Rows that are not in both, each with the one that has most cells in common with it."""
    left = Counter(map(tuple, first)) - Counter(map(tuple, second))
    right = list((Counter(map(tuple, second)) - Counter(map(tuple, first))).elements())
    pairs = []
    for row in left.elements():
        best = max(right, key=lambda other: sum(x == y for x, y in zip(row, other, strict=False)))
        right.remove(best)
        pairs.append((list(row), list(best)))
    return pairs


def _measure(first: str, second: str) -> float | None:
    """How far two numbers are apart, as a share of the larger; None where one is none."""
    try:
        a, b = float(first), float(second)
    except ValueError:
        return None
    size = max(abs(a), abs(b))
    return abs(a - b) / size if size and math.isfinite(size) else None
