"""Life against voltage: the inverse power law with Weibull scatter, and whether the data obey it.

ln t = a + n ln V + σ w with w the smallest extreme value: one Weibull shape 1/σ for all voltages and a scale that falls
as a power of the voltage (n < 0). Belongs here: the fit, its test against a free scale and shape at each voltage, the
residual of each voltage, and the one voltage that breaks the law. Single voltages are in `lifetime_distributions`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pipeline.fit.survival.kaplan_meier import Estimate
from pipeline.fit.survival.lifetime_distributions import Lives
from pipeline.fit.survival.log_location_scale import (
    SMALLEST_EXTREME_VALUE,
    LogLives,
    Maximum,
    coefficient_covariance,
    converged_single,
    maximise,
)
from pipeline.fit.survival.profile_likelihood import critical_drop, profile_limits
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError, RefusedError
from schemas.numbers import p_equals, power, seconds, significant

_ALARM = 0.05
_SIMULATIONS = 499
_LARGEST_SIMULATED = 300
_SEED = 20_240_229


@dataclass(frozen=True)
class VoltageResidual:
    """One voltage against the law: ln(scale there) − (a + n ln V), in log units and in standard deviations.

    `scale_s` is the Weibull scale fitted at this voltage with the common shape, `law_scale_s` that of the law.
    `p_value_without` is the lack-of-fit probability of the law fitted to the other voltages; NaN where two are left.
    """

    voltage_kv: float
    specimens: int
    failures: int
    scale_s: float
    law_scale_s: float
    residual: float
    standardised: float
    p_value_without: float


@dataclass(frozen=True)
class LackOfFit:
    """Likelihood-ratio test of the law against a richer model.

    `p_value` is the asymptotic χ² one, `simulated_p_value` the share of data sets simulated from the law that deviate
    at least as much (NaN where not simulated); it is the one to use in small samples.
    """

    against: str
    statistic: float
    degrees_of_freedom: int
    p_value: float
    simulated_p_value: float = float("nan")

    @property
    def best_p_value(self) -> float:
        return self.p_value if np.isnan(self.simulated_p_value) else self.simulated_p_value


@dataclass(frozen=True)
class VoltageLife:
    """Inverse power law of one configuration.

    `intercept` a (t in s, V in kV), `exponent` n, `sigma` σ with 95 % profile limits; the Weibull shape is 1/σ.
    `tests`: `free scales` (a free scale at each voltage, one shape), `free shapes` (free shapes as well, against free
    scales) and `free scales and shapes`, the last decides whether the law `holds` (None with two voltages).
    `statement` says it in words and numbers, and where the law fails.
    """

    intercept: Estimate
    exponent: Estimate
    sigma: Estimate
    log_likelihood: float
    specimens: int
    failures: int
    tests: tuple[LackOfFit, ...]
    residuals: tuple[VoltageResidual, ...]
    statement: str
    covariance: Float
    warnings: tuple[str, ...]

    @property
    def holds(self) -> bool | None:
        return self.tests[-1].best_p_value >= _ALARM if len(self.residuals) > 2 else None

    def scale(self, voltage_kv: float) -> tuple[Estimate, tuple[str, ...]]:
        """Weibull scale in s at a voltage, 95 % limits from the information in ln t, and warnings for extrapolation."""
        x = np.array([1.0, np.log(voltage_kv)])
        centre = self.intercept.value + self.exponent.value * x[1]
        half = np.sqrt(2 * critical_drop(self.failures, 2) * float(x @ self.covariance @ x))
        tested = [r.voltage_kv for r in self.residuals]
        warnings = self.warnings
        if not min(tested) <= voltage_kv <= max(tested):
            side = "below the lowest" if voltage_kv < min(tested) else "above the highest"
            limit = min(tested) if voltage_kv < min(tested) else max(tested)
            warnings += (f"{voltage_kv:g} kV is {side} tested voltage ({limit:g} kV): the law is extrapolated",)
        with np.errstate(over="ignore"):  # a limit that few failures leave open is infinite
            return Estimate(*(float(np.exp(centre + side * half)) for side in (0, -1, 1))), warnings


@dataclass(frozen=True)
class _Data:
    lives: Lives
    voltage: Float

    @property
    def levels(self) -> Float:
        return np.unique(self.voltage)

    def at(self, keep: np.ndarray) -> _Data:
        return _Data(self.lives.keep(keep), self.voltage[keep])

    def maximum(self, design: Float, *, offset: Float | None = None, sigma: Float | None = None) -> Maximum:
        logs = self.lives.logarithms()
        if offset is not None:
            logs = logs.shifted(offset)
        return maximise(logs, design, SMALLEST_EXTREME_VALUE, sigma=sigma)


def fit_inverse_power_law(lives: Lives, voltage_kv: ArrayLike) -> VoltageLife:
    """Inverse power law by maximum likelihood, with profile intervals and tests for lack of fit.

    Parameters
    ----------
    lives : n lifetimes in s, exact, censored or in intervals
    voltage_kv : (n,) kV

    Raises `NotIdentifiableError` with failures at fewer than two voltages or fewer than three distinct failure times,
    `RefusedError` for voltages that are not above 0.
    """
    v = np.asarray(voltage_kv, dtype=np.float64)
    if v.shape != lives.lower.shape or not np.all(np.isfinite(v) & (v > 0)):
        raise RefusedError("voltages that are missing or not above 0 kV", expected="one voltage for each lifetime")
    data = _Data(lives, v)
    failed = np.isfinite(lives.upper)
    if np.unique(v[failed]).size < 2 or lives.distinct_failures < 3:
        raise NotIdentifiableError(
            f"no law of life against voltage: failures at {np.unique(v[failed]).size} voltage(s), "
            f"{lives.distinct_failures} distinct failure time(s)",
            expected="failures at two or more voltages, three or more distinct times",
        )
    law = _law(data)
    tests, scales, sigma = _lack_of_fit(data, law)
    if data.levels.size > 2:
        tests = (*tests[:-1], replace(tests[-1], simulated_p_value=_simulated_p_value(data, law, tests[-1])))
    intercept, exponent, spread, covariance = _intervals(data, law)
    residuals = tuple(_residual(data, level, law, scales, sigma, covariance) for level in data.levels)
    warnings = _warnings(exponent, tests, data.levels.size)
    statement = _statement(data, law, tests, residuals)
    return VoltageLife(
        intercept,
        exponent,
        spread,
        float(law.log_likelihood[0]) - lives.log_jacobian,
        v.size,
        lives.failures,
        tests,
        residuals,
        statement,
        covariance,
        warnings,
    )


def _design(data: _Data) -> Float:
    return np.column_stack((np.ones(data.voltage.size), np.log(data.voltage)))


def _law(data: _Data) -> Maximum:
    return converged_single(data.maximum(_design(data)), "inverse power law")


def _failing_levels(data: _Data) -> Float:
    """Voltages at which somebody failed: one without failures adds nothing to a likelihood with its scale free."""
    return np.unique(data.voltage[np.isfinite(data.lives.upper)])


def _lack_of_fit(data: _Data, law: Maximum) -> tuple[tuple[LackOfFit, ...], dict[float, tuple[float, float]], float]:
    """The tests, the free scale (ln s) with its standard deviation by voltage, and σ with the scales free."""
    levels = _failing_levels(data)
    dying = data.at(np.isin(data.voltage, levels))
    indicators = (dying.voltage[:, None] == levels[None, :]).astype(np.float64)
    common = converged_single(dying.maximum(indicators), "Weibull with one shape and free scales")
    sigma = float(common.sigma[0])
    scales = {
        float(level): (float(common.coefficients[0, i]), sigma / np.sqrt(_failures(data, level)))
        for i, level in enumerate(levels)
    }
    gain = 2 * float(common.log_likelihood[0] - law.log_likelihood[0])
    silent = data.levels.size - levels.size
    tests = [_test("free scales", gain, levels.size + silent - 2)]
    parts = [_single(data.at(data.voltage == level)) for level in levels]
    if all(np.isfinite(parts)):
        extra = 2 * (sum(parts) - float(common.log_likelihood[0]))
        tests.append(_test("free shapes", extra, levels.size - 1))
        if data.levels.size > 2:
            tests.append(_test("free scales and shapes", gain + extra, 2 * levels.size + silent - 3))
    return tuple(t for t in tests if t.degrees_of_freedom > 0), scales, sigma


def _single(data: _Data) -> float:
    """Log-likelihood of a Weibull at one voltage; NaN where its failures are too few for a shape of their own."""
    if data.lives.distinct_failures < 2:
        return float("nan")
    best = data.maximum(np.ones((data.voltage.size, 1)))
    return float(best.log_likelihood[0]) if best.converged[0] else float("nan")


def _test(against: str, statistic: float, freedom: int) -> LackOfFit:
    statistic = max(statistic, 0.0)
    p_value = float(special.chdtrc(freedom, statistic)) if freedom > 0 else float("nan")
    return LackOfFit(against, statistic, freedom, p_value)


def _failures(data: _Data, level: float) -> int:
    return int(np.count_nonzero((data.voltage == level) & np.isfinite(data.lives.upper)))


def _intervals(data: _Data, law: Maximum) -> tuple[Estimate, Estimate, Estimate, Float]:
    design, sigma = _design(data), float(law.sigma[0])
    a, n = (float(c) for c in law.coefficients[0])
    top, drop = float(law.log_likelihood[0]), critical_drop(data.lives.failures, 2)
    covariance = coefficient_covariance(data.lives.logarithms(), design, SMALLEST_EXTREME_VALUE, law)
    estimates = []
    for column, value in ((0, a), (1, n)):

        def profile(x: Float, column: int = column) -> Float:
            rest = np.delete(design, column, axis=1)
            return data.maximum(rest, offset=x[:, None] * design[:, column]).log_likelihood

        step = float(np.sqrt(covariance[column, column]))
        estimates.append(Estimate(value, *profile_limits(profile, value, top, drop, step)))

    def of_log_sigma(x: Float) -> Float:
        return data.maximum(design, offset=0 * x[:, None], sigma=np.exp(x)).log_likelihood

    limits = profile_limits(of_log_sigma, float(np.log(sigma)), top, drop, 1 / np.sqrt(data.lives.failures))
    estimates.append(Estimate(sigma, *(float(np.exp(x)) for x in limits)))
    return estimates[0], estimates[1], estimates[2], covariance


def _residual(
    data: _Data, level: float, law: Maximum, scales: dict[float, tuple[float, float]], sigma: float, covariance: Float
) -> VoltageResidual:
    x = np.array([1.0, np.log(level)])
    expected = float(law.coefficients[0] @ x)
    found, sd = scales.get(float(level), (float("nan"), float("nan")))
    # Both estimates share data: the law's variance, rescaled to the scatter with free scales, is to be taken off.
    shared = float(x @ covariance @ x) * (sigma / float(law.sigma[0])) ** 2
    spread = float(np.sqrt(max(sd**2 - shared, 0.0))) if np.isfinite(sd) else float("nan")
    rest = data.at(data.voltage != level)
    return VoltageResidual(
        float(level),
        int(np.count_nonzero(data.voltage == level)),
        _failures(data, level),
        float(np.exp(found)),
        float(np.exp(expected)),
        found - expected,
        float((found - expected) / spread) if spread > 0 else float("nan"),
        _p_value_of(rest),
    )


def _p_value_of(data: _Data) -> float:
    """Lack of fit (free scales) of the law on these data; NaN where it cannot be tested."""
    if _failing_levels(data).size < 3:
        return float("nan")
    tests, _, _ = _lack_of_fit(data, _law(data))
    return tests[0].p_value


def _simulated_p_value(data: _Data, law: Maximum, test: LackOfFit) -> float:
    """Share of data sets drawn from the law (fixed seed) whose likelihood ratio reaches that of the data.

    A specimen that failed would have been censored with the last survivor of its voltage, or never where there is none.
    """
    lives, n = data.lives, data.voltage.size
    if n > _LARGEST_SIMULATED or not lives.simple:
        return float("nan")
    ends = np.where(lives.exact, np.inf, lives.lower)
    for level in data.levels:
        survivors = (data.voltage == level) & ~lives.exact
        if survivors.any():
            here = (data.voltage == level) & lives.exact
            ends[here] = np.maximum(lives.lower[survivors].max(), lives.lower[here])
    rng = np.random.default_rng(_SEED)
    w = SMALLEST_EXTREME_VALUE.quantile_of_survival(rng.uniform(size=(_SIMULATIONS, n)))
    log_life = _design(data) @ law.coefficients[0] + law.sigma[0] * w
    with np.errstate(divide="ignore"):
        observed = np.minimum(log_life, np.log(ends))
    dead = log_life <= np.log(ends)
    drawn = LogLives(observed, np.where(dead, observed, np.inf))
    null = maximise(drawn, _design(data), SMALLEST_EXTREME_VALUE)
    usable = null.converged
    best = np.zeros(_SIMULATIONS)
    if test.against == "free scales":
        levels = [level for level in data.levels if dead[:, data.voltage == level].any(axis=1).all()]
        keep = np.isin(data.voltage, levels)
        indicators = (data.voltage[keep, None] == np.array(levels)[None, :]).astype(np.float64)
        free = maximise(LogLives(drawn.lower[:, keep], drawn.upper[:, keep]), indicators, SMALLEST_EXTREME_VALUE)
        best, usable = free.log_likelihood, usable & free.converged
    else:
        for level in data.levels:
            here = data.voltage == level
            single = maximise(
                LogLives(drawn.lower[:, here], drawn.upper[:, here]),
                np.ones((int(here.sum()), 1)),
                SMALLEST_EXTREME_VALUE,
            )
            some = dead[:, here].sum(axis=1)
            best += np.where(some > 0, single.log_likelihood, 0.0)
            usable &= (some == 0) | ((some >= 2) & single.converged)
    ratios = 2 * (best - null.log_likelihood)[usable]
    if ratios.size < _SIMULATIONS / 2:
        return float("nan")
    return float((1 + np.count_nonzero(ratios >= test.statistic)) / (1 + ratios.size))


def _warnings(exponent: Estimate, tests: tuple[LackOfFit, ...], levels: int) -> tuple[str, ...]:
    warnings: tuple[str, ...] = ()
    if not exponent.value < 0:
        warnings += (f"exponent {significant(exponent.value)} is not negative: life does not fall with voltage",)
    if levels < 3:
        warnings += ("two voltages: the law cannot be tested",)
    elif tests[-1].best_p_value < _ALARM:
        warnings += ("the inverse power law does not hold: its numbers describe none of the voltages well",)
    return warnings


def _statement(data: _Data, law: Maximum, tests: tuple[LackOfFit, ...], residuals: tuple[VoltageResidual, ...]) -> str:
    n, shape = float(law.coefficients[0, 1]), float(law.alpha[0])
    head = f"life ∝ V{power(n)}, Weibull shape {significant(shape)}"
    if data.levels.size < 3:
        return f"{head}; two voltages cannot test the law"
    test = tests[-1]
    kind = "" if np.isnan(test.simulated_p_value) else f" among {_SIMULATIONS} simulated data sets"
    proof = (
        f"(against {test.against} per voltage: likelihood ratio {significant(test.statistic)}, {test.degrees_of_freedom} d.f., "
        f"{p_equals(test.best_p_value)}{kind})"
    )
    if test.best_p_value >= _ALARM:
        return f"{head}; one inverse power law holds from {data.levels[0]:g} to {data.levels[-1]:g} kV {proof}"
    text = f"one inverse power law fails {proof}: {head} describes none of the voltages well"
    candidates = [r for r in residuals if r.p_value_without >= _ALARM]
    if candidates:
        culprit = max(candidates, key=lambda r: r.p_value_without)
        rest = data.at(data.voltage != culprit.voltage_kv)
        other = _law(rest)
        expected = float(np.exp(other.coefficients[0] @ np.array([1.0, np.log(culprit.voltage_kv)])))
        ratio = culprit.scale_s / expected
        text += (
            f". It fails at {culprit.voltage_kv:g} kV: the other voltages follow V{power(float(other.coefficients[0, 1]))} "
            f"(Weibull shape {significant(float(other.alpha[0]))}, {p_equals(culprit.p_value_without)}), and at "
            f"{culprit.voltage_kv:g} kV specimens live {_times(ratio)} that law's {seconds(expected)}"
        )
    else:
        largest = max(residuals, key=lambda r: abs(r.residual) if np.isfinite(r.residual) else 0.0)
        text += f". Largest residual at {largest.voltage_kv:g} kV: scale {_times(np.exp(largest.residual))} the law's"
    return text


def _times(ratio: float) -> str:
    return f"{significant(ratio, 2)} times" if ratio >= 1 else f"1/{significant(1 / ratio, 2)} of"
