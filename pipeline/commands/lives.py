"""`dealab lives`: what the lives of a campaign depend on, with limits by simulation beside those of the likelihood."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, LAB, Command, argument, parse_count
from pipeline.lab.lab import Lab


def run(arguments: Namespace) -> int:
    from pipeline.commands.show.lives import show_lives

    print(show_lives(Lab(arguments.lab), arguments.campaign, arguments.draws, arguments.seed))
    return DONE


COMMAND = Command(
    ("ageing --lab lab", "ageing --lab lab --draws 5000"),
    (
        argument("campaign", metavar="CAMPAIGN", help="whose lives are meant"),
        argument("--draws", type=parse_count, metavar="N", default=1000, help="simulated tests (default: 1000)"),
        argument("--seed", type=parse_count, metavar="N", default=1, help="of the simulation (default: 1)"),
        LAB,
    ),
    run,
)
