"""The command `dealab`: finds the command that is asked for, runs it, and turns errors into lines and exit statuses.

Exit status: 0 all done, 1 could not do it, 2 wrong usage, 3 done but some recordings were refused, are damaged or
failed. What the commands are and do is in `pipeline.commands`.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pipeline.import_path import leave_working_folder
from schemas.alike import ask_meant
from schemas.errors import DealabError, UsageError

if TYPE_CHECKING:
    from pipeline.commands.command import Command

_FAILED, _USAGE, _INTERRUPTED, _PIPE_CLOSED = 1, 2, 130, 141

COMMANDS: Mapping[str, str] = {
    "nightly": "the whole job over raw files and folders; what has not changed is not done again",
    "sql": "read-only SQL on the published database",
    "report": "rebuild the pages from the database alone",
    "diagnose": "what the simulation gets wrong, the cause, and what mending it gains",
    "simulate": "the virtual rig: raw recordings of a described campaign",
    "plan": "lifetime tests: how many specimens, at which voltages, how long, and what that tells",
    "compare": "several specimens or batches in one figure, with their differences",
    "figure": "a figure of the pages for a paper: PDF, SVG or PNG, with its data",
    "design": "an actuator of a fitted film: what it would do, with limits, or the sizes that a requirement needs",
    "control": "controllers for a self-sensing specimen: PI by loop shaping, film inverse, predictive; with limits",
    "layout": "electrodes for a film over rods that would live longer at the same force, as SVG and CSV",
    "lives": "what the lives of a campaign depend on, with limits by simulation beside those of the likelihood",
    "export": "a film's model for Abaqus, Ansys, COMSOL or LS-DYNA, or a lab's results as a crate",
    "verify": "whether a crate is what it says, and whether its results come out again",
    "inspect": "what is in a recording, whether it fits, and what is wrong with it; writes nothing but with --write",
    "add": "drafts the mapping of a file, asks what the file does not say, and writes it beside the file",
    "validate": "whether mappings, rig files, metadata (JSON) and recordings keep to the published formats; exit status 1 if not",
    "status": "what is in the lab, what was refused and why, the last run",
    "exclude": "take a recording out of the analysis; who, when and why is kept",
    "include": "take a recording back into the analysis; who, when and why is kept",
    "prune": "remove what the lab can do without: old samples, copies of refused files, recordings that have gone",
    "doctor": "check the installation and the lab",
    "schedule": "systemd units, or a line for cron, that run the nightly every night",
    "completion": "completion of commands and options for a shell",
    "schema": "the tables and views of the database, with units and meanings, in Markdown",
}
"""What each command does, in the order in which `dealab --help` lists them.

The list stands here, and not in the files of the commands, so that `--help` has to import none of them.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit status. Errors are one line on stderr, never a traceback."""
    if argv is None:
        leave_working_folder()
        _make_streams_usable()
    given = sys.argv[1:] if argv is None else list(argv)
    wanted = next((word for word in given if not word.startswith("-")), None)
    parser = make_parser(() if wanted is None else (wanted,))
    if wanted is not None and wanted not in COMMANDS:
        parser.error(f'there is no command "{wanted[:80]}"{ask_meant(wanted, COMMANDS)} `dealab --help` lists all')
    arguments = parser.parse_args(given)
    try:
        ended = _load(arguments.command).run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        return _PIPE_CLOSED
    except KeyboardInterrupt:
        print("dealab: interrupted; what was finished is kept for the next run", file=sys.stderr)
        return _INTERRUPTED
    except UsageError as error:
        return _tell(error, _USAGE)
    except DealabError as error:
        return _tell(error, _FAILED)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"dealab: {place}{error.strerror or error}", file=sys.stderr)
        return _FAILED
    finally:
        _end_output()
    return ended


def _end_output() -> None:
    """What cannot be written any more leads nowhere, so that the end of the program does not try again and fail once more."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _make_streams_usable() -> None:
    """Streams that were closed lead nowhere, and signs that a terminal does not have are written as escapes.

    A file that is opened while a stream is closed would stand in its place. What goes to a file or a program is UTF-8.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - until the end
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding=None if stream.isatty() else "utf-8", errors="backslashreplace")


def _tell(error: DealabError, status: int) -> int:
    from schemas.visible import make_safe

    print(f"dealab: {make_safe(str(error))}", file=sys.stderr)
    return status


def _load(name: str) -> Command:
    """All about the command of a name."""
    from importlib import import_module

    found: Command = import_module(f"pipeline.commands.{name}").COMMAND
    return found


def make_parser(wanted: Iterable[str]) -> argparse.ArgumentParser:
    """The parser; only the wanted commands have their arguments, since loading and building all of them takes a while."""
    parser = argparse.ArgumentParser(
        prog="dealab",
        description="Laboratory data pipeline for dielectric elastomer actuators: raw recordings in; models, survival, "
        "SQL and reports out.",
        epilog="examples:\n  dealab nightly raw/\n  dealab sql --examples\n  dealab inspect run7.csv\n\n"
        "exit status: 0 all done, 1 could not do it, 2 wrong usage, "
        "3 done, but some recordings were refused or are damaged, 4 done, but some recordings led to no result",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and end")
    parsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, what in COMMANDS.items():
        if name not in wanted:
            parsers.add_parser(name, help=what)
            continue
        command = _load(name)
        added = parsers.add_parser(
            name,
            help=what,
            description=f"{what[0].upper()}{what[1:]}.",
            epilog="examples:\n" + "\n".join(f"  dealab {name} {example}".rstrip() for example in command.examples),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for add_argument in command.arguments:
            add_argument(added)
        added.set_defaults(commands=COMMANDS, make_parser=make_parser)
    return parser


class _Version(argparse.Action):
    """Asks for the version only when it is asked for: that costs as much as all the rest of `--help`."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib import metadata

        parser.exit(message=f"dealab {metadata.version('dealab')}\n")


if __name__ == "__main__":
    sys.exit(main())
