"""Why the voltage fell: probabilities of four causes from what the record shows around the fall.

A multinomial logistic model: each outcome of each piece of evidence adds its log odds, evidence that a record lacks adds
nothing. Belongs here: the weights and the arithmetic. Does not belong here: how outcomes are found
(`breakdown_evidence`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from schemas.numbers import fixed

FAILED, SWITCHED_OFF, SUPPLY, MONITOR = "failed", "switched off", "supply", "monitor"
CAUSES = (FAILED, SWITCHED_OFF, SUPPLY, MONITOR)
CERTAIN = 0.9
"""A verdict is one from this probability on; between it and its complement the record does not decide."""


@dataclass(frozen=True)
class Weight:
    """Log odds that one outcome adds to each of `CAUSES`, and how it is said."""

    evidence: str
    outcome: str
    says: str
    odds: tuple[float, float, float, float]


PRIOR = (2.2, -0.5, 0.0, -1.7)
"""Log odds of `CAUSES` before any evidence."""
WEIGHTS = (
    Weight("fall", "spark", "the voltage falls faster than any discharge", (1.4, -1.0, -2.4, 2.0)),
    Weight("fall", "in one step", "the voltage falls within one step of a fast clock", (2.2, -0.5, -1.3, -0.4)),
    Weight("fall", "in one step of some ms to zero", "the voltage falls to zero within one step of some ms", (0.3, -1.0, -1.6, 2.3)),
    Weight("fall", "in one step of some ms to a rest", "the voltage falls within one step of some ms, to a voltage that stays", (1.3, -0.1, -1.5, 0.3)),
    Weight("fall", "in one slow step to zero", "the voltage falls to zero within one step of a clock as slow as discharges", (0.0, 0.0, -1.0, 0.9)),
    Weight("fall", "in one slow step to a rest", "the voltage falls within one step of a clock as slow as discharges, to a voltage that stays", (1.6, -0.4, -2.2, 1.1)),
    Weight("fall", "between slow samples to zero", "the voltage falls to zero between two samples", (-0.7, 0.6, -0.2, 0.3)),
    Weight("fall", "between slow samples to a rest", "the voltage falls between two samples to a voltage that stays", (0.0, -1.1, 1.0, 0.0)),
    Weight("fall", "short discharge to zero", "it decays to zero within 20 ms, as through a resistor", (-0.8, 1.9, 0.6, -1.7)),
    Weight("fall", "long discharge to zero", "it decays to zero as through a resistor", (-4.7, 3.1, 2.5, -0.9)),
    Weight("fall", "slow discharge to zero", "it decays to zero more slowly than through a resistor", (-1.9, 2.0, 0.7, -0.8)),
    Weight("fall", "short discharge to a rest", "it decays within 20 ms to a voltage that stays", (1.8, 0.0, -1.3, -0.5)),
    Weight("fall", "long discharge to a rest", "it decays like a discharge, to a voltage above zero", (-0.4, -0.4, 1.9, -1.1)),
    Weight("fall", "fast", "it falls within 20 ms, not like a discharge", (0.5, -1.7, 1.6, -0.3)),
    Weight("fall", "slow", "it falls slowly", (0.4, -1.3, 3.2, -2.3)),
    Weight("fall", "slow, then at once", "it falls slowly and then at once, as no discharge does", (2.6, -1.8, 1.9, -2.7)),
    Weight("after", "zero", "nothing is left of it", (-0.7, 1.3, 0.0, -0.6)),
    Weight("after", "holds", "it holds at a lower voltage", (0.6, -1.9, 0.3, 1.0)),
    Weight("after", "hunts", "it goes up and down far below its level, recharged again and again", (2.4, -0.5, -1.8, -0.1)),
    Weight("after", "falls on", "it goes on falling", (0.0, 1.3, 0.4, -1.6)),
    Weight("after", "comes back in part", "it comes back in part", (-0.5, -0.1, -0.4, 1.0)),
    Weight("after", "back", "it comes back in full", (-0.1, -1.7, -0.5, 2.3)),
    Weight("after", "sagged and back", "it sags slowly and comes back in full", (-1.5, -0.2, 1.9, -0.2)),
    Weight("after", "not seen", "the record ends in the fall", (0.0, 1.7, 0.2, -1.9)),
    Weight("command", "on", "the command stays on", (1.6, -5.0, 1.8, 1.6)),
    Weight("command", "off first", "the command fell first", (0.6, 3.5, -3.2, -0.9)),
    Weight("command", "off at once", "the command fell in the same sample", (1.3, 2.7, -3.0, -1.0)),
    Weight("command", "off after", "the command fell after the voltage", (2.4, -1.1, -0.6, -0.8)),
    Weight("leakage_current", "jumps", "the leakage current jumps", (3.8, -1.5, -0.3, -2.0)),
    Weight("leakage_current", "spikes", "a spark of current at the fall", (3.4, -1.7, -1.3, -0.4)),
    Weight("leakage_current", "stays high", "the leakage current had risen and stays", (2.8, -0.7, -1.6, -0.5)),
    Weight("leakage_current", "follows the voltage", "the leakage current falls with the voltage", (-1.4, 1.6, 2.0, -2.3)),
    Weight("leakage_current", "follows the voltage, slowly sampled", "the leakage current, slowly sampled, falls with the voltage", (-0.4, 1.4, 1.5, -2.4)),
    Weight("leakage_current", "goes on", "the leakage current goes on as if nothing had happened", (-0.9, -1.3, -2.1, 4.4)),
    Weight("leakage_current", "goes on at less voltage", "the leakage current stays although the voltage is lower", (-1.9, 0.0, -1.0, 2.9)),
    Weight("leakage_current", "shows nothing", "no jump of the leakage current", (-3.2, 1.0, 1.5, 0.7)),
    Weight("leakage_current", "shows nothing, slowly sampled", "no jump of the leakage current, slowly sampled", (-1.8, 0.3, 0.6, 1.0)),
    Weight("force", "steps", "the force steps", (1.2, 1.0, 1.3, -3.6)),
    Weight("force", "still", "the force stays where the voltage had put it", (-1.1, -1.6, -0.5, 3.1)),
    Weight("force", "silent", "the force never answered to the voltage", (1.1, -1.0, -0.5, 0.3)),
    Weight("failure_site", "a place", "somebody wrote down where it failed", (2.8, -1.1, -0.8, -0.9)),
    Weight("failure_site", "none", "somebody wrote down that it did not fail", (-2.5, 1.0, 0.8, 0.7)),
    Weight("planned end", "reached", "the planned time was over", (-0.9, 4.8, -3.0, -0.9)),
    Weight("planned end", "raised", "the voltage had been raised beyond its set point", (1.1, 1.4, -4.3, 1.8)),
    Weight("planned end", "timer", "the planned time had passed since the voltage was applied", (-0.7, 0.8, 0.4, -0.5)),
    Weight("planned end", "not yet", "the planned time was not over", (0.3, -0.8, 0.4, 0.1)),
)  # fmt: skip
"""Calibrated by `tests.studies.fit_breakdown` on 400 records of each of 19 families of endings (6406 falls). Hardly any of them
falls slowly and then at once: that has the sum of what its two parts weigh, `slow` and `in one step`."""
_BY_OUTCOME = {(w.evidence, w.outcome): w for w in WEIGHTS}


def _weights(found: Mapping[str, str]) -> list[Weight]:
    return [_BY_OUTCOME[item] for item in found.items() if item in _BY_OUTCOME]


def posterior(found: Mapping[str, str]) -> dict[str, float]:
    """Probability of each cause, from the outcome of each piece of evidence that the record has."""
    odds = np.sum([PRIOR, *(w.odds for w in _weights(found))], axis=0)
    share = np.exp(odds - np.max(odds))
    return dict(zip(CAUSES, (share / share.sum()).tolist(), strict=True))


def _for(weight: Weight, cause: str) -> float:
    """Log odds of a cause against the mean of all."""
    return weight.odds[CAUSES.index(cause)] - sum(weight.odds) / len(CAUSES)


def strongest(found: Mapping[str, str], cause: str) -> str:
    """The piece of evidence that speaks most for a cause, in words."""
    weights = _weights(found)
    return max(weights, key=lambda w: _for(w, cause)).says if weights else "no evidence"


def describe(found: Mapping[str, str]) -> str:
    """All evidence in words, each with the log odds that it adds for a breakdown."""
    return "; ".join(
        f"{w.says} ({'+' if _for(w, FAILED) > 0 else ''}{fixed(_for(w, FAILED), 1)})" for w in _weights(found)
    )
