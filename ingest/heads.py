"""Names that stand in two rows above a table: a group over several columns, as under cells that are merged, and what each column is in it.

A guess for drafts alone. Does not belong here: a row of units below the names (`ingest.sniff.are_units`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

_WITH_UNIT = re.compile(r"(?P<name>.*?)\s*(?P<unit>[\[(][^\[\]()]*[\])])")


def join_heads(upper: Sequence[str], lower: Sequence[str]) -> list[str]:
    """The full names of columns whose groups stand one row above them; empty where the lower row has names enough of its own.

    Parameters
    ----------
    upper, lower : the cells of two rows, one right below the other
    """
    above = [" ".join(cell.split()) for cell in upper] + [""] * (len(lower) - len(upper))
    below = [" ".join(cell.split()) for cell in lower] + [""] * (len(upper) - len(lower))
    named = [i for i, name in enumerate(below) if name]
    lacks = any(over and not under for over, under in zip(above, below, strict=True))
    groups = [i for i in named if not above[i]]
    if len(named) < 2 or not lacks or not groups:
        return []  # each column has a name of its own in the lower row, or none of them stands under a group
    names, group = [], ""
    for over, under in zip(above, below, strict=True):
        group = over or (group if under else "")
        names.append(_join(under, group))
    return names


def _join(name: str, group: str) -> str:
    """`Laufzeit [h]` under `Versuch` is `Laufzeit Versuch [h]`: a unit stands last, where it is looked for."""
    match = _WITH_UNIT.fullmatch(name)
    return f"{name} {group}".strip() if match is None else f"{match['name']} {group} {match['unit']}".replace("  ", " ")
