"""`dealab report`: the pages again, from the database alone."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, LAB, Command
from pipeline.lab.lab import Lab


def run(arguments: Namespace) -> int:
    from reports.build import build_reports

    lab = Lab(arguments.lab)
    lab.require_database()
    lab.refuse_links()
    build_reports(lab.folder, force=True)
    print(f"Report: {lab.reports / 'index.html'}")
    return DONE


COMMAND = Command("report", "rebuild the pages from the database alone", ("", "--lab /data/lab"), (LAB,), run)
