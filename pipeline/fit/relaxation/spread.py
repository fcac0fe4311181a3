"""Recordings of one specimen that differ beyond their noise, and what that does to weights.

A material that depends on strain gives each amplitude its own stiffness. Taken as noise-free truth, such differences would
drive the order up: with enough arms any curve can be followed. So they are part of the error model, in two pieces estimated
against the best relaxation of any order (never against the order under test): a common factor per recording group, a
random effect with standard deviation `gain_sd` of its logarithm, and a relative scatter per value, `relative_sd`, for what is
left. The model is then that of the average group, and its interval includes the spread.
"""

from __future__ import annotations

import numpy as np

from pipeline.fit.relaxation.observations import Lines, Observations
from pipeline.fit.relaxation.reference import Reference, find_reference, misfit_probability
from pipeline.fit.relaxation.results import Spread
from schemas.arrays import Float

LEVEL = 0.01
"""Probability below which a difference between groups counts as real."""
WIDE = 0.5
"""Standard deviation of log gains while they are being estimated freely."""
ROUNDS = 3


def by_group(reference: Reference) -> list[Reference]:
    """The best relaxation of each group by itself."""
    observations = reference.observations
    if len(observations.groups) == 1:
        return [reference]
    single = observations.with_gains(None)
    return [find_reference(single.of_group(g)) for g in range(len(observations.groups))]


def with_spread(reference: Reference, parts: list[Reference], *, gains: bool | None = None) -> tuple[Reference, Spread]:
    """The reference with the spread between groups in its error model.

    `gains` None: a factor per group where the data ask for it; True: always; False: never.
    """
    observations = reference.observations
    if len(observations.groups) < 2:
        return reference, Spread()
    gain_sd = 0.0
    if gains is not False:
        free = find_reference(observations.with_gains(WIDE), reference)
        fall = reference.chi2 - free.chi2
        count = len(observations.groups)
        if gains or misfit_probability(fall, count - 1) < LEVEL:
            logs = _log_gains(free)
            gain_sd = float(np.std(logs, ddof=1)) * np.sqrt(max(1 - (count - 1) / max(fall, 1e-9), 0.0))
            gain_sd = float(max(gain_sd, 1e-4))
            reference = find_reference(observations.with_gains(gain_sd), free)
    within = max(1.0, sum(p.chi2 for p in parts) / max(sum(p.observations.data - p.active for p in parts), 1.0))
    reference, relative_sd = _relative_scatter(reference, within)
    logs = _log_gains(reference) if gain_sd else np.zeros(len(observations.groups))
    return reference, Spread(
        gain_sd, relative_sd, {name: float(np.exp(g)) for name, g in zip(observations.groups, logs, strict=True)}
    )


def _log_gains(reference: Reference) -> Float:
    gains = reference.observations.nuisance.gains
    return reference.q[[gains[g] for g in range(len(reference.observations.groups))]]


def _relative_scatter(reference: Reference, within: float) -> tuple[Reference, float]:
    """Adds a relative variance per value until χ² equals its degrees of freedom times the misfit within groups."""
    if misfit_probability(reference.chi2 / within, reference.freedom) >= LEVEL:
        return reference, 0.0
    given = reference.observations
    scatter = 0.0
    for _ in range(ROUNDS):
        size = _relative_size(given)
        ratio = np.concatenate([b.weight * s for b, s in zip(given.blocks, size, strict=True)])
        twice = np.concatenate([np.full(b.weight.size, 2.0 if isinstance(b, Lines) else 1.0) for b in given.blocks])
        now = reference.observations
        residual = _squares(reference, given, now)
        target = within * reference.freedom
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = (low + high) / 2
            value = float((residual / (1 + (middle * ratio) ** 2 / twice)).sum())
            low, high = (middle, high) if value > target else (low, middle)
        scatter = (low + high) / 2
        factors = [
            1 / np.sqrt(1 + (scatter * b.weight * s) ** 2 / (2 if isinstance(b, Lines) else 1))
            for b, s in zip(given.blocks, size, strict=True)
        ]
        reference = find_reference(given.reweighted(factors), reference)
    return reference, scatter


def _relative_size(observations: Observations) -> list[Float]:
    return [np.abs(b.value) for b in observations.blocks]


def _squares(reference: Reference, given: Observations, now: Observations) -> Float:
    """Squared residual of each value in units of its own noise, both components together."""
    parts = []
    start = 0
    for block, own in zip(now.blocks, given.blocks, strict=True):
        rows = reference.residual[start : start + block.rows] ** 2
        if isinstance(block, Lines):
            rows = rows[: block.omega.size] + rows[block.omega.size :]
        parts.append(rows * (own.weight / block.weight) ** 2)
        start += block.rows
    return np.concatenate(parts)
