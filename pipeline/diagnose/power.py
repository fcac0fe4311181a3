"""Smallest detectable severities: what the recordings at hand would have shown with 80 % probability."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from pipeline.diagnose.extend import Chosen, ExtendedFit, effect_of_all
from pipeline.diagnose.mechanisms import MECHANISMS, Context
from pipeline.diagnose.screen import absorbed_by

Float = NDArray[np.float64]

POWER = 0.8
_ROUNDS, _CLOSE = 10, 0.03
_SMALL = 0.01
_FAR_BELOW, _BEYOND = 1e5, 2.0
"""The search goes from this far below the plausible range to this far beyond it."""


def smallest_parameters(fit: ExtendedFit, threshold: float) -> dict[str, tuple[str, dict[str, float]]]:
    """Mechanism → form and parameters at which its signature reaches the threshold Λ with 80 % probability.

    Shapes are at the middle of their ranges; of the forms of a mechanism the first that can be seen counts, which is the usual one.
    A mechanism that would have to be far beyond its plausible range is left out.
    """
    wanted = float(np.sqrt(threshold) + norm.ppf(POWER))
    absorb = absorbed_by(fit)
    base = fit.of.predict(fit.x)
    found: dict[str, tuple[str, dict[str, float]]] = {}
    for id, mechanism in MECHANISMS.items():
        if not (mechanism.shows & fit.of.session.kinds) or id in {c.id for c in fit.of.chosen}:
            continue
        for variant in mechanism.variants:
            values = _severity(fit, Chosen(id, variant), wanted, base, absorb)
            if values is not None:
                found[id] = variant, values
                break
    return found


def reported(found: Mapping[str, tuple[str, Mapping[str, float]]], context: Context) -> dict[str, dict[str, float]]:
    """The same by the keys of the contract: mechanism → key → severity."""
    result = {}
    for id, (variant, values) in found.items():
        mechanism = MECHANISMS[id]
        shapes = {p.name for p in mechanism.shapes}
        report = mechanism.reported(values, variant, context)
        numbers = {k: float(v) for k, v in report.items() if isinstance(v, int | float) and k not in shapes}
        result[id] = {k: v for k, v in numbers.items() if np.isfinite(v) and v != 0}
    return result


def _severity(fit: ExtendedFit, chosen: Chosen, wanted: float, base: Float, absorb: Float) -> dict[str, float] | None:
    """Parameters at which the signature is `wanted` long; None where it never is."""
    main = chosen.mechanism.severities[0]
    values = {p.name: 0.0 for p in chosen.mechanism.severities} | {p.name: p.start for p in chosen.mechanism.shapes}
    low, high = main.low / _FAR_BELOW, min(_BEYOND * main.high, main.most)
    if not chosen.mechanism.onset:
        # In proportion: far from zero the model could absorb more than its derivatives say.
        small = _SMALL * main.low
        both = [values | {main.name: sign * small} for sign in ((1.0, -1.0) if main.signed else (1.0,))]
        length = _length(fit, chosen, both, base, absorb)
        at = wanted * small / length if length > 0 else np.inf
        return values | {main.name: float(at)} if at < high else None
    at = main.low
    lengths: dict[float, float] = {}
    # Lengths grow with the severity, mostly in proportion, onsets faster: secants of logarithms within a bracket.
    for _ in range(_ROUNDS):
        lengths[at] = _length(fit, chosen, [values | {main.name: at}], base, absorb)
        if abs(lengths[at] / wanted - 1) < _CLOSE:
            return values | {main.name: at}
        if lengths[at] < wanted:
            if at >= high:
                return None
            low = at
        else:
            if at <= low:
                return None
            high = at
        ratio = np.log(wanted / max(lengths[at], 1e-3 * wanted))
        slope = _slope(lengths)
        at = float(np.clip(at * np.exp(ratio / slope), low, high))
        if at in lengths:
            at = math.sqrt(low * high)
    return values | {main.name: at}


def _slope(lengths: Mapping[float, float]) -> float:
    """Logarithmic slope of length over severity between the two severities last looked at; 1 for a start."""
    if len(lengths) < 2:
        return 1.0
    (a, la), (b, lb) = list(lengths.items())[-2:]
    if min(la, lb) <= 0 or a == b:
        return 3.0
    return float(np.clip(np.log(lb / la) / np.log(b / a), 0.5, 6.0))


def _length(
    fit: ExtendedFit, chosen: Chosen, values: Sequence[Mapping[str, float]], base: Float, absorb: Float
) -> float:
    """Length of the signature at these parameters; of half the difference, where two opposite ones are given."""
    of = fit.of
    moved = [
        of.simulation.predict(of.model, fit.theta, effect_of_all((*of.chosen, chosen), (*fit.values, own)))
        for own in values
    ]
    change = moved[0] - base if len(moved) == 1 else (moved[0] - moved[1]) / 2
    seen = of.weight * of.session.whiten(change)
    if not np.isfinite(seen).all():
        return 0.0
    whole = np.concatenate([seen, np.zeros(absorb.shape[0] - seen.size)])
    return float(np.linalg.norm(whole - absorb @ (absorb.T @ whole)))
