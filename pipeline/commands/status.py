"""`dealab status`: what is in a lab, what was refused and why, the last run."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, LAB, Command
from pipeline.lab.lab import Lab


def run(arguments: Namespace) -> int:
    from pipeline.commands.show.status import describe_lab

    print(describe_lab(Lab(arguments.lab)))
    return DONE


COMMAND = Command(("",), (LAB,), run)
