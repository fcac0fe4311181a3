"""Smallest detectable severities: what the recordings at hand would have shown with 80 % probability."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from pipeline.diagnose.mechanisms import MECHANISMS, Context
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Chosen, ExtendedFit, compose_chosen
from pipeline.diagnose.search.screen import Signatures, make_absorbed_basis, project_out, scale_severities
from schemas.arrays import Float

Shape = tuple[float, ...]

_STEEPEST = 6.0
"""Largest exponent by which the trace of an onset effect is taken to grow."""
_SMALL = 0.01
"""Part of a severity at which a weak effect is taken."""
_GONE = 1e-9
"""Share of its squared length below which an arm is spent."""
_ARMS_S = np.geomspace(1e-4, 100.0, 19)
"""Relaxation times at which the model could have another arm."""


def find_smallest(looked: Signatures, threshold: float) -> dict[str, tuple[str, dict[str, float]]]:
    """Severities at which mechanisms would be found with probability `detectable.power`.

    Parameters
    ----------
    looked : signatures about the plain model, whose points are the shapes that count
    threshold : Λ at the false-alarm level

    Returns
    ------- Mechanism → variant and parameters. In `detectable.shapes` of the shapes this severity would be found; the
    shape given is the one at that edge. Of the variants the first that can be seen counts, which is the usual one. A
    mechanism that would have to be far beyond its plausible range is left out.
    """
    wanted = float(np.sqrt(threshold) + ndtri(RULES.detectable.power))
    by_form: dict[Chosen, list[int]] = {}
    for i, c in enumerate(looked.chosen):
        by_form.setdefault(c, []).append(i)
    found: dict[str, tuple[str, dict[str, float]]] = {}
    for id, mechanism in MECHANISMS.items():
        for chosen in (Chosen(id, variant) for variant in mechanism.usual_variants):
            points = by_form.get(chosen, [])
            needed = (_solve_by_grid if mechanism.onset else _solve_by_slope)(chosen, looked, points, wanted)
            values = _cover_most_shapes(chosen, needed)
            if values is not None:
                found[id] = chosen.variant, values
                break
    return found


def report_smallest(
    found: Mapping[str, tuple[str, Mapping[str, float]]], context: Context
) -> dict[str, dict[str, float]]:
    """Smallest severities by the keys of the contract: mechanism → key → severity.

    Parameters
    ----------
    found : mechanism → variant and parameters
    context : what severities are relative to
    """
    result = {}
    for id, (variant, values) in found.items():
        mechanism = MECHANISMS[id]
        shapes = {p.name for p in mechanism.list_shapes(variant)}
        report = mechanism.report_severity(values, variant, context)
        numbers = {k: float(v) for k, v in report.items() if isinstance(v, int | float) and k not in shapes}
        result[id] = {k: v for k, v in numbers.items() if np.isfinite(v) and v != 0}
    return result


def _take_shape(chosen: Chosen, values: Mapping[str, float]) -> Shape:
    """Values of a mechanism's shapes."""
    return tuple(values[p.name] for p in chosen.mechanism.list_shapes(chosen.variant))


def _cover_most_shapes(chosen: Chosen, needed: Mapping[Shape, float]) -> dict[str, float] | None:
    """Parameters at the severity that is enough in all but the hardest shapes; None where that is far beyond what is
    plausible."""
    if not needed:
        return None
    mechanism = chosen.mechanism
    main = mechanism.severities[0]
    ordered = sorted((severity, shape) for shape, severity in needed.items())
    at, shape = ordered[int(np.ceil(RULES.detectable.shapes * len(ordered))) - 1]
    if not at <= min(RULES.detectable.beyond * main.high, main.most):
        return None
    others = {p.name: 0.0 for p in mechanism.severities[1:]}
    shapes = (p.name for p in mechanism.list_shapes(chosen.variant))
    return {main.name: at, **others, **dict(zip(shapes, shape, strict=True))}


def _solve_by_slope(chosen: Chosen, looked: Signatures, points: list[int], wanted: float) -> dict[Shape, float]:
    """Shape → severity at a wanted length, in proportion to a small severity."""
    main = chosen.mechanism.severities[0]
    needed: dict[Shape, float] = {}
    for i in points:
        severity = abs(looked.values[i][main.name])
        if looked.weak[i] and severity > 0:
            length = float(looked.length[i])  # 0: further arms would leave nothing of it
            needed[_take_shape(chosen, looked.values[i])] = wanted * severity / length if length > 0 else float("inf")
    return needed


def _solve_by_grid(chosen: Chosen, looked: Signatures, points: list[int], wanted: float) -> dict[Shape, float]:
    """Shape → severity at a wanted length, along powers through the lengths at the severities of the grid: an onset has
    no slope at zero."""
    main = chosen.mechanism.severities[0]
    lengths: dict[Shape, list[tuple[float, float]]] = {}
    for i in points:
        own = lengths.setdefault(_take_shape(chosen, looked.values[i]), [])
        own.append((looked.values[i][main.name], float(looked.length[i])))
    return {
        shape: _interpolate_length(np.log(np.array(sorted(own))), float(np.log(wanted)))
        for shape, own in lengths.items()
    }


def _interpolate_length(logs: Float, wanted: float) -> float:
    """Severity at a wanted log length, from logarithms (L, 2) of severities and lengths; beyond them as steep as at the
    end."""
    if len(logs) == 1:
        return float(np.exp(logs[0, 0])) if logs[0, 1] >= wanted else float("inf")
    slopes = np.clip(np.diff(logs[:, 1]) / np.diff(logs[:, 0]), 1.0, _STEEPEST)
    place = int(np.clip(np.searchsorted(logs[:, 1], wanted) - 1, 0, slopes.size - 1))
    near = place + int(abs(wanted - logs[place, 1]) > abs(wanted - logs[place + 1, 1]))
    return float(np.exp(logs[near, 0] + (wanted - logs[near, 1]) / slopes[place]))


def discount_further_arms(fit: ExtendedFit, looked: Signatures) -> Signatures:
    """Signatures about a plain fit, those of relaxations as long as what further arms would leave of them.

    A plain model below the highest order takes another arm where the recordings ask for one, and then there is nothing
    to find.

    Parameters
    ----------
    fit : of the plain model
    looked : signatures about it
    """
    free = RULES.plain.orders[-1] - fit.of.model.arms
    points = [i for i, c in enumerate(looked.chosen) if c.mechanism.relaxes and looked.weak[i]]
    arms = _list_weak_arms()
    if free <= 0 or not points or not arms:
        return looked
    of, base = fit.of, fit.of.predict(fit.x)
    relaxations = [
        (looked.chosen[i], scale_severities(looked.chosen[i].mechanism, looked.values[i], _SMALL)) for i in points
    ]
    changes = [
        of.simulation.predict(of.model, fit.theta, compose_chosen((c,), (values,))) - base
        for c, values in (*arms, *relaxations)
    ]
    seen = of.weight[:, None] * of.session.whiten(np.array(changes).T / _SMALL)
    gram = project_out(fit, seen, make_absorbed_basis(fit))[0]
    length = looked.length.copy()
    for place, i in enumerate(points, start=len(arms)):
        # As derivatives over whole severities, so that the ratio counts.
        length[i] *= float(np.sqrt(max(_measure_left(gram, len(arms), free, place), 0.0) / gram[place, place]))
    return replace(looked, length=length)


def _list_weak_arms() -> list[tuple[Chosen, Mapping[str, float]]]:
    """Weak arms as the plain model's, at all times that one could have; none where no mechanism of the list is one."""
    for id, mechanism in MECHANISMS.items():
        if mechanism.as_arm is not None:
            ratio = _SMALL * mechanism.severities[0].low
            return [(Chosen(id, mechanism.variants[0]), mechanism.as_arm(ratio, float(t))) for t in _ARMS_S]
    return []


def _measure_left(gram: Float, arms: int, free: int, place: int) -> float:
    """Squared length of the change at `place` that the best `free` of the first `arms` changes leave, taken one by one.

    gram : (G, G) products of the changes
    """
    left = gram.copy()
    for _ in range(free):
        own = np.diag(left)[:arms]
        taken = np.where(
            own > _GONE * np.diag(gram)[:arms],
            left[:arms, place] ** 2 / np.maximum(own, 1e-300),
            0,
        )
        best = int(np.argmax(taken))
        if taken[best] > 0:
            left = left - np.outer(left[:, best], left[best]) / left[best, best]
    return float(left[place, place])
