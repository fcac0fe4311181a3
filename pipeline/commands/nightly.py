"""`dealab nightly`: the whole job over raw files and folders."""

from __future__ import annotations

import sys
from argparse import Namespace

from pipeline.commands.command import CLUSTER, LAB, RAW, RIGS, Command, Progress, argument, count_processors, parse_jobs
from pipeline.lab.lab import Lab


def run(arguments: Namespace) -> int:
    from pipeline.nightly.look import NothingFoundError
    from pipeline.nightly.night import nightly
    from schemas.visible import make_safe

    lab = Lab(arguments.lab)
    try:
        with Progress() as progress:
            summary = nightly(
                arguments.raw,
                lab,
                jobs=arguments.jobs,
                rigs=arguments.rigs,
                cluster=arguments.cluster,
                track=progress.track,
            )
    except NothingFoundError as nothing:
        for line in nothing.lines:
            print(make_safe(line), file=sys.stderr)
        raise
    for line in (*summary.notes, *summary.attention, *summary.without_result):
        print(make_safe(line), file=sys.stderr)
    if summary.without_result:
        number = len(summary.without_result)
        led = "1 recording or table" if number == 1 else f"{number} recordings and tables"
        print(f"dealab: {led} led to no result; what was missing is said above", file=sys.stderr)
    if summary.report_problem is not None:
        print(f"dealab: the report is not whole: {make_safe(summary.report_problem)}", file=sys.stderr)
    print(summary.paragraph())
    print(f"Database: {lab.database}")
    print(f"Report:   {lab.reports / 'index.html'}")
    return summary.exit_status


COMMAND = Command(
    ("raw/", "raw/ --lab /data/lab --jobs 8", "/mnt/rig1 /mnt/rig2 --rigs /data/rigs"),
    (
        RAW,
        argument(
            "--jobs",
            type=parse_jobs,
            default=count_processors(),
            help="worker processes; 0 works in this process (default: one per processor)",
        ),
        RIGS,
        CLUSTER,
        LAB,
    ),
    run,
)
