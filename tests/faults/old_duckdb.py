"""A lab of today in other DuckDBs: every table, view, macro and example query, into `old_duckdb.md`.

    python -m tests.faults.old_duckdb [VERSION …]

Each version is installed into an environment of its own, as people have it who open `results.duckdb` without dealab. It is
asked by a script that knows DuckDB only, and has to give the same rows as the version that wrote the file.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

import duckdb

from pipeline import Lab
from pipeline.nightly.night import nightly
from schemas.tables import TABLES
from schemas.views import EXAMPLES, VIEWS
from tests.helpers.machine import machine, today
from tests.helpers.small_lab import small_campaign

HERE = Path(__file__).resolve().parent
VERSIONS = ("1.2.0", "1.2.2", "1.3.0", "1.3.2", "1.4.0", "1.4.4")
"""The first and the last release of each that the README promises."""
_ASK = """
import json, sys
import duckdb
connection = duckdb.connect(sys.argv[1], read_only=True)
told = {}
for query in json.load(sys.stdin):
    try:
        told[query] = sorted(str(list(map(str, row))) for row in connection.execute(query).fetchall())
    except Exception as error:
        told[query] = f"{type(error).__name__}: {str(error).splitlines()[0]}"
json.dump(told, sys.stdout)
"""


def list_queries() -> list[str]:
    """Everything that may be asked of a lab: tables, views, macros as in the examples, the examples.

    `samples` is no part of the file: dealab makes it for its own queries.
    """
    queries = [f"SELECT * FROM {name}" for name in (*TABLES, *(view.name for view in VIEWS if not view.parameters))]
    for view in VIEWS:
        if view.parameters:
            told = [query for _, query in EXAMPLES if f"{view.name}(" in query]
            assert told, f"no example of the macro {view.name}"
    return [*queries, *(query for _, query in EXAMPLES if "samples(" not in query)]


def ask(python: str, database: Path, queries: list[str]) -> dict[str, list[str] | str]:
    """What a Python's DuckDB answers: rows, or why it has none."""
    command = [python, "-c", _ASK, str(database)]
    done = subprocess.run(command, input=json.dumps(queries), capture_output=True, text=True, check=True)
    found: dict[str, list[str] | str] = json.loads(done.stdout)
    return found


def install(version: str, folder: Path) -> str:
    """An environment with this DuckDB, and pytz, which it needs to hand times over to Python; its Python."""
    venv.create(folder, with_pip=True)
    python = str(folder / "bin" / "python")
    subprocess.run([python, "-m", "pip", "install", "-q", "--no-deps", f"duckdb=={version}", "pytz"], check=True)
    return python


def compare(now: dict[str, list[str] | str], then: dict[str, list[str] | str]) -> list[str]:
    """Queries that an older version answers otherwise, each with what it said."""
    wrong = []
    for query, rows in now.items():
        if isinstance(rows, str):
            wrong.append(f"`{query}`: today's version says {rows}")
        elif then[query] != rows:
            told = then[query]
            wrong.append(f"`{query}`: {told if isinstance(told, str) else 'other rows'}")
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("versions", nargs="*", default=VERSIONS)
    versions = parser.parse_args().versions
    lines = ["# Older DuckDBs\n", "Made by `make faults`; not edited by hand. A lab written by DuckDB"]
    lines[-1] += f" {duckdb.__version__}, asked by others.\n"
    lines += [f"{today()} · {machine()}\n", "| DuckDB | queries | other answers |", "|---|---:|---|"]
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lab = Lab(folder / "lab")
        nightly([small_campaign(folder / "raw")], lab, jobs=1)
        before = hashlib.sha256(lab.database.read_bytes()).hexdigest()
        queries = list_queries()
        now = ask(sys.executable, lab.database, queries)
        for version in versions:
            found = compare(now, ask(install(version, folder / version), lab.database, queries))
            lines.append(f"| {version} | {len(queries)} | {len(found) or 'none'} |")
            print(lines[-1], *found, sep="\n", flush=True)
            wrong += [f"- {version}: {one}" for one in found]
        if hashlib.sha256(lab.database.read_bytes()).hexdigest() != before:
            wrong.append("- the file was changed")
    (HERE / "old_duckdb.md").write_text("\n".join([*lines, "", *wrong]).rstrip() + "\n", encoding="utf-8")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
