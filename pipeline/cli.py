"""The command `dealab`: arguments, help, exit statuses. What a command does is elsewhere, and imported when it is called.

Exit status: 0 all done, 1 could not do it, 2 wrong usage, 3 done but some recordings were refused, are damaged or failed.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from pipeline.commands.arguments import Version, argument, days, jobs, processors, tracked
from pipeline.lab.lab import DEFAULT_LAB, Lab
from schemas.errors import DealabError, UsageError

_DONE, _FAILED, _USAGE, _ATTENTION, _INTERRUPTED, _PIPE_CLOSED = 0, 1, 2, 3, 130, 141
_SQL_FORMATS = ("table", "csv", "json", "parquet")

_Command: TypeAlias = tuple[
    str,
    tuple[str, ...],
    tuple[Callable[[argparse.ArgumentParser], object], ...],
    Callable[[argparse.Namespace], int],
]
"""What it does, examples, its arguments, and the function that runs it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit status. Errors are one line on stderr, never a traceback."""
    given = sys.argv[1:] if argv is None else list(argv)
    wanted = next((word for word in given if not word.startswith("-")), None)
    arguments = _parser(wanted).parse_args(given)
    try:
        status: int = arguments.run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _PIPE_CLOSED
    except KeyboardInterrupt:
        print("dealab: interrupted; what was finished is kept for the next run", file=sys.stderr)
        return _INTERRUPTED
    except UsageError as error:
        return _refused(error, _USAGE)
    except DealabError as error:
        return _refused(error, _FAILED)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"dealab: {place}{error.strerror or error}", file=sys.stderr)
        return _FAILED
    return status


def _refused(error: DealabError, status: int) -> int:
    from pipeline.commands.show import safe

    print(f"dealab: {safe(str(error))}", file=sys.stderr)
    return status


def _nightly(arguments: argparse.Namespace) -> int:
    from pipeline.commands.show import safe
    from pipeline.nightly.night import nightly

    lab = Lab(arguments.lab)
    summary = nightly(
        arguments.raw,
        lab,
        jobs=arguments.jobs,
        rigs=arguments.rigs,
        cluster=arguments.cluster,
        track=tracked,
    )
    for line in (*summary.notes, *summary.attention):
        print(safe(line), file=sys.stderr)
    if summary.report_problem is not None:
        print(f"dealab: the report could not be written: {safe(summary.report_problem)}", file=sys.stderr)
    print(summary.paragraph())
    print(f"Database: {lab.database}")
    print(f"Report:   {lab.reports / 'index.html'}")
    return summary.exit_status


def _sql(arguments: argparse.Namespace) -> int:
    from pipeline.commands.show import FORMATS
    from pipeline.lab.query import Query
    from schemas.views import EXAMPLES

    if arguments.examples:
        for question, query in EXAMPLES:
            print(f'# {question}\ndealab sql "{query}"\n')
        return _DONE
    if arguments.query is None:
        raise UsageError("no query", expected='dealab sql "SELECT …", or --examples')
    if arguments.format == "parquet" and sys.stdout.isatty():
        raise UsageError(
            "Parquet is no text for a terminal", remedy="Send it to a file: … --format parquet > rows.parquet"
        )
    query = sys.stdin.read() if arguments.query == "-" else arguments.query
    with Query(Lab(arguments.lab)) as database:
        content = FORMATS[arguments.format](database.run(query))
    if isinstance(content, bytes):
        sys.stdout.buffer.write(content)
    else:
        print(content)
    return _DONE


def _report(arguments: argparse.Namespace) -> int:
    from reports.build import build_reports

    lab = Lab(arguments.lab)
    lab.require_database()
    build_reports(lab.folder, force=True)
    print(f"Report: {lab.reports / 'index.html'}")
    return _DONE


def _diagnose(arguments: argparse.Namespace) -> int:
    from pipeline.commands.diagnose import diagnoses

    print(diagnoses(Lab(arguments.lab), arguments.specimen, as_json=arguments.format == "json"))
    return _DONE


def _simulate(arguments: argparse.Namespace) -> int:
    from pipeline.commands.controller import ControllerStudy
    from pipeline.simulate.write import simulate_command

    study = ControllerStudy()
    status = simulate_command(arguments.campaign, arguments.out, arguments.truth, study.add)
    if study.text:
        print(f"\n{study.text}")
    return status


def _inspect(arguments: argparse.Namespace) -> int:
    from ingest.inspect import FITS, inspect

    found = [inspect(path, rigs=arguments.rigs) for path in arguments.file]
    print("\n\n".join(inspection.as_text() for inspection in found))
    return _DONE if all(inspection.verdict == FITS for inspection in found) else _ATTENTION


def _status(arguments: argparse.Namespace) -> int:
    from pipeline.commands.status import status

    print(status(Lab(arguments.lab)))
    return _DONE


def _annotate(arguments: argparse.Namespace) -> int:
    from pipeline.lab.annotations import annotate, check_annotation
    from pipeline.lab.manifest import known_recordings

    lab = Lab(arguments.lab)
    check_annotation(arguments.recording, arguments.why)
    if arguments.recording not in known_recordings(lab):
        raise UsageError(
            f'there is no recording "{arguments.recording}" in this lab',
            remedy='`dealab sql "SELECT recording_id FROM recordings"` lists them',
        )
    annotate(lab, arguments.recording, arguments.command, arguments.why)
    done = "taken out of" if arguments.command == "exclude" else "taken back into"
    print(f"{arguments.recording} is {done} the analysis with the next nightly.")
    return _DONE


def _prune(arguments: argparse.Namespace) -> int:
    from pipeline.commands.prune import Rule, plan, prune

    rule = Rule(arguments.samples_days, arguments.quarantine_days, arguments.gone)
    found = (plan if arguments.dry_run else prune)(Lab(arguments.lab), rule)
    for part in found.parts:
        print(f"{part.what}: {part.number} files, {part.size / 1e6:.1f} MB")
    print("Nothing was removed." if arguments.dry_run else "Removed; the next nightly makes again what depends on it.")
    return _DONE


def _doctor(arguments: argparse.Namespace) -> int:
    from pipeline.commands.doctor import installation, lab_checks
    from pipeline.commands.show import safe

    lab = Lab(arguments.lab)
    findings = list(installation())
    if lab.folder.is_dir() or arguments.lab != Path(DEFAULT_LAB):
        findings += lab_checks(lab)
    for finding in findings:
        print(safe(str(finding)))
    return _FAILED if any(finding.problem for finding in findings) else _DONE


def _schema(_arguments: argparse.Namespace) -> int:
    from schemas.tables import reference
    from schemas.views import view_reference

    print(f"{reference()}\n{view_reference()}")
    return _DONE


def _completion(arguments: argparse.Namespace) -> int:
    from pipeline.commands.completion import script

    commands = {}
    for name, (what, _, words, _) in _COMMANDS.items():
        commands[name] = what, argparse.ArgumentParser(prog=f"dealab {name}")
        for add in words:
            add(commands[name][1])
    print(script(arguments.shell, commands), end="")
    return _DONE


def _schedule(arguments: argparse.Namespace) -> int:
    from pipeline.commands.schedule import Job, crontab, units

    job = Job(arguments.raw, arguments.lab, arguments.rigs, arguments.jobs, arguments.cluster)
    if arguments.cron:
        print(crontab(job, arguments.at), end="")
        return _DONE
    for name, text in units(job, arguments.at).items():
        if arguments.out is None:
            print(f"# {name}\n{text}")
        else:
            arguments.out.mkdir(parents=True, exist_ok=True)
            (arguments.out / name).write_text(text, encoding="utf-8")
            print(arguments.out / name)
    return _DONE


def _parser(wanted: str | None) -> argparse.ArgumentParser:
    """The parser; of the commands only the wanted one has its arguments, since building all of them takes a while."""
    parser = argparse.ArgumentParser(
        prog="dealab",
        description="Laboratory data pipeline for dielectric elastomer actuators: raw recordings in; models, survival, "
        "SQL and reports out.",
        epilog="examples:\n  dealab nightly raw/\n  dealab sql --examples\n  dealab inspect run7.csv\n\n"
        "exit status: 0 all done, 1 could not do it, 2 wrong usage, 3 done, but some recordings were refused or are damaged",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=Version, nargs=0, help="show the version and end")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (what, examples, arguments, run) in _COMMANDS.items():
        if name != wanted:
            commands.add_parser(name, help=what)
            continue
        added = commands.add_parser(
            name,
            help=what,
            description=f"{what[0].upper()}{what[1:]}.",
            epilog="examples:\n" + "\n".join(f"  dealab {name} {example}".rstrip() for example in examples),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for add in arguments:
            add(added)
        added.set_defaults(run=run)
    return parser


_LAB = argument("--lab", type=Path, default=Path(DEFAULT_LAB), metavar="LAB", help="the lab (default ./lab)")
_RAW = argument("raw", nargs="+", metavar="RAW", help="files, folders or URLs (s3://…) with recordings")
_CLUSTER = argument("--cluster", metavar="ADDRESS", help="dask scheduler whose workers do the work (tcp://host:8786)")
_RIGS = argument("--rigs", type=Path, help="folder with <rig_id>.toml (default: rigs/ beside the recordings)")
_RECORDING = argument("recording", metavar="RECORDING", help="its recording_id")
_REASON = argument("--why", required=True, metavar="TEXT", help="the reason, for those who come after")

_COMMANDS: Mapping[str, _Command] = {
    "nightly": (
        "the whole job over raw files and folders; what has not changed is not done again",
        ("raw/", "raw/ --lab /data/lab --jobs 8", "/mnt/rig1 /mnt/rig2 --rigs /data/rigs"),
        (
            _RAW,
            argument(
                "--jobs",
                type=jobs,
                default=processors(),
                help="worker processes; 0 works in this process (default: one per processor)",
            ),
            _RIGS,
            _CLUSTER,
            _LAB,
        ),
        _nightly,
    ),
    "sql": (
        "read-only SQL on the published database",
        (
            '"SELECT specimen_id, model_order FROM best_models"',
            '"SELECT * FROM survival_at(60)" --format csv > survival.csv',
            "\"SELECT time_ns, force FROM samples('RECORDING_ID')\" --format parquet > force.parquet",
            "--examples",
        ),
        (
            argument("query", nargs="?", metavar="QUERY", help='one SELECT; "-" reads it from standard input'),
            argument("--format", choices=_SQL_FORMATS, default="table", help="how rows are written (default: table)"),
            argument("--examples", action="store_true", help="questions people ask, with the queries that answer them"),
            _LAB,
        ),
        _sql,
    ),
    "report": ("rebuild the pages from the database alone", ("", "--lab /data/lab"), (_LAB,), _report),
    "diagnose": (
        "what the simulation gets wrong, the cause, and what mending it gains",
        ("", "VHB-03 VHB-04 --format json"),
        (
            argument("specimen", nargs="*", metavar="SPECIMEN", help="specimens (default: all)"),
            argument("--format", choices=("text", "json"), default="text"),
            _LAB,
        ),
        _diagnose,
    ),
    "simulate": (
        "the virtual rig: raw recordings of a described campaign",
        ("thesis --out raw", "controller --out raw", "campaign.toml --out raw --truth truth.json"),
        (
            argument(
                "campaign", metavar="CAMPAIGN", help="a campaign's TOML file, or the name of one that comes along"
            ),
            argument("--out", type=Path, required=True, metavar="RAW", help="folder for the recordings"),
            argument("--truth", type=Path, metavar="JSON", help="file for what is true behind the recordings"),
        ),
        _simulate,
    ),
    "inspect": (
        "what is in a recording, whether it fits, and what is wrong with it; writes nothing",
        ("run7.mcap", "run7.csv"),
        (argument("file", nargs="+", type=Path, metavar="FILE"), _RIGS),
        _inspect,
    ),
    "status": ("what is in the lab, what was refused and why, the last run", ("",), (_LAB,), _status),
    "exclude": (
        "take a recording out of the analysis; who, when and why is kept",
        ('VHB-03-chirp-1 --why "clamp was loose"',),
        (_RECORDING, _REASON, _LAB),
        _annotate,
    ),
    "include": (
        "take a recording back into the analysis; who, when and why is kept",
        ('VHB-03-chirp-1 --why "the clamp was not loose after all"',),
        (_RECORDING, _REASON, _LAB),
        _annotate,
    ),
    "prune": (
        "remove what the lab can do without: old samples, copies of refused files, recordings that have gone",
        ("--samples-days 365 --dry-run", "--gone --quarantine-days 90"),
        (
            argument("--samples-days", type=days, metavar="DAYS", help="samples of recordings measured earlier"),
            argument("--quarantine-days", type=days, metavar="DAYS", help="copies of files refused earlier"),
            argument("--gone", action="store_true", help="recordings whose raw file has gone, with their results"),
            argument("--dry-run", action="store_true", help="say what would go, remove nothing"),
            _LAB,
        ),
        _prune,
    ),
    "doctor": ("check the installation and the lab", ("", "--lab /data/lab"), (_LAB,), _doctor),
    "schedule": (
        "systemd units, or a line for cron, that run the nightly every night",
        (
            "/data/raw --lab /data/lab --at 02:30 --out ~/.config/systemd/user",
            "/data/raw --lab /data/lab --cron",
        ),
        (
            _RAW,
            argument("--at", default="02:00", metavar="HH:MM", help="when, local time (default 02:00)"),
            argument("--cron", action="store_true", help="a line for crontab instead of units for systemd"),
            argument("--out", type=Path, metavar="FOLDER", help="write the units there instead of showing them"),
            argument("--jobs", type=jobs, help="worker processes of the nightly (default: one per processor)"),
            _RIGS,
            _CLUSTER,
            _LAB,
        ),
        _schedule,
    ),
    "completion": (
        "completion of commands and options for a shell",
        ("bash > ~/.local/share/bash-completion/completions/dealab", "zsh > ~/.zfunc/_dealab", "fish | source"),
        (argument("shell", choices=("bash", "zsh", "fish"), help="the shell"),),
        _completion,
    ),
    "schema": (
        "the tables and views of the database, with units and meanings, in Markdown",
        ("> tables.md",),
        (),
        _schema,
    ),
}


if __name__ == "__main__":
    sys.exit(main())
