"""Is anything left? Tests of a residual for smooth patterns that no mechanism proposes.

Patterns are polynomials in the logarithm of frequency or time, alone and times amplitude, voltage, cycle and session
time, for each kind of feature. What film, rig and the mechanisms in the model absorb is taken off, so that the sum of
squares of the scores is χ² under the null (score test, Rao 1948). An unlisted effect, or one of another form, shows
here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from pipeline.diagnose.features.kinds import REST_HUM, TAP_RING, WEIGHT_GAIN
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.screen import make_absorbed_basis, project_out
from pipeline.diagnose.simulation.session import Place, Session
from schemas.arrays import Bool, Float, Int

_DEGREE = 3
"""Degree of the polynomials."""
_SKIPPED = frozenset({REST_HUM, TAP_RING, WEIGHT_GAIN})
_RELATIVE_RANK = 1e-6
"""Eigenvalue of a Gram matrix over the largest below which it is none."""
_BY_VARIABLE = ("amplitude", "voltage_kv", "cycle", "session_s")
_WORDS = {
    "amplitude": "strain amplitude",
    "voltage_kv": "voltage",
    "cycle": "cycle number",
    "session_s": "session time",
}


@dataclass(frozen=True)
class Patterns:
    """Smooth patterns in a residual, all together and by what they are.

    Parameters
    ----------
    statistic, degrees_of_freedom : χ² under the null
    p_value : its probability
    kind_p : kind of feature → probability of its own patterns
    variable_p : variable → probability of the patterns that it modulates
    """

    statistic: float
    degrees_of_freedom: int
    p_value: float
    kind_p: dict[str, float]
    variable_p: dict[str, float]


def test_patterns(fit: ExtendedFit) -> Patterns:
    """Smooth patterns that a fitted model leaves.

    Parameters
    ----------
    fit : the model at its optimum
    """
    session = fit.of.session
    columns, labels = [], []
    for kind, variable, column in _make_patterns(session):
        columns.append(column)
        labels.append((kind, variable))
    if not columns:
        return Patterns(0.0, 0, 1.0, {}, {})
    seen = fit.of.weight[:, None] * np.column_stack(columns)
    gram, score = project_out(fit, seen, make_absorbed_basis(fit))
    scale = np.sqrt(np.maximum(np.sum(seen**2, axis=0), 1e-300))
    gram, score = gram / np.outer(scale, scale), score / scale
    kinds = np.array([k for k, _ in labels])
    variables = np.array([v for _, v in labels])
    total, freedom, _ = compute_quadratic(gram, score)
    return Patterns(
        total,
        freedom,
        float(chdtrc(max(freedom, 1), total)),
        {str(k): _compute_p(gram, score, kinds == k) for k in np.unique(kinds)},
        {str(v): _compute_p(gram, score, variables == v) for v in np.unique(variables) if v},
    )


def name_variable(variable: str) -> str:
    """A variable's name in words."""
    return _WORDS[variable]


def compute_block_p(chi2: float, size: int, spread: float) -> float:
    """Probability of χ² or more of a block whose noise variance is itself known only so well.

    Parameters
    ----------
    chi2, size : of the block, and the number of its values
    spread : relative standard deviation of the noise variance

    Notes
    -----
    The sum is taken as a multiple of a χ² with the same mean and variance: Satterthwaite 1946.
    """
    variance = 2 * size + (spread * size) ** 2
    return float(chdtrc(2 * size**2 / variance, chi2 * 2 * size / variance))


def _make_patterns(session: Session) -> Iterator[tuple[str, str, Float]]:
    """Kind, variable ("" for none) and whitened column (N,) of each pattern."""
    by_kind: dict[str, list[Place]] = {}
    for p in session.places:
        if p.block.kind not in _SKIPPED:
            by_kind.setdefault(p.block.kind, []).append(p)
    sd = session.sd
    for kind, places in by_kind.items():
        index = np.concatenate([np.arange(p.first, p.stop) for p in places])
        half = np.concatenate([_number_sides(p) for p in places])
        along = np.concatenate([_make_abscissa(p) for p in places])
        powers = np.polynomial.legendre.legvander(_scale_to_unit(along), _DEGREE if np.ptp(along) > 0 else 0)
        modulations: list[tuple[str, Float]] = [("", np.ones(index.size))]
        for name in _BY_VARIABLE:
            values = session.covariate(name)[index]
            if np.isfinite(values).all() and np.ptp(values) > 1e-9 * max(float(np.abs(values).max()), 1e-300):
                modulations.append((name, _scale_to_unit(values)))
        for side in np.unique(half):
            for name, modulation in modulations:
                for power in powers.T:
                    column = np.zeros(session.size)
                    column[index] = np.where(half == side, power * modulation, 0.0) * sd[index]
                    yield kind, name, session.whiten(column)


def _number_sides(p: Place) -> Int:
    """0 for real parts and harmonic 2, 1 for imaginary parts; harmonics of order 3 count on their own."""
    n = p.block.size
    side = np.zeros(n, dtype=np.int64)
    if p.block.is_complex:
        side[n // 2 :] = 1
    order = p.block.support.get("order")
    if order is not None and order.size * (2 if p.block.is_complex else 1) == n:
        side += 2 * np.tile(order.astype(np.int64), 2 if p.block.is_complex else 1)
    return side


def _make_abscissa(p: Place) -> Float:
    """Logarithm of frequency, else of time."""
    f = p.block.frequency_hz
    if np.isfinite(f).all() and (f > 0).all():
        return np.asarray(np.log(f))
    t = p.block.time_s
    return (
        np.asarray(np.log(np.maximum(np.nan_to_num(t - np.nanmin(t)), 0.0) + 1e-2))
        if np.isfinite(t).any()
        else np.zeros(f.size)
    )


def _scale_to_unit(values: Float) -> Float:
    """Values from −1 to 1."""
    low, high = float(values.min()), float(values.max())
    return np.asarray(2 * (values - low) / (high - low) - 1) if high > low else np.zeros(values.size)


def compute_quadratic(gram: Float, score: Float) -> tuple[float, int, Float]:
    """sᵀ G⁺ s over changes of unit length, the rank of G, and G⁺ s.

    Parameters
    ----------
    gram, score : G (G, G) products of the changes, and s (G,) with the residual
    """
    values, vectors = np.linalg.eigh((gram + gram.T) / 2)
    kept = values > _RELATIVE_RANK * max(float(values[-1]), 1e-300)
    kept &= values > 1e-5
    along = vectors[:, kept].T @ score
    return (
        float(np.sum(along**2 / values[kept])),
        int(kept.sum()),
        np.asarray(vectors[:, kept] @ (along / values[kept])),
    )


def _compute_p(gram: Float, score: Float, chosen: Bool) -> float:
    """Probability of the scores of some patterns alone."""
    total, freedom, _ = compute_quadratic(gram[np.ix_(chosen, chosen)], score[chosen])
    return float(chdtrc(freedom, total)) if freedom else 1.0
