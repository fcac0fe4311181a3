"""Time-temperature superposition: the same film at several temperatures as one master curve at one of them.

*Model.* At temperature T the film's dynamic stiffness, or its relaxation, is

    k_T(ω) = b_T k(a_T ω),      G_T(t) = b_T G(t/a_T)

with one curve for all temperatures, the horizontal shift a_T and the vertical b_T, both 1 at the reference [1]. The curve
is the best relaxation of any order, k(ω) = k₀ + Σ kᵢ jωτᵢ/(1 + jωτᵢ) + jωc with kᵢ ≥ 0 on a dense grid of relaxation times,
so that storage and loss belong together and nothing but a passive film can come out. All shifts and the curve are
found at once, by least squares over the shifts with the springs solved for inside (non-negative least squares, Jacobian
after [2]). No two temperatures are ever matched by themselves; that is only how the search begins.

*Noise.* A machine errs in the magnitude by a share and in the phase by an angle. Where no standard errors are given, both are
found from what the curve leaves over its degrees of freedom. The limits of the shifts are Student's, of the whole fit: the
curve counts as unknown. Where the superposition does not hold, they are those of the best curve there is.

*Does it hold?* Each temperature with a curve of its own tells how large the noise is. What the common curve leaves beyond
that is an F test and a size, in per cent and degrees, for each temperature. The part that no horizontal shift can mend is
the distance from the common curve in the plane of phase over magnitude [3].

References
----------
1. J. D. Ferry, Viscoelastic Properties of Polymers, 3rd ed. (Wiley 1980), chapter 11.
2. L. Kaufman, "A variable projection method for solving separable nonlinear least squares problems", BIT 15 (1975) 49.
3. M. van Gurp, J. Palmen, "Time-temperature superposition for polymeric blends", Rheology Bulletin 67 (1998) 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, stdtrit

from pipeline.transform.superposition_fit import Data, Fit, Isotherm, assemble, fit_jointly
from schemas.arrays import Complex, Float

STANDARD_ATMOSPHERE = 23.0
"""°C, ISO 291."""
LEVEL = 0.01
"""Level of the tests: of a temperature, over the number of temperatures."""


@dataclass(frozen=True)
class Shift:
    """The shifts of one temperature, and how far the common curve is from what was measured there.

    Parameters
    ----------
    temperature_c, recording_id : which
    fixed : whether it is the reference, whose shifts are 0 and 1
    log_a, log_a_sd, log_a_lower, log_a_upper : log10 a_T, its standard deviation and 95 % limits
    b, b_lower, b_upper : b_T and its 95 % limits; 1 where vertical shifts are not used
    magnitude_misfit, phase_misfit_deg : root mean square of model over measured less 1, and of the phase; NaN for the
        phase of a relaxation
    van_gurp_palmen_sd : root mean square distance from the common curve in the plane of phase over magnitude, in
        standard deviations of the noise; NaN for a relaxation
    p_value : that the common curve leaves no more than noise here
    """

    temperature_c: float
    recording_id: str | None
    fixed: bool
    log_a: float
    log_a_sd: float
    log_a_lower: float
    log_a_upper: float
    b: float
    b_lower: float
    b_upper: float
    magnitude_misfit: float
    phase_misfit_deg: float
    van_gurp_palmen_sd: float
    p_value: float


@dataclass(frozen=True)
class Superposition:
    """A master curve.

    Parameters
    ----------
    reference_c : temperature at which the curve stands, one of those measured
    shifts : one for each isotherm, in their order
    covariance : (m, m) of ln a_T of the isotherms that are shifted, in their order
    freedom : degrees of freedom that it stands on
    vertical : whether vertical shifts were used
    vertical_p : that all vertical shifts are 1 (score test); NaN where they were used
    p_value : that one curve is enough for all temperatures
    magnitude_noise, phase_noise_deg : what a curve of its own leaves of each temperature, over the degrees of freedom,
        relative and in degrees; NaN for the phase where there are only relaxations
    tau, k : (K,) s at the reference, longest first, and springs above 0
    spring, dashpot : the curve's ends, N/mm and N s/mm
    """

    reference_c: float
    shifts: tuple[Shift, ...]
    covariance: Float
    freedom: float
    vertical: bool
    vertical_p: float
    p_value: float
    magnitude_noise: float
    phase_noise_deg: float
    tau: Float
    k: Float
    spring: float
    dashpot: float

    def stiffness(self, frequency_hz: Float) -> Complex:
        """Complex stiffness (n,) N/mm of the curve at (n,) Hz at the reference temperature."""
        z = 2j * np.pi * frequency_hz[:, None] * self.tau
        return np.asarray(self.spring + (z / (1 + z)) @ self.k + 2j * np.pi * frequency_hz * self.dashpot)

    def relaxation(self, time_s: Float) -> Float:
        """Relaxation (n,) N/mm of the curve at (n,) s after a step at the reference temperature."""
        return np.asarray(self.spring + np.exp(-time_s[:, None] / self.tau) @ self.k)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Where the superposition does not hold, with numbers."""
        failing = [shift for shift in self.shifts if shift.p_value * len(self.shifts) < LEVEL]
        found = []
        if failing:
            found.append(self._tell_misfit(failing))
        if self.vertical_p < LEVEL:
            found.append(
                f"horizontal shifts alone do not do (p {max(self.vertical_p, 1e-9):.1g} that no vertical ones are needed):"
                ' vertical_shift = "free" in [recording] takes them too'
            )
        return tuple(found)

    def _tell_misfit(self, failing: Sequence[Shift]) -> str:
        worst = min(failing, key=lambda shift: (shift.p_value, -shift.magnitude_misfit))
        misfit, noise = (
            f"{100 * magnitude:.2g} %" + ("" if np.isnan(phase) else f" and {phase:.2g}°")
            for magnitude, phase in (
                (worst.magnitude_misfit, worst.phase_misfit_deg),
                (self.magnitude_noise, self.phase_noise_deg),
            )
        )
        beside = ""
        if np.isfinite(worst.van_gurp_palmen_sd):
            beside = f"; phase over magnitude (van Gurp-Palmen) lies {worst.van_gurp_palmen_sd:.2g} SD beside it"
        return (
            "time-temperature superposition leaves more than noise at"
            f" {len(failing)} of {len(self.shifts)} temperatures, most at {worst.temperature_c:.4g} °C: the common curve is"
            f" off by {misfit} there, the noise is {noise}{beside}"
        )


def superpose(
    isotherms: Sequence[Isotherm], *, reference_c: float | None = None, vertical: bool = False
) -> Superposition:
    """The master curve of isotherms at different temperatures.

    Parameters
    ----------
    isotherms : at two temperatures or more
    reference_c : where the curve stands, °C: at the isotherm nearest to it; None: nearest to 23 °C
    vertical : whether each temperature has a vertical shift of its own

    Raises
    ------
    NotIdentifiableError
        There are fewer than two temperatures, or one of them has no value that can be used.
    """
    data = assemble(isotherms, STANDARD_ATMOSPHERE if reference_c is None else reference_c)
    fit = fit_jointly(data)
    vertical_p = np.nan
    if vertical:
        fit = fit_jointly(data, with_b=True, start=fit)
    else:
        count = data.count - 1
        rest = max(fit.chi2 - fit.vertical_fall, 1e-12) / max(fit.freedom - count, 1.0)
        vertical_p = float(fdtrc(count, max(fit.freedom - count, 1.0), fit.vertical_fall / count / rest))
    alone = [fit_jointly(data.select(number)) for number in range(data.count)]
    own = [_Left.of(data.select(number), one, 0) for number, one in enumerate(alone)]
    noise = _pool([(o.magnitude, o.magnitude_freedom) for o in own]), _pool([(o.phase, o.phase_freedom) for o in own])
    shifts, p_value = _describe(data, fit, own, noise, isotherms)
    return Superposition(
        reference_c=float(isotherms[data.reference].temperature_c),
        shifts=shifts,
        covariance=fit.covariance[: data.count - 1, : data.count - 1],
        freedom=fit.freedom,
        vertical=vertical,
        vertical_p=vertical_p,
        p_value=p_value,
        magnitude_noise=noise[0],
        phase_noise_deg=np.nan if data.timed.all() else float(np.degrees(noise[1])),
        tau=fit.tau,
        k=fit.k,
        spring=fit.spring,
        dashpot=fit.dashpot,
    )


@dataclass(frozen=True)
class _Left:
    """What a fit leaves of one isotherm, relative and rad: sums of squares and their degrees of freedom."""

    magnitude: float
    magnitude_freedom: float
    phase: float
    phase_freedom: float

    @classmethod
    def of(cls, data: Data, fit: Fit, isotherm: int) -> _Left:
        count = data.value.size
        rows = np.flatnonzero(data.of == isotherm)
        phased = np.flatnonzero(~data.timed)
        turns = count + np.flatnonzero(data.of[phased] == isotherm)
        mine = phased[turns - count]
        return cls(
            float(((fit.residual[rows] * fit.magnitude_noise[rows]) ** 2).sum()),
            float((1 - fit.leverage[rows]).sum()),
            float(((fit.residual[turns] * fit.phase_noise[mine]) ** 2).sum()),
            float((1 - fit.leverage[turns]).sum()),
        )

    def chi2(self, magnitude_noise: float, phase_noise: float) -> float:
        return self.magnitude / magnitude_noise**2 + self.phase / phase_noise**2

    @property
    def freedom(self) -> float:
        return self.magnitude_freedom + self.phase_freedom


def _describe(
    data: Data, fit: Fit, own: Sequence[_Left], noise: tuple[float, float], isotherms: Sequence[Isotherm]
) -> tuple[tuple[Shift, ...], float]:
    """Shifts with their limits and misfits, and the p-value that one curve is enough."""
    joint = [_Left.of(data, fit, number) for number in range(data.count)]
    noise_freedom = max(sum(o.freedom for o in own), 1.0)
    apart = _distance(data, fit, *noise)
    quantile = float(stdtrit(max(fit.freedom, 1.0), 0.975))
    sd = np.sqrt(np.diag(fit.covariance))
    place = {int(number): i for i, number in enumerate(data.free)}
    found = []
    for number, one in enumerate(isotherms):
        mask = data.of == number
        share = np.abs(fit.model[mask] / data.value[mask]) - 1
        turn = np.degrees(np.angle(fit.model[mask] / data.value[mask]))
        log_a, log_b = fit.log_a[number], fit.log_b[number]
        i = place.get(number)
        a_sd = 0.0 if i is None else float(sd[i])
        b_sd = float(sd[len(place) + i]) if i is not None and fit.with_b else 0.0
        extra = max(joint[number].chi2(*noise) - own[number].chi2(*noise), 0.0)
        freedom = max(joint[number].freedom - own[number].freedom, 1.0)
        ln10 = np.log(10)
        found.append(
            Shift(
                temperature_c=one.temperature_c,
                recording_id=one.recording_id,
                fixed=i is None,
                log_a=float(log_a / ln10),
                log_a_sd=a_sd / ln10,
                log_a_lower=float((log_a - quantile * a_sd) / ln10),
                log_a_upper=float((log_a + quantile * a_sd) / ln10),
                b=float(np.exp(log_b)),
                b_lower=float(np.exp(log_b - quantile * b_sd)),
                b_upper=float(np.exp(log_b + quantile * b_sd)),
                magnitude_misfit=float(np.sqrt(np.mean(share**2))),
                phase_misfit_deg=np.nan if one.in_time else float(np.sqrt(np.mean(turn**2))),
                van_gurp_palmen_sd=np.nan if one.in_time else float(np.sqrt(np.mean(apart[mask] ** 2))),
                p_value=float(fdtrc(freedom, noise_freedom, extra / freedom)),
            )
        )
    extra = max(sum(j.chi2(*noise) - o.chi2(*noise) for j, o in zip(joint, own, strict=True)), 0.0)
    freedom = max(sum(j.freedom - o.freedom for j, o in zip(joint, own, strict=True)), 1.0)
    return tuple(found), float(fdtrc(freedom, noise_freedom, extra / freedom))


def _pool(parts: Sequence[tuple[float, float]]) -> float:
    """Standard deviation from sums of squares and their degrees of freedom."""
    squares, freedom = (sum(part) for part in zip(*parts, strict=True))
    return float(np.sqrt(max(squares, 1e-18) / max(freedom, 1.0)))


def _distance(data: Data, fit: Fit, magnitude: float, phase: float) -> Float:
    """(N,) distance of each point from the common curve in the plane of ln magnitude and phase, in standard deviations.

    A shift along the frequencies moves a point along the curve, whose direction there is that of d ln k/d ln ω.
    """
    off = np.log(fit.model / data.value)
    along = fit.slope / fit.model
    u, v = off.real / magnitude, off.imag / phase
    x, y = along.real / magnitude, along.imag / phase
    length = np.hypot(x, y)
    return np.asarray(np.where(length > 0, (u * y - v * x) / np.where(length > 0, length, 1.0), np.hypot(u, v)))
