"""What the READMEs say in numbers: costs, benchmarks, faults and bad files, from the results that their commands wrote."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.benchmarks.__main__ import known

TESTS = Path(__file__).resolve().parents[1]
CORE_HOUR = 0.05
"""Price of an hour of one rented processor core, in $: an assumption."""
GIGABYTE_MONTH = 0.023
"""Price of a gigabyte for a month in an object store, in $: an assumption."""
_SECONDS_OF_A_NIGHT = 8 * 3600
_MEMORY_MB = 16_000
"""Memory of the machine that the night runs on."""


NOT_YET = "Nothing has been measured yet: `make bench`, `make faults`, `make fuzz`."


def costs() -> str:
    """Bytes, hours and money up to a million recordings, from the largest first night and the demonstration; memory from
    nights with nothing new, which have the pages to look through."""
    nightly = known().get("nightly", {})
    rows: list[Mapping[str, Any]] = [row["measured"] for row in nightly.get("rows", ()) if "measured" in row]
    small = [row for row in rows if "overhead_s" in row]
    real = [row for row in rows if "raw_bytes" in row and "overhead_s" not in row]
    if not small or not real:
        return NOT_YET
    largest, demo = max(small, key=lambda row: row["recordings"]), real[-1]
    nights = [row for row in rows if row.keys() == {"recordings", "seconds", "peak_mb"}]
    quiet, smallest = (pick(nights, key=lambda row: row["recordings"]) for pick in (max, min))
    each_mb = (quiet["peak_mb"] - smallest["peak_mb"]) / (quiet["recordings"] - smallest["recordings"] or 1)
    each_s = demo["seconds"] / demo["recordings"]
    lines = [
        f"A recording of the demonstration ({demo['raw_bytes'] / 1e3:.0f} kB raw) takes {each_s:.2f} s of one core, pages"
        f" included, and {demo['lab_bytes'] / 1e3:.0f} kB in the lab. The night's own share is"
        f" {1e3 * largest['overhead_s']:.1f} ms of that, measured on {largest['recordings']:,} recordings. From these:",
        "",
        "| recordings | raw | lab | first night, 2 cores | its cost | storage, a month | a night with nothing new | memory |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for count in (1_000, 10_000, 100_000, 1_000_000):
        raw, lab = count * demo["raw_bytes"] / 1e9, count * demo["lab_bytes"] / 1e9
        hours = count * each_s / demo["speedup"] / 3600
        memory = smallest["peak_mb"] + each_mb * max(0, count - smallest["recordings"])
        idle = quiet["seconds"] * max(1.0, count / quiet["recordings"])
        lines.append(
            f"| {count:,} | {raw:,.1f} GB | {lab:,.1f} GB | {_time(3600 * hours)} | {2 * hours * CORE_HOUR:,.2f} $"
            f" | {(raw + lab) * GIGABYTE_MONTH:,.2f} $ | {_time(idle)} | {memory:,.0f} MB |"
        )
    new = _SECONDS_OF_A_NIGHT * demo["speedup"] / each_s
    limit = smallest["recordings"] + (_MEMORY_MB - smallest["peak_mb"]) / each_mb if each_mb > 0 else float("inf")
    lines += [
        "",
        f"Prices assumed: {CORE_HOUR} $ an hour of a core, {GIGABYTE_MONTH} $ a gigabyte and month; beyond"
        f" {largest['recordings']:,} recordings the table is an extrapolation in proportion. Eight hours of two cores take in"
        f" {_about(new)} new recordings. What a night knows of each recording lies on disk; the first limit of the whole is the"
        f" memory that it takes to look through the pages of all of them, {1e3 * each_mb:.0f} kB each, so that"
        f" {_MEMORY_MB / 1000:.0f} GB are used up at {_about(limit)} recordings. Before that comes patience: readers copy nothing, but each night copies the database.",
    ]
    return "\n".join(lines)


def _name_in_full(name: str, before: str) -> str:
    return before + name.removeprefix("the same") if name.startswith("the same") else name


def ratios() -> str:
    """The rows with a ratio, one list; what is "the same" as the row before is named after that."""
    lines = []
    for _, one in sorted(known().items()):
        title = one["title"]
        for before, row in itertools.pairwise([{"name": ""}, *one["rows"]]):
            if row.get("ratio") is None:
                continue
            name = _name_in_full(row["name"], before["name"].removesuffix(", 1 worker"))
            lines.append(f"| {title} | {name} | {row['ratio']:.3g} | {row.get('note') or ''} |")
            title = ""
    head = ["| benchmark | what | ratio | |", "|---|---|---:|---|"]
    return "\n".join(head + lines) if lines else NOT_YET


def faults() -> str:
    """The fault harness's table."""
    return "\n".join(_table(TESTS / "faults" / "results.md")) or NOT_YET


def bad_files() -> str:
    """The fuzzing run's table."""
    return "\n".join(_table(TESTS / "bad_files" / "results.md")) or NOT_YET


def _table(path: Path) -> list[str]:
    """The first table of a results file."""
    if not path.exists():
        return []
    found = re.search(r"(?:^\|.*\n?)+", path.read_text(encoding="utf-8"), re.M)
    return found[0].splitlines() if found else []


def _time(seconds: float) -> str:
    for size, unit in ((86_400, "d"), (3600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.1f} s"


def _about(number: float) -> str:
    if number == float("inf"):
        return "any number of"
    digits = 10 ** max(0, len(str(int(number))) - 2)
    return f"{round(number / digits) * digits:,}"
