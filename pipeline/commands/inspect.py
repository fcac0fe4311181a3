"""`dealab inspect`: what is in a file, whether it fits, and what is wrong with it."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import ATTENTION, DONE, RIGS, Command, argument, parse_path


def run(arguments: Namespace) -> int:
    from ingest.inspect import FITS, inspect

    found = [inspect(path, rigs=arguments.rigs) for path in arguments.file]
    print("\n\n".join(inspection.as_text() for inspection in found))
    return DONE if all(inspection.verdict == FITS for inspection in found) else ATTENTION


COMMAND = Command(
    "inspect",
    "what is in a recording, whether it fits, and what is wrong with it; writes nothing",
    ("run7.mcap", "run7.csv"),
    (argument("file", nargs="+", type=parse_path, metavar="FILE"), RIGS),
    run,
)
