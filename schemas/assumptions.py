"""What is taken for granted about a recording where nothing says it, as every package passes it on."""

from __future__ import annotations

from dataclasses import dataclass

BETWEEN_SAMPLES = "input between its samples"
"""What the diagnosis of a system assumes, which no analysis of a recording alone does."""


@dataclass(frozen=True)
class Assumption:
    """One thing that was taken for granted.

    Parameters
    ----------
    what : is assumed, a noun: "pre-stretch across the force"
    value : that it is taken to have, with its unit
    because : what is missing, or why it cannot be known
    touches : results that would be others if it were wrong
    """

    what: str
    value: str
    because: str
    touches: str


def assume_campaign(value: str) -> Assumption:
    """The campaign, in words, of lives that name none."""
    return Assumption("campaign", value, "no campaign", "which lives are compared and stand on one page")
