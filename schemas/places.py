"""Which places of a diagnosis are beyond the noise: one rule for what is stated, printed and listed on pages.

A place is a band, a span of time, a level or a part of a record. Where many are asked, noise makes one of them look wrong now and
then: the probability of the worst counts as often as there are places (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

SIGN = "sign"
"""`discrepancies.where_found` of a stiffness or an actuation that comes out negative: no place of a diagnosis, and never noise."""
LEVEL = 0.01
"""Probability that the noise makes one of all places as wrong, below which a place is beyond the noise."""
WITHIN = "simulated within the noise"
"""How a statement says that its place is not."""


def is_beyond_noise(p_value: float | None, count: int) -> bool:
    """Whether a place is wrong by more than the noise makes of one of so many.

    Parameters
    ----------
    p_value : of the place under the noise alone; None where it is not known
    count : places that were asked
    """
    return p_value is not None and p_value * count < LEVEL


def list_wrong(rows: Sequence[Mapping[str, Any]], verdict: str | None) -> list[Mapping[str, Any]]:
    """Rows of `discrepancies` of a specimen that are beyond the noise.

    None of them is where the verdict is `none`: what the whole is within, no part of it is beyond.

    Parameters
    ----------
    rows : of one specimen, all of them
    verdict : of its diagnosis; None where it has none
    """
    asked = [r for r in rows if r["where_found"] != SIGN]
    told = verdict not in (None, "none")
    return [r for r in asked if told and is_beyond_noise(r["p_value"], len(asked))]


def list_negative(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Rows of `discrepancies` that say that something came out negative.

    Parameters
    ----------
    rows : of one specimen, all of them
    """
    return [r for r in rows if r["where_found"] == SIGN]
