"""`dealab plan lifetimes`: how many specimens, at which voltages, how long; when to stop; how many tell designs
apart.
"""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, LAB, Argument, Command, argument, parse_count, parse_number
from pipeline.lab.lab import Lab
from schemas.errors import UsageError


def run(arguments: Namespace) -> int:
    from pipeline.commands.show.life_plans import Asked, plan_lifetimes

    asked = Asked(**{name: value for name, value in vars(arguments).items() if name in Asked.__dataclass_fields__})
    lab = Lab(arguments.lab) if arguments.campaign is not None else None
    if lab is not None and (arguments.at_kv or arguments.median_h or arguments.exponent):
        raise UsageError(
            "--campaign together with --at-kv, --median-h or --exponent",
            expected="lives that are known, or lives that are assumed",
        )
    print(plan_lifetimes(asked, lab, as_json=arguments.format == "json"))
    return DONE


def _number(name: str, what: str, default: float | None = None) -> Argument:
    return argument(name, type=parse_number, metavar="X", default=default, help=what)


COMMAND = Command(
    (
        "lifetimes --campaign ageing --lab lab --use-kv 3",
        "lifetimes --use-kv 3 --at-kv 6 --median-h 10 --exponent -10 --shape 2 --to-kv 8 --longest-h 200 --hours 3000",
        "lifetimes --at-kv 6 --median-h 10 --exponent -10 --shape 2 --longest-h 40 --ratio 2 --power 0.9 --looks 3",
    ),
    (
        argument("what", choices=("lifetimes",), help="what is planned"),
        argument("--campaign", metavar="NAME", help="plan on what the lives of this campaign in the lab tell"),
        argument(
            "--configuration", metavar="NAME", help="which of the campaign's configurations (default: the only one)"
        ),
        _number("--use-kv", "voltage in use, whose life is asked for"),
        _number("--failed-share", "share failed at that life (default: 0.5, the median)", 0.5),
        _number("--at-kv", "without a campaign: a voltage whose life is roughly known"),
        _number("--median-h", "median life there in h"),
        _number("--median-factor", "the true one lies within this factor with 68 %% (default: 1.5)", 1.5),
        _number("--exponent", "of the inverse power law, such as -10"),
        _number("--exponent-sd", "its standard deviation (default: 1)", 1.0),
        _number("--shape", "Weibull shape of the lives (default: 2)", 2.0),
        _number("--shape-factor", "the true one lies within this factor with 68 %% (default: 1.5)", 1.5),
        _number("--from-kv", "lowest voltage that can be tested (default: that in use)"),
        _number("--to-kv", "highest voltage at which specimens fail as they do in use"),
        _number("--longest-h", "longest test of a specimen in h"),
        _number("--setup-h", "h of the rig that a specimen costs beside its test (default: 0.25)", 0.25),
        _number("--hours", "budget of rig hours (default: with a campaign, as many again)"),
        argument("--most-specimens", type=parse_count, metavar="N", help="no more specimens than this"),
        _number("--limits-ratio", "in place of a budget: wanted ratio of the upper to the lower 95 %% limit"),
        _number("--ratio", "how many specimens tell two designs apart whose lives differ by this factor"),
        _number("--power", "probability to find that difference (default: 0.8)", 0.8),
        argument("--looks", type=parse_count, metavar="N", default=1, help="looks that may end that comparison early"),
        argument("--format", choices=("text", "json"), default="text"),
        LAB,
    ),
    run,
)
