"""`dealab inspect`: what is in a file, whether it fits, and what is wrong with it."""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from typing import TYPE_CHECKING

from pipeline.commands import add
from pipeline.commands.command import ATTENTION, DONE, RIGS, Command, argument, parse_path

if TYPE_CHECKING:
    from pathlib import Path

    from ingest.inspect import Inspection


def run(arguments: Namespace) -> int:
    from ingest.inspect import FITS

    if arguments.write:
        return add.run(arguments)
    found = [_inspect(path, arguments.rigs) for path in arguments.file]
    if len(found) == 1 and _goes_to_mapping(found[0]):
        print(found[0].as_text(with_draft=False), file=sys.stderr)
        print(found[0].draft or "", end="")
    else:
        print("\n\n".join(inspection.as_text() for inspection in found))
    return DONE if all(inspection.verdict == FITS for inspection in found) else ATTENTION


def _inspect(path: Path, rigs: Path | None) -> Inspection:
    """The findings about a file; a reader that crashes costs this file and not those after it."""
    from ingest.apart import shield
    from ingest.inspect import REFUSED, Inspection, inspect
    from schemas.errors import RefusedError

    if not path.is_file():
        return inspect(path, rigs=rigs)  # which says so
    try:
        return shield(path, inspect, path, rigs=rigs)
    except RefusedError as error:
        return Inspection(path, path.suffix.lstrip(".") or None, path.stat().st_size, REFUSED, error=error)


def _goes_to_mapping(inspection: Inspection) -> bool:
    """Whether the output is sent to a TOML, `> run7.csv.toml`: the draft alone belongs there."""
    from ingest.mapping import own_mapping

    try:
        return os.path.samestat(os.fstat(sys.stdout.fileno()), own_mapping(inspection.path).stat())
    except (OSError, ValueError):
        return False


COMMAND = Command(
    ("run7.mcap", "run7.csv", "run7.csv > run7.csv.toml", "run7.csv --write"),
    (
        argument("file", nargs="+", type=parse_path, metavar="FILE"),
        argument("--write", action="store_true", help="writes the mapping, as the command add does"),
        add.YES,
        add.REPLACE,
        RIGS,
    ),
    run,
)
