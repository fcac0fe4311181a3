"""`dealab doctor`: is this the software it should be, and is the lab whole?"""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, FAILED, LAB, Command
from pipeline.lab.lab import DEFAULT_LAB, Lab


def run(arguments: Namespace) -> int:
    from pathlib import Path

    from pipeline.lab.installation import Finding, check_installation, list_lacking
    from schemas.visible import make_safe

    lab = Lab(arguments.lab)
    findings = list(check_installation())
    if list_lacking():
        findings.append(Finding("the lab is whole", "not looked at without these libraries"))
    elif lab.folder.is_dir() or arguments.lab != Path(DEFAULT_LAB):
        from pipeline.lab.health import check_lab

        findings += check_lab(lab)
    for finding in findings:
        print(make_safe(str(finding)))
    return FAILED if any(finding.problem for finding in findings) else DONE


COMMAND = Command(("", "--lab /data/lab"), (LAB,), run)
