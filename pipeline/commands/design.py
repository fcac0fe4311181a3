"""`dealab design`: what an actuator of a fitted film would do, and which actuator would do what is asked for."""

from __future__ import annotations

from argparse import ArgumentTypeError, Namespace

from pipeline.commands.command import DONE, LAB, Argument, Command, argument, parse_count, parse_number, parse_positive
from pipeline.lab.lab import Lab


def run(arguments: Namespace) -> int:
    import sys

    from pipeline.commands.show.designs import DesignAsked, design_actuator

    asked = DesignAsked(
        **{name: value for name, value in vars(arguments).items() if name in DesignAsked.__dataclass_fields__}
    )
    text, aside = design_actuator(Lab(arguments.lab), asked, arguments.format)
    print(text)
    if aside:
        print(aside, file=sys.stderr)
    return DONE


def parse_sizes(text: str) -> tuple[float, ...]:
    """Numbers above 0, separated by commas, from the command line."""
    return tuple(parse_positive(part) for part in text.split(","))


def parse_percent(text: str) -> float:
    """A share from 0 to 100 % from the command line, as a number from 0 to 1."""
    value = parse_number(text)
    if not 0 <= value <= 100:
        raise ArgumentTypeError(f'"{text[:40]}" is not from 0 to 100')
    return value / 100


def _size(name: str, what: str) -> Argument:
    return argument(name, type=parse_positive, metavar="X", help=what)


COMMAND = Command(
    (
        "PA-1 --lab lab",
        "PA-1 --voltage-kv 5 --thickness-mm 0.25 --length-mm 60 --width-mm 40 --layers 8 --strips 3 --mass-g 2",
        "PA-1 --require force=0.4N,stroke=1mm,bandwidth=10Hz --thickness-mm 0.1,0.25,0.5",
    ),
    (
        argument("specimen", metavar="SPECIMEN", help="whose film is used"),
        _size("--voltage-kv", "across each layer; with --require the highest (default: the highest that it had)"),
        _size("--length-mm", "stretched length of a strip between its clamps (default: the specimen's)"),
        _size("--width-mm", "stretched width of a strip (default: the specimen's)"),
        argument(
            "--thickness-mm", type=parse_sizes, metavar="X[,X…]",
            help="undeformed thickness of a layer; with --require several to choose from (default: the specimen's)",
        ),
        _size("--stretch", "pre-stretch along the film (default: the specimen's)"),
        _size("--stretch-2", "pre-stretch across, held (default: as the specimen's, which may have free sides)"),
        _size("--active-length-mm", "stretched length of the electrode (default: with new sizes, all of the film)"),
        _size("--active-width-mm", "stretched width of the electrode (default: with new sizes, all of the film)"),
        argument("--layers", type=parse_count, metavar="N", help="layers side by side (default: the specimen's)"),
        argument("--strips", type=parse_count, metavar="N", default=1, help="strips behind each other (default: 1)"),
        argument(
            "--mass-g", type=parse_positive, metavar="X", default=0.0,
            help="mass that moves with the end (default: none)",
        ),
        argument(
            "--modulus-scatter", type=parse_percent, metavar="PERCENT", default=0.0,
            help="standard deviation of stiffness from film to film (default: 0, this film)",
        ),
        argument(
            "--thickness-scatter", type=parse_percent, metavar="PERCENT", default=0.0,
            help="standard deviation of thickness from film to film (default: 0)",
        ),
        _size("--breakdown-mv-per-m", "field at breakdown (default: of films of this material that broke down here)"),
        argument("--require", metavar="LIST", help="search for sizes: force=0.4N,stroke=1mm,bandwidth=10Hz"),
        argument("--most-layers", type=parse_count, metavar="N", default=400, help="with --require (default: 400)"),
        argument("--most-strips", type=parse_count, metavar="N", default=400, help="with --require (default: 400)"),
        argument("--format", choices=("text", "csv", "json"), default="text"),
        LAB,
    ),
    run,
)  # fmt: skip
