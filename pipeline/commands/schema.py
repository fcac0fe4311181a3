"""`dealab schema`: the tables and views of the database, with units and meanings."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, Command


def run(_arguments: Namespace) -> int:
    from schemas.tables import reference
    from schemas.views import view_reference

    print(f"{reference()}\n{view_reference()}")
    return DONE


COMMAND = Command(
    ("> tables.md",),
    (),
    run,
)
