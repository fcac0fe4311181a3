"""`dealab sql`: read-only SQL on the published database."""

from __future__ import annotations

import shlex
import shutil
import sys
from argparse import Namespace
from pathlib import Path

from pipeline.commands.command import DONE, LAB, Command, argument, parse_limit
from pipeline.lab.lab import DEFAULT_LAB, Lab
from schemas.errors import UsageError


def run(arguments: Namespace) -> int:
    from pipeline.commands.show.rows import FORMATS, as_table
    from pipeline.lab.query import Limits, Query
    from schemas.views import EXAMPLES

    if arguments.examples:
        lab = "" if Path(arguments.lab) == Path(DEFAULT_LAB) else f" --lab {shlex.quote(str(arguments.lab))}"
        for question, query in EXAMPLES:
            print(f'# {question}\ndealab sql "{query}"', f"{lab}\n", sep="")
        return DONE
    if arguments.query is None:
        raise UsageError("no query", expected="a SELECT between quotation marks; `dealab sql --examples` shows some")
    if arguments.format == "parquet" and sys.stdout.isatty():
        raise UsageError(
            "Parquet is no text for a terminal", remedy="Send it to a file: … --format parquet > rows.parquet"
        )
    if arguments.expanded and arguments.format != "table":
        raise UsageError(f"--expanded with --format {arguments.format}", expected="one of the two")
    query = sys.stdin.read() if arguments.query == "-" else arguments.query
    limits = Limits(arguments.timeout_s, arguments.rows, arguments.memory_mb)
    with Query(Lab(arguments.lab), limits) as database:
        rows = database.run(query)
    if arguments.format == "table":
        content: str | bytes = as_table(rows, width=_find_width(), expanded=arguments.expanded)
    else:
        content = FORMATS[arguments.format](rows)
    if isinstance(content, bytes):
        sys.stdout.buffer.write(content)
    else:
        print(content)
    return DONE


def _find_width() -> int | None:
    """Columns of the terminal; None where nobody watches, so that what reads a pipe is never shortened by a window."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


COMMAND = Command(
    (
        '"SELECT specimen_id, model_order FROM best_models"',
        '"SELECT * FROM survival_at(60)" --format csv > survival.csv',
        "\"SELECT time_ns, force FROM samples('RECORDING_ID')\" --format parquet > force.parquet",
        "--examples",
    ),
    (
        argument("query", nargs="?", metavar="QUERY", help='one SELECT; "-" reads it from standard input'),
        argument(
            "--format",
            choices=("table", "csv", "json", "parquet"),
            default="table",
            help="how rows are written (default: table)",
        ),
        argument(
            "--expanded", action="store_true", help="each value in a line of its own; so are rows that fit into no line"
        ),
        argument("--timeout-s", type=parse_limit, default=600, help="longest time; 0 for no limit (default: 600)"),
        argument(
            "--rows", type=parse_limit, default=10_000_000, help="most rows; 0 for no limit (default: 10 million)"
        ),
        argument(
            "--memory-mb", type=parse_limit, default=4096, help="most memory; 0 for what DuckDB likes (default: 4096)"
        ),
        argument("--examples", action="store_true", help="questions people ask, with the queries that answer them"),
        LAB,
    ),
    run,
)
