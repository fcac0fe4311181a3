"""Relative permittivity from a specimen's own forces: from harmonic sequences and from steps (thesis, eq 4.7 and 4.8).

    F_A = ε0 εr (w/z) V²,   z = Hf/(λ1 λ2);   the ends feel the share l_active/l_free of it where passive film lies in series

w, z and the lengths are those of the stretched film. A load cell that gives way feels less by 1 + k/kL. The geometry and the
calibrations of force and voltage are taken as exact: they move all values of a specimen alike. Does not belong here: force maps,
whose values are beside their points (`points`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from pipeline.fit.force.points import force_per_permittivity
from pipeline.physics.film import RelaxationModel
from pipeline.transform.response import FrequencyResponse
from schemas.metadata import RecordingMetadata

_NORMAL = 1.959964
SPHS, STATIC = "sphs", "static"


@dataclass(frozen=True)
class Permittivity:
    """One value with its 95 % limits; `values` responses' lines or steps went into it, all at `voltage_kv` (None: several)."""

    method: str
    voltage_kv: float | None
    force_per_voltage_squared_n_per_kv2: float
    relative_permittivity: float
    relative_permittivity_lower: float
    relative_permittivity_upper: float
    stated_permittivity: float | None
    values: int

    @property
    def sd(self) -> float:
        """Standard deviation of the force over V², N/kV², by its limits."""
        width = self.relative_permittivity_upper - self.relative_permittivity_lower
        return self.force_per_voltage_squared_n_per_kv2 / self.relative_permittivity * width / (2 * _NORMAL)


def unit_force(about: RecordingMetadata) -> float | None:
    """Force at the ends over V² for a relative permittivity of 1, N/kV²; None where a size is not given."""
    thickness, stretch = about.layer_thickness_mm, about.pre_stretch
    if None in (about.active_length_mm, about.active_width_mm, thickness, stretch):
        return None
    across = about.lateral_stretch or 1.0
    drawn = about.active_drawn or "stretched"
    unit = force_per_permittivity(
        1, 1.0, stretch or 1.0, across, thickness_mm=thickness or 1.0, active_length_mm=about.active_length_mm or 0.0,
        active_width_mm=about.active_width_mm or 0.0, drawn=drawn, layers=about.layers or 1,
    )  # fmt: skip
    return unit * active_share(about)


def active_share(about: RecordingMetadata) -> float:
    """Share of the active part's force that the ends feel: its length over that of what is free; 1 where a length is not given."""
    stretch = about.pre_stretch or 1.0
    total = about.total_length_mm or (about.film_length_mm or 0.0) * stretch
    free, active = total - (about.constrained_length_mm or 0.0), active_length(about)
    return min(1.0, active / free) if free > 0 and active else 1.0


def active_length(about: RecordingMetadata) -> float | None:
    """Length of the active region on the stretched film, mm."""
    if about.active_length_mm is None:
        return None
    return about.active_length_mm * ((about.pre_stretch or 1.0) if about.active_drawn == "undeformed" else 1.0)


def from_blocked_force(
    response: FrequencyResponse, about: RecordingMetadata, voltage_kv: float | None
) -> Permittivity | None:
    """Permittivity from one recording's blocked force; None without a usable line or without sizes.

    Parameters
    ----------
    response : blocked force over V² (n,) N/kV² with its noise and its systematic error (correlated over the lines)
    about : sizes of the film
    voltage_kv : peak voltage

    Notes
    -----
    Generalised least squares of a constant on the real part, whose phase is 0 where nothing but V² acts.
    """
    unit, good = unit_force(about), response.usable & np.isfinite(response.variance)
    if unit is None or not good.any():
        return None
    covariance = np.diag(response.variance[good] / 2)
    if response.systematic is not None:
        s = response.systematic[good].real
        covariance = covariance + s @ s.T
    ones = np.ones(int(good.sum()))
    weight = np.linalg.solve(covariance, ones)
    value, sd = float(weight @ response.value[good].real / weight.sum()), float(weight.sum() ** -0.5)
    return _value(SPHS, voltage_kv, value, _NORMAL * sd, unit, about, int(good.sum()))


def from_force(a: float, sd: float, about: RecordingMetadata, lines: int) -> Permittivity | None:
    """Permittivity from the F_A/V² that all sequences of a specimen gave together, N/kV² with its standard deviation."""
    unit = unit_force(about)
    return None if unit is None else _value(SPHS, None, a, _NORMAL * sd, unit, about, lines)


def from_steps(
    forces_n: Sequence[float], voltages_kv: Sequence[float], about: RecordingMetadata, give: float
) -> Permittivity | None:
    """Permittivity from drops of tension at the ends of steps to about one voltage.

    Parameters
    ----------
    forces_n, voltages_kv : (n,) drop and voltage of each step
    about : sizes of the film
    give : 1 + k/kL, the film's stiffness by then over the load cell's

    Returns
    -------
    With limits by Student's t from the scatter of the steps; None for fewer than two, or without sizes
    """
    unit = unit_force(about)
    n = len(forces_n)
    if unit is None or n < 2:
        return None
    each = give * np.asarray(forces_n) / np.asarray(voltages_kv) ** 2
    reach = float(special.stdtrit(n - 1, 0.975)) * float(each.std(ddof=1)) / n**0.5
    return _value(STATIC, float(np.mean(voltages_kv)), float(each.mean()), reach, unit, about, n)


def relaxed_stiffness(model: RelaxationModel, time_s: float) -> float:
    """What is left of the film's stiffness a time after a step, N/mm: k0 + Σ ki exp(−t/τi)."""
    return model.k0 + sum(k * float(np.exp(-time_s / tau)) for k, tau in zip(model.k, model.tau, strict=True))


def _value(
    method: str, voltage_kv: float | None, a: float, reach: float, unit: float, about: RecordingMetadata, values: int
) -> Permittivity:
    return Permittivity(
        method, voltage_kv, a, a / unit, (a - reach) / unit, (a + reach) / unit, about.relative_permittivity, values
    )  # fmt: skip
