"""`dealab simulate`: the virtual rig, and what a study of controllers found where the campaign is one."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import Command, argument, parse_path


def run(arguments: Namespace) -> int:
    from pipeline.commands.show.controller import ControllerStudy
    from pipeline.simulate.write import simulate_command

    study = ControllerStudy()
    status = simulate_command(
        arguments.campaign, arguments.out, arguments.truth, study.add, blind=arguments.blind, night=arguments.night
    )
    if study.text:
        print(f"\n{study.text}")
    return status


COMMAND = Command(
    (
        "thesis --out raw",
        "demo --out raw --night 1",
        "controller --out raw",
        "campaign.toml --out raw --truth truth.json",
        "thesis --out exam/raw --truth answers.json --blind",
    ),
    (
        argument("campaign", metavar="CAMPAIGN", help="a campaign's TOML file, or the name of one that comes along"),
        argument("--out", type=parse_path, required=True, metavar="RAW", help="folder for the recordings"),
        argument("--truth", type=parse_path, metavar="JSON", help="file for what is true behind the recordings"),
        argument(
            "--night",
            type=int,
            metavar="N",
            help="only what the campaign has recorded before its Nth night, beside the nights before",
        ),
        argument(
            "--blind",
            action="store_true",
            help="draw names, order and noise: nothing but the recordings tells what is hidden; with --truth",
        ),
    ),
    run,
)
