"""`dealab exclude`: takes a recording out of the analysis; both ways are in `annotate`."""

from __future__ import annotations

from pipeline.commands.annotate import make_command

COMMAND = make_command('VHB-03-chirp-1 --why "clamp was loose"')
