"""`make bench`: every benchmark of this folder, side by side in one run, into `results.md` and `results.json`.

    python -m tests.benchmarks [NAME…] [--dry]

Each `bench_<name>.py` has `TITLE` and `run() -> list[dict]`; a dict has `name` and any of `seconds` (median), `ratio`, `note`
and `measured` (plain numbers for the README). Named benchmarks replace their own part of the results only, each part
with its day and machine. Machines are noisy: ratios between rows of one benchmark are what counts, not the seconds.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import json
import sys
from pathlib import Path
from typing import Any

from tests.helpers.machine import machine, today

HERE = Path(__file__).resolve().parent
PACKAGES = ("numpy", "scipy", "pandas", "pyarrow", "duckdb", "mcap", "matplotlib")


def as_table(title: str, rows: list[dict[str, Any]]) -> str:
    lines = [f"## {title}", "", "| what | median, s | ratio | note |", "|---|---:|---:|---|"]
    for row in rows:
        seconds = f"{row['seconds']:.3g}" if row.get("seconds") is not None else ""
        ratio = f"{row['ratio']:.3g}" if row.get("ratio") is not None else ""
        lines.append(f"| {row['name']} | {seconds} | {ratio} | {row.get('note') or ''} |")
    return "\n".join(lines) + "\n"


RESULTS = HERE / "results.json"


def known() -> dict[str, dict[str, Any]]:
    """What was measured: benchmark to its title, day, machine, versions and rows."""
    found: dict[str, dict[str, Any]] = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    return found


def as_text(results: dict[str, dict[str, Any]]) -> str:
    """`results.md`."""
    parts = [
        "# Benchmarks\n",
        "Made by `make bench`; not edited by hand. Ratios are measured side by side in one run.\n",
    ]
    for _, one in sorted(results.items()):
        parts += [as_table(one["title"], one["rows"]), f"{one['day']} · {one['machine']} · {one['versions']}\n"]
    return "\n".join(parts)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", help="benchmarks to run, without bench_; all when none is named")
    parser.add_argument("--dry", action="store_true", help="print only, leave the results as they are")
    arguments = parser.parse_args()
    found = sorted(path.stem.removeprefix("bench_") for path in HERE.glob("bench_*.py"))
    unknown = set(arguments.names) - set(found)
    if unknown:
        print(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join(found)}", file=sys.stderr)
        return 2
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in PACKAGES)
    results = {name: one for name, one in known().items() if name in found}
    for name in arguments.names or found:
        module = importlib.import_module(f"tests.benchmarks.bench_{name}")
        rows = module.run()
        print(as_table(module.TITLE, rows), flush=True)
        results[name] = {
            "title": module.TITLE,
            "day": today(),
            "machine": machine(),
            "versions": versions,
            "rows": rows,
        }
        if not arguments.dry:
            RESULTS.write_text(json.dumps(results, indent=1, sort_keys=True) + "\n", encoding="utf-8")
            (HERE / "results.md").write_text(as_text(results), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
