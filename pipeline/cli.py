"""The command `dealab`: finds the command that is asked for, runs it, and turns errors into lines and exit statuses.

Exit status: 0 all done, 1 could not do it, 2 wrong usage, 3 done but some recordings were refused, are damaged or
failed. What the commands are and do is in `pipeline.commands`.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.commands import (
    add,
    annotate,
    compare,
    completion,
    control,
    design,
    diagnose,
    doctor,
    export,
    figure,
    inspect,
    layout,
    lives,
    nightly,
    plan,
    prune,
    report,
    schedule,
    schema,
    simulate,
    sql,
    status,
    validate,
    verify,
)
from pipeline.commands.command import FAILED, Command
from pipeline.import_path import leave_working_folder
from schemas.alike import ask_meant
from schemas.errors import DealabError, UsageError

_USAGE, _INTERRUPTED, _PIPE_CLOSED = 2, 130, 141

COMMANDS: Mapping[str, Command] = {
    command.name: command
    for command in (
        nightly.COMMAND,
        sql.COMMAND,
        report.COMMAND,
        diagnose.COMMAND,
        simulate.COMMAND,
        plan.COMMAND,
        compare.COMMAND,
        figure.COMMAND,
        design.COMMAND,
        control.COMMAND,
        layout.COMMAND,
        lives.COMMAND,
        export.COMMAND,
        verify.COMMAND,
        inspect.COMMAND,
        add.COMMAND,
        validate.COMMAND,
        status.COMMAND,
        annotate.EXCLUSION,
        annotate.INCLUSION,
        prune.COMMAND,
        doctor.COMMAND,
        schedule.COMMAND,
        completion.COMMAND,
        schema.COMMAND,
    )
}
"""All commands, in the order in which `dealab --help` lists them."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit status. Errors are one line on stderr, never a traceback."""
    if argv is None:
        leave_working_folder()
        _make_streams_usable()
    given = sys.argv[1:] if argv is None else list(argv)
    wanted = next((word for word in given if not word.startswith("-")), None)
    parser = _make_parser(wanted)
    if wanted is not None and wanted not in COMMANDS:
        parser.error(f'there is no command "{wanted[:80]}"{ask_meant(wanted, COMMANDS)} `dealab --help` lists all')
    arguments = parser.parse_args(given)
    try:
        ended = COMMANDS[arguments.command].run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _PIPE_CLOSED
    except KeyboardInterrupt:
        print("dealab: interrupted; what was finished is kept for the next run", file=sys.stderr)
        return _INTERRUPTED
    except UsageError as error:
        return _tell(error, _USAGE)
    except DealabError as error:
        return _tell(error, FAILED)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"dealab: {place}{error.strerror or error}", file=sys.stderr)
        return FAILED
    return ended


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


def _make_parser(wanted: str | None) -> argparse.ArgumentParser:
    """The parser; of the commands only the wanted one has its arguments, since building all of them takes a while."""
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
    for name, command in COMMANDS.items():
        if name != wanted:
            parsers.add_parser(name, help=command.what)
            continue
        added = parsers.add_parser(
            name,
            help=command.what,
            description=f"{command.what[0].upper()}{command.what[1:]}.",
            epilog="examples:\n" + "\n".join(f"  dealab {name} {example}".rstrip() for example in command.examples),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for add_argument in command.arguments:
            add_argument(added)
        added.set_defaults(commands=COMMANDS)
    return parser


class _Version(argparse.Action):
    """Asks for the version only when it is asked for: that costs as much as all the rest of `--help`."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib import metadata

        parser.exit(message=f"dealab {metadata.version('dealab')}\n")


if __name__ == "__main__":
    sys.exit(main())
