"""Life from the film: the hazard of the weakest link over the thickness map, absolute, fitted to several layouts at once.

Each mm² of undeformed film lives by a Weibull distribution whose scale follows an inverse power law of the local field; a
specimen lives as long as its weakest mm². So area, thickness map and thickness scatter of a layout follow, and a layout
that was never tested has a life. Belongs here: the fit and the prediction; maps are in `pipeline.physics.thickness`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from pipeline.fit.survival.kaplan_meier import Estimate
from pipeline.fit.survival.lifetime_distributions import Lives
from pipeline.physics.thickness.film import ThicknessMap
from pipeline.physics.thickness.layout import Rectangle, covered
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError, RefusedError

PLAUSIBLE_EXPONENT = (float(np.log(np.sqrt(8 * 15))), float(np.log(15 / 8) / (2 * 1.645)))
"""Mean and standard deviation of ln of the exponent of the hazard over the field: soft films have 8 to 15, as
`weak_regions.EXPONENTS`, here taken for 90 %."""
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
_LOG_WEIGHTS = np.log(_WEIGHTS / _WEIGHTS.sum())
_SAME_THICKNESS = 0.01
"""Relative difference below which pieces of film count as equally thick: at an exponent of 15 their hazards differ by 15 %, and
about a mean that is kept, so that their sum is right to 0.2 %."""
_DRAWS, _SEED = 1000, 20_260_401
_LEVEL = 0.9
_PARAMETERS = 3
_STEP = 1e-3
"""Of the differences that give the information, in units of the parameters, which are logarithms."""


@dataclass(frozen=True)
class FilmLayout:
    """The film under the electrodes of one layout.

    Parameters
    ----------
    name : of the layout
    thickness_mm : (m,) local thickness in the finished film
    area_mm2 : (m,) undeformed area of each piece: flaws are bound to the material
    scatter : relative standard deviation of the thickness from specimen to specimen
    local_scatter : that of the thickness within a piece, about its mean
    """

    name: str
    thickness_mm: Float
    area_mm2: Float
    scatter: float = 0.0
    local_scatter: float = 0.0

    def __post_init__(self) -> None:
        good = (self.thickness_mm > 0).all() and (self.area_mm2 > 0).all() and self.area_mm2.size > 0
        if self.thickness_mm.shape != self.area_mm2.shape or not good or min(self.scatter, self.local_scatter) < 0:
            raise RefusedError(
                f"layout {self.name}: thickness or area that is none",
                expected="a thickness above 0 and an area for each piece of film",
            )

    def log_exposure(self, exponent: Float) -> Float:
        """(…,) ln Σ area · thickness^(−exponent), scatter within the pieces included (log-normal)."""
        p = np.asarray(exponent)[..., None]
        sums = _log_sum(np.log(self.area_mm2) - p * np.log(self.thickness_mm), -1)
        # A mean thickness with log-normal scatter of variance v: E[h^−p] = mean^−p exp[p (p + 1) v/2].
        variance = np.log1p(self.local_scatter**2)
        return np.asarray(sums + exponent * (exponent + 1) * variance / 2)


def lay_film(
    name: str, film_map: ThicknessMap, electrodes: Sequence[Rectangle], thickness_mm: float, scatter: float = 0.0
) -> FilmLayout:
    """The film of a thickness map that lies under electrodes, put together to pieces of nearly equal thickness.

    Parameters
    ----------
    name : of the layout
    film_map, electrodes : the film, and what of it is under voltage
    thickness_mm : of the undeformed film
    scatter : relative standard deviation of that from specimen to specimen
    """
    under = covered(film_map, electrodes)
    if not under.any():
        raise RefusedError(f"layout {name}: no electrode lies on the film", expected="electrodes over some of it")
    log_thickness = np.log(thickness_mm * film_map.thickness[under])
    area = film_map.undeformed_area_mm2[under]
    piece = np.unique(np.round(log_thickness / _SAME_THICKNESS), return_inverse=True)[1]
    total = np.bincount(piece, weights=area)
    mean = np.bincount(piece, weights=area * log_thickness) / total
    return FilmLayout(name, np.exp(mean), np.asarray(total, dtype=np.float64), scatter)


@dataclass(frozen=True)
class FilmLives:
    """Lives of one layout at one voltage; failures outside of the film are censored there."""

    layout: FilmLayout
    voltage_kv: float
    lives: Lives


@dataclass(frozen=True)
class FilmLifeFit:
    """The film's law of life.

    `life_s` is the Weibull scale of 1 mm² at `reference_mv_per_m`, `exponent` that of life over field (below 0), `shape` of the
    Weibull distribution, each with 95 % limits. `center` (3,) and `covariance` (3, 3) are of (ln life, ln of the exponent of
    the hazard, ln shape). `fitted_on` are the layouts.
    """

    reference_mv_per_m: float
    life_s: Estimate
    exponent: Estimate
    shape: Estimate
    center: Float
    covariance: Float
    failures: int
    fitted_on: tuple[str, ...]
    log_likelihood: float

    def draw(self) -> Float:
        """(draws, 3) parameters as likely as the data leave them: Student's t about the estimate."""
        rng = np.random.default_rng(_SEED)
        freedom = max(self.failures - _PARAMETERS, 2)
        widened = self.covariance * self.failures / freedom
        normal = rng.multivariate_normal(np.zeros(_PARAMETERS), widened, size=_DRAWS, method="eigh")
        chi = np.sqrt(rng.chisquare(freedom, size=_DRAWS) / freedom)
        return np.asarray(self.center + normal / chi[:, None])


@dataclass(frozen=True)
class FilmLifePrediction:
    """What the film's law says of a layout at a voltage, with 90 % limits.

    `median_s` is the median life of all such specimens, `sample_median_s` has the limits of the median of as many specimens
    as were asked for, `failed_share` the share failed by the end that was asked for, with the limits of such a sample.
    """

    layout: str
    voltage_kv: float
    specimens: int
    median_s: Estimate
    sample_median_s: Estimate
    failed_share: Estimate | None


def fit_film_life(groups: Sequence[FilmLives], prior: tuple[float, float] | None = None) -> FilmLifeFit:
    """The law of life of the film from the lives of all layouts together.

    Parameters
    ----------
    groups : lives of layouts at voltages
    prior : mean and standard deviation of ln of the exponent of the hazard, such as `PLAUSIBLE_EXPONENT`; None: the lives
        alone decide

    Raises
    ------
    NotIdentifiableError
        Too few failures, or without a prior one layout at one voltage: nothing tells how life depends on the field.

    Notes
    -----
    −ln S = Σ area (t/τ(E))^β with ln τ = a + n ln(E/reference), E = V/thickness; so −ln S = (t e^−a)^β (V/reference)^p
    Σ area thickness^−p with p = −n β (physics.md, sections 8.6 and 9.4). Scatter of the thickness from specimen to specimen is
    integrated over by Gauss and Hermite's rule.
    """
    failures = sum(group.lives.failures for group in groups)
    distinct = sum(group.lives.distinct_failures for group in groups)
    if distinct < _PARAMETERS + 1:
        raise NotIdentifiableError(
            f"{distinct} distinct failures in the film for {_PARAMETERS} parameters",
            expected=f"at least {_PARAMETERS + 1}",
        )
    conditions = {(group.layout.name, group.voltage_kv) for group in groups}
    if len(conditions) < 2 and prior is None:
        raise NotIdentifiableError(
            "one layout at one voltage does not tell how life depends on the field",
            expected="a second layout or voltage",
        )
    reference = _mean_field(groups)

    def loss(at: Float) -> float:
        value = -sum(_log_likelihood(group, at, reference) for group in groups)
        return value + (0.0 if prior is None else ((at[1] - prior[0]) / prior[1]) ** 2 / 2)

    start = _start(groups, reference, prior)
    found = optimize.minimize(loss, start, method="BFGS", options={"gtol": 1e-4})
    center = np.asarray(found.x, dtype=np.float64)
    information = _second_differences(loss, center)
    if not (np.isfinite(found.fun) and np.linalg.eigvalsh(information).min() > 1e-8 * np.abs(information).max()):
        raise NotIdentifiableError(
            "the lives do not tell the film's life, exponent and shape apart",
            expected="layouts or voltages whose fields differ more, or more failures",
        )
    covariance: Float = np.linalg.inv(information).astype(np.float64)
    freedom = max(failures - _PARAMETERS, 2)
    half = special.stdtrit(freedom, 0.975) * np.sqrt(failures / freedom)
    life, shape = (
        Estimate(*(float(np.exp(center[i] + side * half * np.sqrt(covariance[i, i]))) for side in (0, -1, 1)))
        for i in (0, 2)
    )
    ratio = np.array([0.0, 1.0, -1.0])
    spread = half * float(np.sqrt(ratio @ covariance @ ratio))
    n = float(np.exp(center[1] - center[2]))
    exponent = Estimate(-n, -n * float(np.exp(spread)), -n * float(np.exp(-spread)))
    names = tuple(dict.fromkeys(group.layout.name for group in groups))
    return FilmLifeFit(reference, life, exponent, shape, center, covariance, failures, names, -float(found.fun))


def predict_film_life(
    fit: FilmLifeFit, layout: FilmLayout, voltage_kv: float, specimens: int, end_s: float | None = None
) -> FilmLifePrediction:
    """What a layout lives at a voltage, tested or not.

    Parameters
    ----------
    fit : the film's law
    layout, voltage_kv : what is asked about
    specimens : of the sample that will be, or was, tested
    end_s : end of its test, for the share that fails by then
    """
    if not (voltage_kv > 0 and specimens > 0):
        raise RefusedError(f"{specimens} specimens at {voltage_kv:g} kV", expected="a number and a voltage above 0")
    drawn = fit.draw()
    rng = np.random.default_rng(_SEED + 1)
    best = _log_median(fit.center[None, :], layout, voltage_kv, fit.reference_mv_per_m)[0]
    medians = _log_median(drawn, layout, voltage_kv, fit.reference_mv_per_m)
    lives = _draw_lives(drawn, layout, voltage_kv, fit, specimens, rng)
    share = None
    if end_s is not None:
        failed = (lives <= np.log(end_s)).mean(axis=1)
        share = Estimate(float(np.median(failed)), *(float(q) for q in np.quantile(failed, _tails())))
    return FilmLifePrediction(
        layout.name,
        voltage_kv,
        specimens,
        _estimate(best, medians),
        _estimate(best, np.median(lives, axis=1)),
        share,
    )


def _log_sum(values: Float, axis: int) -> Float:
    """ln Σ exp along an axis; many times per fit, so without the checks of scipy's."""
    largest = values.max(axis=axis, keepdims=True)
    return np.asarray(np.log(np.exp(values - largest).sum(axis=axis)) + largest.squeeze(axis))


def _tails() -> tuple[float, float]:
    return (1 - _LEVEL) / 2, (1 + _LEVEL) / 2


def _estimate(log_value: float, log_drawn: Float) -> Estimate:
    low, high = np.quantile(log_drawn, _tails())
    return Estimate(*(float(np.exp(min(one, 700.0))) for one in (log_value, low, high)))


def _mean_field(groups: Sequence[FilmLives]) -> float:
    """Geometric mean of the fields in the thinner film of all specimens, MV/m."""
    logs = [
        np.log(group.voltage_kv) - np.average(np.log(group.layout.thickness_mm), weights=group.layout.area_mm2)
        for group in groups
    ]
    return float(np.exp(np.average(logs, weights=[group.lives.lower.size for group in groups])))


def _log_hazard(at: Float, layout: FilmLayout, voltage_kv: float, reference: float, log_time: Float) -> Float:
    """(batch, n) ln of −ln S of a specimen of mean thickness at ln t; `at` (batch, 3)."""
    p, beta = np.exp(at[:, 1]), np.exp(at[:, 2])
    level = p * np.log(voltage_kv / reference) + layout.log_exposure(p)
    return np.asarray(beta[:, None] * (log_time - at[:, :1]) + level[:, None])


def _specimen_shifts(at: Float, layout: FilmLayout) -> tuple[Float, Float]:
    """Nodes' shifts of ln hazard (batch, nodes) and ln weights (nodes,) of the thickness from specimen to specimen."""
    if layout.scatter == 0:
        return np.zeros((at.shape[0], 1)), np.zeros(1)
    return -np.exp(at[:, 1:2]) * np.log1p(layout.scatter) * _NODES, _LOG_WEIGHTS


def _log_likelihood(group: FilmLives, at: Float, reference: float) -> float:
    lives, row = group.lives, at[None, :]
    shifts, weights = _specimen_shifts(row, group.layout)
    with np.errstate(divide="ignore", over="ignore"):
        low, high = (
            np.exp(np.minimum(_log_hazard(row, group.layout, group.voltage_kv, reference, np.log(t))[0], 600.0))
            for t in (lives.lower, np.where(np.isfinite(lives.upper), lives.upper, 1.0))
        )
        factor = np.exp(shifts[0])[:, None]
        exact, right = lives.exact, np.isposinf(lives.upper)
        log_density = np.log(np.maximum(low * factor, 1e-300)) + at[2] - low * factor
        width = np.where(exact | right, 1.0, np.maximum((high - low) * factor, 1e-300))
        between = -low * factor + np.log(-np.expm1(-width))
        value = np.where(exact, log_density, np.where(right, -low * factor, between))
        total = _log_sum(value + weights[:, None], 0).sum()
        total -= np.log(lives.lower[exact]).sum()
        if lives.entered is not None:
            begun = _log_hazard(row, group.layout, group.voltage_kv, reference, np.log(lives.entered))[0]
            total -= _log_sum(-np.exp(np.minimum(begun, 600.0)) * factor + weights[:, None], 0).sum()
    return float(total) if np.isfinite(total) else -1e12


def _start(groups: Sequence[FilmLives], reference: float, prior: tuple[float, float] | None) -> Float:
    """Values to begin with: the better of a few exponents and shapes, with the life that fits them."""
    known = [np.where(np.isfinite(g.lives.upper), g.lives.upper, g.lives.lower) for g in groups]
    log_life = float(np.mean(np.concatenate([np.log(np.maximum(t, 1e-9)) for t in known])))
    best, least = np.zeros(3), np.inf
    for log_p in np.log([6.0, 12.0]) if prior is None else [prior[0]]:
        for log_beta in np.log([0.8, 2.0]):
            exposures = [
                float(
                    _log_hazard(np.array([[0.0, log_p, log_beta]]), g.layout, g.voltage_kv, reference, np.zeros(1))[
                        0, 0
                    ]
                )
                for g in groups
            ]
            at = np.array([log_life + float(np.mean(exposures)) / np.exp(log_beta), log_p, log_beta])
            value = -sum(_log_likelihood(g, at, reference) for g in groups)
            if value < least:
                best, least = at, value
    return best


def _second_differences(loss: Callable[[Float], float], at: Float) -> Float:
    """(q, q) second derivatives."""
    size = at.size
    steps = _STEP * np.eye(size)
    found = np.empty((size, size))
    for i in range(size):
        for j in range(i, size):
            corners = [loss(at + a * steps[i] + b * steps[j]) for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
            found[i, j] = found[j, i] = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * _STEP**2)
    return found


def _log_median(at: Float, layout: FilmLayout, voltage_kv: float, reference: float) -> Float:
    """(batch,) ln of the median life in s."""
    level = _log_hazard(at, layout, voltage_kv, reference, np.zeros(1))[:, 0]
    shifts, weights = _specimen_shifts(at, layout)
    beta = np.exp(at[:, 2])
    low, high = (np.log(np.log(2)) - level + side * (5 * np.abs(shifts).max(axis=1) + 1e-9) for side in (-1, 1))
    for _ in range(40):  # in units of ln hazard, by halving: the survival falls with the time
        middle = (low + high) / 2
        hazard = np.exp(np.minimum((middle + level)[:, None] + shifts, 600.0))
        alive = _log_sum(weights - hazard, 1) > np.log(0.5)
        low, high = np.where(alive, middle, low), np.where(alive, high, middle)
    return np.asarray((low + high) / 2 / beta)


def _draw_lives(
    at: Float, layout: FilmLayout, voltage_kv: float, fit: FilmLifeFit, specimens: int, rng: np.random.Generator
) -> Float:
    """(batch, specimens) ln lives.

    Their scatter about the median is widened by the root of failures over failures less parameters: that of maximum
    likelihood is too small by it, as in a normal linear model.
    """
    level = _log_hazard(at, layout, voltage_kv, fit.reference_mv_per_m, np.zeros(1))[:, :1]
    thickness = rng.normal(size=(at.shape[0], specimens)) * np.log1p(layout.scatter)
    middle = np.log(np.log(2))
    hazard = np.log(-np.log(rng.uniform(size=thickness.shape))) - middle
    widened = np.sqrt(fit.failures / max(fit.failures - _PARAMETERS, 2))
    return np.asarray((middle + widened * hazard - level + np.exp(at[:, 1:2]) * thickness) / np.exp(at[:, 2:]))
