"""`dealab exclude` and `dealab include`: a recording taken out of the analysis, or back in, with the reason."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, LAB, Command, argument
from pipeline.lab.lab import Lab
from schemas.alike import ask_meant
from schemas.errors import UsageError

_ARGUMENTS = (
    argument("recording", metavar="RECORDING", help="its recording_id"),
    argument("--why", required=True, metavar="TEXT", help="the reason, for those who come after"),
    LAB,
)


def run(arguments: Namespace) -> int:
    from pipeline.lab.annotations import EXCLUDE, annotate, check_annotation
    from pipeline.lab.reader import Reader

    lab = Lab(arguments.lab)
    check_annotation(arguments.recording, arguments.why)
    with Reader(lab.require_database()) as reader:
        known = {row["recording_id"] for row in reader.rows("recordings", ("recording_id",))}
    if arguments.recording not in known:
        meant = ask_meant(arguments.recording, sorted(filter(None, known)))
        raise UsageError(
            f'there is no recording "{arguments.recording}" in this lab{meant}',
            remedy=lab.spell_command('sql "SELECT recording_id FROM recordings"') + " lists them",
        )
    annotate(lab, arguments.recording, arguments.command, arguments.why)
    done = "taken out of" if arguments.command == EXCLUDE else "taken back into"
    print(f"{arguments.recording} is {done} the analysis with the next nightly.")
    return DONE


def make_command(example: str) -> Command:
    """The command of one of the two, with an example of what follows its name."""
    return Command((example,), _ARGUMENTS, run)
