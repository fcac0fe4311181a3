"""`dealab report`: the pages again, from the database alone, without a script or with one."""

from __future__ import annotations

import sys
from argparse import Namespace

from pipeline.commands.command import DONE, FAILED, LAB, Command, argument
from pipeline.lab.lab import Lab
from schemas.visible import make_safe


def run(arguments: Namespace) -> int:
    from reports.build import build_reports

    lab = Lab(arguments.lab)
    lab.require_database()
    lab.refuse_links()
    problems = build_reports(lab.folder, force=True, interactive=arguments.interactive).describe_problems()
    print(f"Report: {lab.reports / 'index.html'}")
    if problems is None:
        return DONE
    print(f"dealab: the report is not whole: {make_safe(problems)}", file=sys.stderr)
    return FAILED


COMMAND = Command(
    ("", "--lab /data/lab", "--interactive"),
    (
        LAB,
        argument(
            "--interactive",
            action="store_true",
            help="with a script of ours in each page, no network: tables that sort and filter, a search, values under"
            " the pointer, zoom, specimens laid over each other; the nights that follow keep it until a report"
            " without it",
        ),
    ),
    run,
)
