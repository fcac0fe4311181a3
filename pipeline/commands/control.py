"""`dealab control`: controllers for a self-sensing specimen, designed on its fitted model, and what they would do."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, LAB, Command, argument, parse_number, parse_positive
from pipeline.lab.lab import Lab


def run(arguments: Namespace) -> int:
    import sys

    from pipeline.commands.show.controllers import ControlAsked, control_specimen

    asked = ControlAsked(
        **{name: value for name, value in vars(arguments).items() if name in ControlAsked.__dataclass_fields__}
    )
    text, aside = control_specimen(Lab(arguments.lab), asked, arguments.format)
    print(text)
    if aside:
        print(aside, file=sys.stderr)
    return DONE


COMMAND = Command(
    (
        "SS-1 --lab lab",
        "SS-1 --demand-pf -0.05 --force-overshoot 20",
        "SS-1 --filter-hz 30 --interval-ms 5 --lag-ms 8 --format csv",
    ),
    (
        argument("specimen", metavar="SPECIMEN", help="whose film is used"),
        argument(
            "--demand-pf", type=parse_number, metavar="X",
            help="step of the capacitance, as a voltage changes it (default: half the largest voltage holds it)",
        ),
        argument(
            "--force-overshoot", type=parse_positive, metavar="PERCENT", default=10.0,
            help="by how much the force of the gentle ones may overshoot (default: 10)",
        ),
        argument(
            "--largest-kv", type=parse_positive, metavar="X", help="largest voltage (default: that of its steps)"
        ),
        argument("--lag-ms", type=parse_positive, metavar="X", default=20.0, help="of the amplifier (default: 20)"),
        argument(
            "--filter-hz", type=parse_positive, metavar="X", default=10.0,
            help="of the capacitance before the controller (default: 10)",
        ),
        argument(
            "--interval-ms", type=parse_positive, metavar="X", default=20.0,
            help="from one decision to the next (default: 20)",
        ),
        argument("--format", choices=("text", "csv", "json"), default="text"),
        LAB,
    ),
    run,
)  # fmt: skip
