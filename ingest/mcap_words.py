"""Damage of MCAP files in words. Does not belong here: finding it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

_SHOWN = 5


@dataclass(frozen=True)
class Loss:
    """A chunk of which something is lost, by default all. `first_ns`, `last_ns`: what its head says, if readable."""

    offset: int
    reason: str
    first_ns: int | None = None
    last_ns: int | None = None
    whole: bool = True


def losses_in_words(losses: Iterable[Loss]) -> list[str]:
    """A sentence for each reason: how many chunks, where in the file, and which time they cover."""
    by_reason: dict[tuple[bool, str], list[Loss]] = defaultdict(list)
    for loss in losses:
        by_reason[loss.whole, loss.reason].append(loss)
    told = []
    for (whole, reason), alike in by_reason.items():
        places = ", ".join(str(loss.offset) for loss in alike[:_SHOWN]) + (", …" if alike[_SHOWN:] else "")
        text = f"{plural(len(alike), 'chunk')} {'left out' if whole else 'read in part'}: {reason} (at byte {places})"
        firsts = [loss.first_ns for loss in alike if loss.first_ns is not None]
        lasts = [loss.last_ns for loss in alike if loss.last_ns is not None]
        if firsts and lasts:
            text += f"; lost is what was recorded from {iso(min(firsts))} to {iso(max(lasts))}"
        told.append(text)
    return told


def iso(time_ns: int) -> str:
    """A Unix time in ns as ISO 8601 text to the millisecond, UTC."""
    if not -(2**63) < time_ns < 2**63:
        return "an impossible time"
    return f"{np.datetime_as_string(np.datetime64(time_ns, 'ns'), unit='ms')}Z"


def plural(number: int, noun: str) -> str:
    """`1 block`, `2 blocks`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
