"""`dealab include`: takes a recording back into the analysis; both ways are in `annotate`."""

from __future__ import annotations

from pipeline.commands.annotate import make_command

COMMAND = make_command('VHB-03-chirp-1 --why "the clamp was not loose after all"')
