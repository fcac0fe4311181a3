"""`dealab doctor`: is this the software it should be, and is the lab whole?"""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, FAILED, LAB, Command
from pipeline.lab.lab import DEFAULT_LAB, Lab


def run(arguments: Namespace) -> int:
    from pathlib import Path

    from pipeline.commands.show.rows import make_safe
    from pipeline.lab.health import check_installation, check_lab

    lab = Lab(arguments.lab)
    findings = list(check_installation())
    if lab.folder.is_dir() or arguments.lab != Path(DEFAULT_LAB):
        findings += check_lab(lab)
    for finding in findings:
        print(make_safe(str(finding)))
    return FAILED if any(finding.problem for finding in findings) else DONE


COMMAND = Command("doctor", "check the installation and the lab", ("", "--lab /data/lab"), (LAB,), run)
