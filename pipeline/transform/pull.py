"""A film that is pulled until it breaks: stiffness at the start, strength, stretch at break and the work that it took.

Terms as in ISO 37 (rubber, tensile stress-strain properties): tensile strength is the largest nominal stress, the stress
at 100 % and 300 % is the nominal stress at stretch 2 and 4. Does not belong here: hyperelastic laws (`pipeline.fit.laws`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

FALLEN = 0.5
"""Share of the largest stress below which the film is broken: it tears to nothing within a few samples."""
START = 0.1
"""Range of stretch from the start over which the stiffness is measured."""
FEWEST = 12
SECANTS = {100: 2.0, 300: 4.0}
"""Stretches by the elongation in percent at which stresses are told."""
_NORMAL = 1.959964
_OFFSET = 0.01
_PART = (0.1, 0.9)
"""Shares of the range of stretch between which the rate is taken: a machine takes some time to start."""
_STILL = 1e-4
"""Share of the range of stretch that counts as none: less than the steps of a converter of 12 bits."""
_LATE = 0.05
"""Share of the range of stretch between largest stress and break: more is yielding, tearing or slip."""


@dataclass(frozen=True)
class Pull:
    """What one pull tells. Stresses are nominal, in kPa; bounds hold 95 %.

    Parameters
    ----------
    broke : whether the film broke; else `strength_kpa`, `stretch_at_break` and `work_kpa` are lower bounds
    modulus_kpa : slope of the stress over the stretch at the start, with bounds
    strength_kpa : largest stress, with its standard deviation by the noise of the samples
    stretch_at_break : last stretch before the break, `…_upper` the first after it; the largest where it did not break
    stress_at_100_kpa, stress_at_300_kpa : at stretch 2 and 4; None where they were not reached
    work_kpa : work to the break per undeformed volume, kJ/m³
    rate_per_s : rate of the stretch over the middle of its range
    last : number of the last sample before the break, from 0
    """

    broke: bool
    modulus_kpa: float
    modulus_kpa_lower: float
    modulus_kpa_upper: float
    strength_kpa: float
    strength_kpa_sd: float
    stretch_at_break: float
    stretch_at_break_upper: float | None
    stress_at_100_kpa: float | None
    stress_at_300_kpa: float | None
    work_kpa: float
    rate_per_s: float
    last: int
    warnings: tuple[str, ...] = ()


def measure_pull(time_s: Float, stretch: Float, stress: Float, *, where: str = "") -> Pull:
    """Stiffness, strength and break of one pull.

    Parameters
    ----------
    time_s, stretch, stress : (n,) finite, in s and kPa, nominal stress

    Raises
    ------
    NotIdentifiableError : fewer than 12 samples before the break; a stretch that does not rise, or stops at a sensor's end
    """
    if stretch.size < FEWEST or not np.max(stretch) > stretch[0]:
        raise NotIdentifiableError(
            f"{stretch.size} samples from stretch {stretch[0]:.4g}" if stretch.size else "no samples",
            where=where,
            expected=f"at least {FEWEST} samples of a rising stretch",
        )
    last = _find_last(stretch, stress)
    broke = last < stress.size - 1
    if last + 1 < FEWEST:
        raise NotIdentifiableError(
            f"the film breaks after {last + 1} samples",
            where=where,
            expected=f"at least {FEWEST} samples before the break",
        )
    lam, p = stretch[: last + 1], stress[: last + 1]
    _check_range(lam, p, where)
    noise = float(np.std(np.diff(p, 2))) / math.sqrt(6)
    warnings = []
    if abs(p[0]) > max(_OFFSET * float(np.max(p)), 5 * noise):
        warnings.append(f"the stress starts at {p[0]:.3g} kPa: pre-load, or an offset of the load cell")
    if not broke:
        warnings.append("the film did not break: strength, stretch at break and work are lower bounds")
    top = int(np.argmax(p))
    if lam[last] - lam[top] > _LATE * (lam[last] - lam[0]):
        warnings.append(
            f"the stress is largest at stretch {lam[top]:.4g}, well before the break: yielding, tearing or slip"
        )
    slope, error, used = _measure_slope(lam, p)
    if lam[used - 1] - lam[0] > 1.5 * START:
        warnings.append(f"the stiffness is that of stretches up to {lam[used - 1]:.3g}: there are few samples below")
    secants = {percent: _stress_at(lam, p, at) for percent, at in SECANTS.items()}
    begin, end = (int(np.argmax(lam >= lam[0] + share * np.ptp(lam))) for share in _PART)
    elapsed = float(time_s[end] - time_s[begin])
    return Pull(
        broke=broke,
        modulus_kpa=slope,
        modulus_kpa_lower=slope - _NORMAL * error,
        modulus_kpa_upper=slope + _NORMAL * error,
        strength_kpa=float(p[top]),
        strength_kpa_sd=noise,
        stretch_at_break=float(lam[last]),
        stretch_at_break_upper=float(stretch[last + 1]) if broke else None,
        stress_at_100_kpa=secants[100],
        stress_at_300_kpa=secants[300],
        work_kpa=float(np.trapezoid(p, lam)),
        rate_per_s=float(lam[end] - lam[begin]) / elapsed if elapsed > 0 else math.nan,
        last=last,
        warnings=tuple(warnings),
    )


def _check_range(stretch: Float, stress: Float, where: str) -> None:
    """Raises `NotIdentifiableError` where the stretch stands still while the stress rises: a sensor at its end."""
    reached = int(np.argmax(stretch >= np.max(stretch) - _STILL * np.ptp(stretch)))
    if stretch.size - reached >= FEWEST and stress[-1] - stress[reached] > _OFFSET * np.max(stress):
        raise NotIdentifiableError(
            f"the stretch stands still at {stretch[-1]:.4g} over the last {stretch.size - reached} samples"
            " while the stress rises",
            where=where,
            expected="a sensor of displacement with enough range",
        )


def _find_last(stretch: Float, stress: Float) -> int:
    """The last sample before the stress falls for good below half of its largest; the last of all where it does not.

    A film that tears takes some samples to fall: it is broken from where its stress only falls.
    """
    top = int(np.argmax(stress))
    below = np.flatnonzero(stress[top:] < FALLEN * stress[top])
    if not below.size:
        return int(np.argmax(stretch))
    last = top + int(below[0]) - 1
    while last > top and stress[last - 1] > stress[last] and stress[last] < (1 - _OFFSET) * stress[top]:
        last -= 1
    return last


def _measure_slope(stretch: Float, stress: Float) -> tuple[float, float, int]:
    """Slope at the first stretch with its standard error, and how many samples told it.

    From a cubic, so that the bend of the curve is no bias; the error is widened for residuals that hang together.
    """
    used = max(FEWEST, int(np.searchsorted(np.maximum.accumulate(stretch), stretch[0] + START)))
    used = min(used, stretch.size)
    x = stretch[:used] - stretch[0]
    design = np.stack([np.ones(used), x, x**2, x**3], 1)
    solution, _, rank, _ = np.linalg.lstsq(design, stress[:used], rcond=None)
    if rank < design.shape[1]:
        raise NotIdentifiableError("the stretch does not rise at the start", expected="a pull at a rate")
    rest = stress[:used] - design @ solution
    variance = float(rest @ rest) / max(1, used - design.shape[1])
    neighbours = float(rest[1:] @ rest[:-1]) / max(float(rest @ rest), 1e-300)
    together = min(max(neighbours, 0.0), 0.98)
    variance *= (1 + together) / (1 - together)
    covariance = variance * np.linalg.inv(design.T @ design)
    return float(solution[1]), math.sqrt(max(float(covariance[1, 1]), 0.0)), used


def _stress_at(stretch: Float, stress: Float, wanted: float) -> float | None:
    """The stress where the stretch first reaches a value, by straight lines; None where it does not."""
    beyond = np.flatnonzero(stretch >= wanted)
    if not beyond.size or stretch[0] > wanted:
        return None
    i = int(beyond[0])
    if i == 0:
        return float(stress[0])
    share = (wanted - stretch[i - 1]) / (stretch[i] - stretch[i - 1])
    return float(stress[i - 1] + share * (stress[i] - stress[i - 1]))
