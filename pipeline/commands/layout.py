"""`dealab layout`: electrodes for a film over rods that would live longer at the same force, as SVG and CSV."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, LAB, Command, argument, parse_path
from pipeline.lab.lab import Lab


def run(arguments: Namespace) -> int:
    from pipeline.commands.show.layouts import show_layout

    print(show_layout(Lab(arguments.lab), arguments.configuration, arguments.design, arguments.out))
    return DONE


COMMAND = Command(
    (
        '"case 3: divided electrode, contact outside" --lab lab',
        '"case 3: divided electrode, contact outside" --design rectangles --out electrodes.svg',
    ),
    (
        argument("configuration", metavar="CONFIGURATION", help="whose film is used"),
        argument("--design", choices=("shaped", "rectangles"), default="shaped", help="(default: shaped)"),
        argument("--out", type=parse_path, metavar="SVG", help="file for the outlines in mm, a CSV beside it"),
        LAB,
    ),
    run,
)
