"""`dealab diagnose`: the published diagnoses, in words or for a program."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, LAB, Command, argument
from pipeline.lab.lab import Lab


def run(arguments: Namespace) -> int:
    from pipeline.commands.show.diagnoses import describe_diagnoses

    print(describe_diagnoses(Lab(arguments.lab), arguments.specimen, as_json=arguments.format == "json"))
    return DONE


COMMAND = Command(
    ("", "VHB-03 VHB-04 --format json"),
    (
        argument("specimen", nargs="*", metavar="SPECIMEN", help="specimens (default: all)"),
        argument("--format", choices=("text", "json"), default="text"),
        LAB,
    ),
    run,
)
