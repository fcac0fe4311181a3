"""Whose a recording is that a diagnosis finds to be of another specimen: the specimens of the lab whose response it has.

Does not belong here: that it is foreign, which the diagnosis finds of the specimen's own recordings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from reports.evidence import Measured, measured
from reports.figures.responses import Lines
from reports.names import short
from reports.results import Query, Results
from schemas.mechanisms import FOREIGN
from schemas.numbers import digits, joined, percent

_FEWEST = 5
"""Lines that a recording and a specimen must have in common to be compared."""
_AS_NEAR = 2.0
"""How many times as far as a specimen's own recordings, or as noise alone, one may be off that is still its own."""


def find_owners(results: Results, where: Query) -> dict[str, str]:
    """By specimen, of those `where` they are, whose its foreign recordings may be, in a sentence each; without those that have none."""
    rows = results.rows(
        Query(
            "SELECT DISTINCT specimen_id, recording_id FROM corrections"
            f" WHERE cause = '{FOREIGN}' AND {where.sql} ORDER BY ALL",
            where.parameters,
        )
    )
    if not rows:
        return {}
    responses = {
        r["specimen_id"]: measured(results, r["specimen_id"], "mechanical") for r in results.rows(_MEASURED_SQL)
    }
    said: dict[str, list[str]] = {}
    for row in rows:
        said.setdefault(row["specimen_id"], []).append(_tell(responses, row["specimen_id"], row["recording_id"]))
    return {specimen: text for specimen, texts in said.items() if (text := " ".join(filter(None, texts)))}


def _tell(responses: Mapping[str, Measured], specimen: str, recording: str) -> str:
    own = responses.get(specimen)
    lines = None if own is None else _own(own, recording)
    if lines is None:
        return ""
    distances = {
        name: d for name, other in responses.items() if name != specimen and (d := _compare(lines, other)) is not None
    }
    near = sorted((n for n, (off, own) in distances.items() if off <= _AS_NEAR * own), key=lambda n: distances[n])
    if not near:
        return ""
    names = joined([f"{short(n, 40)} (within {percent(distances[n][0])})" for n in near])
    if len(near) > 1:
        return f"{short(recording, 60)} has the response of {names}; its response does not tell of which."
    asked = digits(len(distances), "other specimen")
    return f"{short(recording, 60)} has the response of {names}; of the {asked} here with such lines no other has it."


_MEASURED_SQL = """SELECT DISTINCT specimen_id
FROM frequency_responses
WHERE loading = 'mechanical' AND specimen_id IS NOT NULL
ORDER BY specimen_id"""


def _own(found: Measured, recording: str) -> Lines | None:
    """The film's response as one recording has it: corrected where it was."""
    return next((lines for stage in ("corrected", "measured") if (lines := found.stage(stage).get(recording))), None)


def _compare(lines: Lines, of: Measured) -> tuple[float, float] | None:
    """How far a response is from a specimen's, root mean square of the relative difference, and how far one of its own would be.

    None where they have too few lines in common.
    """
    film = of.film
    if film is None:
        return None
    off = _distance(lines, film)
    if off is None:
        return None
    own = [_own(of, name) for _, name in of.by_recording]
    apart = [d[0] for one in own if one is not None and (d := _distance(one, film)) is not None]
    return off[0], math.hypot(float(np.median(apart)) if apart else 0.0, off[1])


def _distance(lines: Lines, film: Lines) -> tuple[float, float] | None:
    """Root mean square relative difference over the lines in common, and what the noise of `lines` makes of it."""
    good = film.usable
    if good.sum() < 2:
        return None
    f, value = film.frequency[good], film.value[good]
    common = lines.usable & (lines.frequency >= f.min() * _EDGE) & (lines.frequency <= f.max() / _EDGE)
    if common.sum() < max(_FEWEST, lines.usable.sum() / 2):
        return None
    at = np.log(lines.frequency[common])
    expected = np.interp(at, np.log(f), value.real) + 1j * np.interp(at, np.log(f), value.imag)
    size = np.abs(expected)
    difference = np.abs(lines.value[common] - expected) / size
    noise = np.nan_to_num(lines.component[common]) / size
    return float(np.sqrt(np.mean(difference**2))), float(np.sqrt(2 * np.mean(noise**2)))


_EDGE = 1 - 1e-6
"""Lines at the end of a band are within it."""
