"""Electrode coverage: capacitance at rest over the number of coats, a rise that saturates (thesis, section 5.4.3)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from pipeline.fit.weighted import Estimate, scatter
from pipeline.transform.coats import Coat
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

COVERED = 0.99
"""Share of the full capacitance at which a region counts as covered."""
FEWEST_COATS = 6
_MOST_COATS = 1000.0


@dataclass(frozen=True)
class CoverageFit:
    """Rise of the capacitance of one specimen over its coats.

    `coats_to_cover` is the number of coats that cover 99 %; `first_share` what the first covers. `form` is the likeliest
    of the forms tried, the numbers are averages over them.
    """

    specimen_id: str
    coats: int
    full_pf: Estimate
    first_share: Estimate
    coats_to_cover: Estimate
    form: str
    warnings: tuple[str, ...] = ()


def _random(n: Float, p: Float) -> Float:
    """Every coat falls at random, later ones where there is some already: 1 − exp(−(n/s)^β)."""
    return np.asarray(-np.expm1(-((n * np.exp(-np.clip(p[0], -10.0, 10.0))) ** np.exp(np.clip(p[1], -3.0, 1.5)))))


def _remaining(n: Float, p: Float) -> Float:
    """The first coat covers a share, each further one the same part of what is bare: 1 − b e^{−(n − 1)/s}."""
    return np.asarray(1 - special.expit(p[0]) * np.exp(-(n - 1) * np.exp(-p[1])))


def _slowing(n: Float, p: Float) -> Float:
    """The same with coats that cover ever less, or more: 1 − b e^{−((n − 1)/s)^β}."""
    exponent = np.exp(np.clip(p[2], -2.0, 1.5))
    return np.asarray(1 - special.expit(p[0]) * np.exp(-(((n - 1) * np.exp(-np.clip(p[1], -3.0, 10.0))) ** exponent)))


_FORMS: Mapping[str, tuple[Callable[[Float, Float], Float], tuple[tuple[float, ...], ...]]] = {
    "random coats": (_random, ((-1.0, -0.7), (0.5, -0.7), (1.0, 0.0))),
    "coats on what is bare": (_remaining, ((-1.5, 0.7), (-1.5, 2.0))),
    "slowing coats": (_slowing, ((-1.5, 0.7, 0.0), (-1.5, 2.0, -0.3))),
}
"""Shares that n coats cover by name, and where their parameters may start."""


def fit_coverage(coats: Sequence[Coat]) -> CoverageFit:
    """The saturating rise of one specimen's capacitance over its coats.

    Three forms are fitted and averaged by their likelihood (BIC), so that the limits of what lies beyond the last coat
    hold what the choice of the form means for it. Raises `NotIdentifiableError` for fewer than six numbers of coats.
    """
    ordered = sorted(coats, key=lambda coat: coat.coats)
    n = np.array([coat.coats for coat in ordered], dtype=float)
    c = np.array([coat.capacitance_pf for coat in ordered])
    sd = np.maximum([coat.capacitance_sd_pf for coat in ordered], 1e-9)
    if np.unique(n).size < FEWEST_COATS:
        raise NotIdentifiableError(
            f"{np.unique(n).size} numbers of coats",
            where=ordered[0].specimen_id if ordered else "",
            expected=f"at least {FEWEST_COATS}",
        )
    # One scatter for all forms, that of the richest: else each would be excused by its own misfit.
    tau = scatter(lambda t: _fitted("slowing coats", n, c, sd, t, _FORMS["slowing coats"][1][:1]).chi2, n.size - 4)
    fits = [_fitted(name, n, c, sd, tau) for name in _FORMS]
    criterion = np.array([fit.chi2 + fit.p.size * math.log(n.size) for fit in fits])
    likely = np.exp(-(criterion - criterion.min()) / 2)
    likely /= likely.sum()
    freedom = float(n.size - 4) if tau else math.inf
    full, first, cover = (_averaged([fit.derived(which) for fit in fits], likely, freedom) for which in range(3))
    warnings: tuple[str, ...] = ()
    if cover.value > n[-1]:
        warnings = (f"not saturated: 99 % would take more than the {n[-1]:.0f} coats measured",)
    return CoverageFit(
        ordered[0].specimen_id, int(n[-1]), full, first, cover, fits[int(criterion.argmin())].name, warnings
    )


def _averaged(found: Sequence[tuple[float, float]], likely: Float, freedom: float) -> Estimate:
    values, sds = (np.array(column) for column in zip(*found, strict=True))
    mean = float(likely @ values)
    return Estimate(mean, math.sqrt(float(likely @ (sds**2 + (values - mean) ** 2))), freedom)


@dataclass(frozen=True)
class _Fit:
    """One form fitted: p = (ln C_full, own parameters)."""

    name: str
    p: Float
    covariance: Float
    chi2: float

    def derived(self, which: int) -> tuple[float, float]:
        """Full capacitance, share of the first coat or coats that cover 99 %, with its standard deviation."""
        step = 1e-5
        slopes = np.array(
            [
                (self._value(self.p + step * e, which) - self._value(self.p - step * e, which)) / (2 * step)
                for e in np.eye(self.p.size)
            ]
        )
        return self._value(self.p, which), math.sqrt(max(float(slopes @ self.covariance @ slopes), 0.0))

    def _value(self, p: Float, which: int) -> float:
        share = _FORMS[self.name][0]
        if which == 0:
            return math.exp(p[0])
        if which == 1:
            return float(share(np.array([1.0]), p[1:])[0])

        def lacking(n: float) -> float:
            return float(share(np.array([n]), p[1:])[0]) - COVERED

        if lacking(1.0) >= 0:
            return 1.0
        return _MOST_COATS if lacking(_MOST_COATS) <= 0 else float(optimize.brentq(lacking, 1.0, _MOST_COATS))


def _fitted(
    name: str, n: Float, c: Float, sd: Float, tau: float, starts: Sequence[tuple[float, ...]] | None = None
) -> _Fit:
    share, usual = _FORMS[name]
    weight = 1 / np.hypot(sd, tau * c)

    def residual(p: Float) -> Float:
        return np.asarray((np.exp(p[0]) * share(n, p[1:]) - c) * weight)

    found = [
        optimize.least_squares(
            residual, [math.log(1.01 * float(c.max())), *start], x_scale=[0.01, *[0.3] * len(start)], max_nfev=100
        )
        for start in starts or usual
    ]
    best = min(found, key=lambda one: float(one.cost))
    return _Fit(name, best.x, np.asarray(np.linalg.pinv(best.jac.T @ best.jac)), 2 * float(best.cost))
