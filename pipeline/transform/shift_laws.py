"""The course of shifts over temperature: the laws of Williams, Landel and Ferry, and of Arrhenius.

    WLF        log10 a_T = −C₁ ΔT/(C₂ + ΔT),   ΔT = T − T_ref
    Arrhenius  ln a_T = (E/R)(1/T − 1/T_ref)

Shifts of one master curve share the noise of its reference, so both laws are fitted to all of them with their covariance
(generalised least squares). What a law leaves beyond the shifts' own errors widens its limits. C₁ and C₂ are strongly
correlated and their errors lopsided: their limits are those of the profile of χ², on a side where it never rises enough
there is none. Does not belong here: the shifts (`pipeline.transform.superposition`).

References
----------
M. L. Williams, R. F. Landel, J. D. Ferry, J. Am. Chem. Soc. 77 (1955) 3701.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from scipy.special import chdtrc, stdtrit

from pipeline.transform.superposition import Superposition
from schemas.arrays import Float

GAS_CONSTANT = 8.314462618
"""J/(mol K)."""
ZERO_CELSIUS = 273.15
WLF, ARRHENIUS = "WLF", "Arrhenius"
_LEVEL = 0.01
"""Level at which a law leaves more than the shifts' own errors."""
_FARTHEST = 1e5
"""K; a law with a larger C₂ is an exponential of temperature."""
_GRID = 200


@dataclass(frozen=True)
class Value:
    """A constant with its 95 % limits, NaN on a side where nothing limits it."""

    value: float
    lower: float
    upper: float


@dataclass(frozen=True)
class ShiftLaw:
    """A law over the shifts of a master curve.

    Parameters
    ----------
    law : WLF or Arrhenius
    reference_c : °C
    c1, c2_k : of WLF, c2 in K; None for Arrhenius
    energy_kj_per_mol : activation energy; None for WLF
    chi2, freedom : what it leaves of the shifts in units of their own errors
    p_value : that it leaves no more than these; NaN without degrees of freedom
    off : root mean square of what it leaves, decades
    """

    law: str
    reference_c: float
    c1: Value | None
    c2_k: Value | None
    energy_kj_per_mol: Value | None
    chi2: float
    freedom: int
    p_value: float
    off: float

    def log_a(self, temperature_c: Float) -> Float:
        """log10 a_T (n,) at (n,) °C."""
        if self.c1 is not None and self.c2_k is not None:
            rise = temperature_c - self.reference_c
            return np.asarray(-self.c1.value * rise / (self.c2_k.value + rise))
        assert self.energy_kj_per_mol is not None
        inverse = 1 / (temperature_c + ZERO_CELSIUS) - 1 / (self.reference_c + ZERO_CELSIUS)
        return np.asarray(1e3 * self.energy_kj_per_mol.value / GAS_CONSTANT * inverse / np.log(10))


WORTH = 2.0
"""Lead in χ² + p ln m up to which a law with a constant more is no better: "not worth more than a bare mention" (Kass and Raftery 1995)."""


def fit_shift_laws(master: Superposition) -> tuple[ShiftLaw, ...]:
    """The laws that the shifts of a master curve can carry, the one that describes them better first.

    The order is that of χ² + p ln m for p constants and m shifts, χ² in units of what the better law leaves; a law with a constant more
    comes first where it is ahead by more than `WORTH`. Empty where no shift differs from the reference in temperature.
    """
    shifted = [s for s in master.shifts if not s.fixed]
    rise = np.array([s.temperature_c - master.reference_c for s in shifted])
    if not rise.any():
        return ()
    shifts = _Shifts(rise, np.array([s.log_a for s in shifted]) * np.log(10), master.covariance, master.freedom)
    laws = [_fit_arrhenius(shifts, master.reference_c)]
    if np.unique(rise[rise != 0]).size >= 2:
        laws.append(_fit_wlf(shifts, master.reference_c))
    unit = max(1.0, min(law.chi2 / max(law.freedom, 1) for law in laws))
    cost = [law.chi2 / unit + (rise.size - law.freedom) * np.log(rise.size) for law in laws]
    alike = min(cost) + WORTH
    ranked = sorted(zip(cost, laws, strict=True), key=lambda one: (one[0] > alike, -one[1].freedom, one[0]))
    return tuple(law for _, law in ranked)


class _Shifts:
    """Shifts ln a (m,) at ΔT (m,) K with what turns their errors into independent ones of one."""

    def __init__(self, rise: Float, log_a: Float, covariance: Float, freedom: float) -> None:
        values, vectors = np.linalg.eigh(covariance)
        floor = np.maximum(values, 1e-14 * max(float(values[-1]), 1e-300))
        self.whiten = (vectors / np.sqrt(floor)).T
        self.rise, self.log_a, self.freedom = rise, log_a, freedom
        self.target = self.whiten @ log_a

    def solve(self, course: Float) -> tuple[float, float, float]:
        """Factor of a course (m,) at its best, its standard deviation, and χ²."""
        column = self.whiten @ course
        size = float(column @ column)
        factor = float(column @ self.target) / size
        left = self.target - factor * column
        return factor, 1 / np.sqrt(size), float(left @ left)

    def chi2(self, log_a: Float) -> float:
        left = self.target - self.whiten @ log_a
        return float(left @ left)

    def judge(self, chi2: float, constants: int) -> tuple[int, float, float, float]:
        """Degrees of freedom, p-value, and the square of a 95 % limit in units of χ², with its Student's quantile."""
        freedom = self.rise.size - constants
        p_value = float(chdtrc(freedom, chi2)) if freedom > 0 else np.nan
        if freedom > 0 and p_value < _LEVEL:
            quantile = float(stdtrit(freedom, 0.975)) * np.sqrt(chi2 / freedom)
        else:
            quantile = float(stdtrit(max(self.freedom, 1.0), 0.975))
        return freedom, p_value, quantile**2, quantile


def _fit_arrhenius(shifts: _Shifts, reference_c: float) -> ShiftLaw:
    kelvin = reference_c + ZERO_CELSIUS
    factor, sd, chi2 = shifts.solve((1 / (kelvin + shifts.rise) - 1 / kelvin) / GAS_CONSTANT * 1e3)
    freedom, p_value, _, quantile = shifts.judge(chi2, 1)
    energy = Value(factor, factor - quantile * sd, factor + quantile * sd)
    law = ShiftLaw(ARRHENIUS, reference_c, None, None, energy, chi2, freedom, p_value, 0.0)
    return _with_error(law, shifts)


def _fit_wlf(shifts: _Shifts, reference_c: float) -> ShiftLaw:
    lowest = max(0.0, -float(shifts.rise.min()))
    """C₂ is above this: at T_ref − C₂ no film would ever relax."""

    def course(c2: float, c1: float = 1.0) -> Float:
        return np.asarray(-np.log(10) * c1 * shifts.rise / (c2 + shifts.rise))

    def by_c2(log_c2: float) -> float:
        return shifts.solve(course(lowest + np.exp(log_c2)))[2]

    span = np.log(1e-3), np.log(_FARTHEST)
    place, chi2 = _least(by_c2, *span)
    c2 = lowest + float(np.exp(place))
    c1 = shifts.solve(course(c2))[0]
    freedom, p_value, allowed, _ = shifts.judge(chi2, 2)
    limits_c2 = _limits(lambda x: by_c2(x) - chi2 - allowed, place, *span)
    lower, upper = (np.nan if np.isnan(x) else lowest + float(np.exp(x)) for x in limits_c2)

    def by_c1(log_c1: float) -> float:
        given = float(np.exp(log_c1))
        return _least(lambda x: shifts.chi2(course(lowest + np.exp(x), given)), *span)[1]

    found = Value(c1, np.nan, np.nan)
    if c1 > 0:
        middle = float(np.log(c1))
        found = Value(c1, *np.exp(_limits(lambda x: by_c1(x) - chi2 - allowed, middle, middle - 12, middle + 12)))
    law = ShiftLaw(WLF, reference_c, found, Value(c2, lower, upper), None, chi2, freedom, p_value, 0.0)
    return _with_error(law, shifts)


def _with_error(law: ShiftLaw, shifts: _Shifts) -> ShiftLaw:
    from dataclasses import replace

    left = law.log_a(law.reference_c + shifts.rise) - shifts.log_a / np.log(10)
    return replace(law, off=float(np.sqrt(np.mean(left**2))))


def _least(function: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Where a function of one variable is least between two bounds, and its value there."""
    grid = np.linspace(low, high, _GRID)
    values = [function(float(x)) for x in grid]
    i = int(np.argmin(values))
    around = grid[max(i - 1, 0)], grid[min(i + 1, _GRID - 1)]
    found = minimize_scalar(function, bounds=around, method="bounded", options={"xatol": 1e-9})
    return (float(found.x), float(found.fun)) if found.fun < values[i] else (float(grid[i]), float(values[i]))


def _limits(excess: Callable[[float], float], best: float, low: float, high: float) -> tuple[float, float]:
    """Where a function that is below 0 at its best rises through 0 on either side; NaN where it does not."""
    found = []
    for end in (low, high):
        step, inside, limit = 0.02, best, np.nan
        while inside != end:
            outside = min(best + step, end) if end > best else max(best - step, end)
            if excess(outside) > 0:
                limit = brentq(excess, *sorted((inside, outside)), xtol=1e-8)
                break
            inside, step = outside, 1.7 * step
        found.append(float(limit))
    return found[0], found[1]
