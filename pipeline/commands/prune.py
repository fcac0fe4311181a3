"""`dealab prune`: what a lab can do without, removed by rules."""

from __future__ import annotations

import argparse

from pipeline.commands.command import DONE, LAB, Command, argument
from pipeline.lab.lab import Lab


def run(arguments: argparse.Namespace) -> int:
    from pipeline.lab.retention import Rule, plan_removal, prune

    rule = Rule(arguments.samples_days, arguments.quarantine_days, arguments.gone)
    found = (plan_removal if arguments.dry_run else prune)(Lab(arguments.lab), rule)
    for part in found.parts:
        print(f"{part.what}: {part.number} files, {part.size / 1e6:.1f} MB")
    print("Nothing was removed." if arguments.dry_run else "Removed; the next nightly makes again what depends on it.")
    return DONE


def _parse_days(text: str) -> float:
    if not text.isdecimal() or int(text) > 36_500:
        raise argparse.ArgumentTypeError(f'"{text}" is not a number of days')
    return int(text)


COMMAND = Command(
    ("--samples-days 365 --dry-run", "--gone --quarantine-days 90"),
    (
        argument("--samples-days", type=_parse_days, metavar="DAYS", help="samples of recordings measured earlier"),
        argument("--quarantine-days", type=_parse_days, metavar="DAYS", help="copies of files refused earlier"),
        argument("--gone", action="store_true", help="recordings whose raw file has gone, with their results"),
        argument("--dry-run", action="store_true", help="say what would go, remove nothing"),
        LAB,
    ),
    run,
)
