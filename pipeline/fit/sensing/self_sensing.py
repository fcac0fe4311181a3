"""Self-sensing of a specimen: force against capacitive strain, sensitivity, drift. Pure functions.

A separate sensing region follows λ_SR (thesis, eq 5.1 to 5.6), a region that both actuates and senses the square of its
area ratio (eq 5.12). Wrinkling is in `wrinkling`, the closed loop in `pipeline.transform.loop`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from pipeline.fit.weighted import Estimate, line, regression, weighted_mean
from pipeline.transform.step import StepResponse
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata

VACUUM = 8.8541878e-6
"""Permittivity of vacuum, N/kV²: forces ε0 εr (w/z) V² with V in kV."""


_LEAST_SPAN = 0.25
"""Least span of ln V from which an exponent is told: a factor of 1.3 in voltage."""


@dataclass(frozen=True)
class SensingFit:
    """Self-sensing of a specimen.

    `force_per_capacitive_strain` in N: ΔF = w h Y (1 − λ_cap) for film in series with the sensing region (thesis, eq
    5.16 without its factor l_tot/l_AR − 1). `modulus_mpa` is that over w h, both current. `sensitivity` is ∂λ_cap/∂λ_AR,
    measured and from the geometry (thesis, eq 5.6 and 5.12). `nonlinearity` is how far a parabola through the points
    leaves their line at the largest strain, as a share. `drift_pf_per_hour` is that of the capacitance at given force.
    `modulus_ratio` is `modulus_mpa` over the modulus of mechanical tests.
    """

    force_per_capacitive_strain: Estimate
    r_squared: float
    modulus_mpa: Estimate | None
    sensitivity: Estimate | None
    predicted_sensitivity: float | None
    drift_pf_per_hour: Estimate | None
    wrinkling_onset_kv: Estimate | None
    force_exponent: Estimate | None
    """Exponent of the force step in the voltage; 2 for Maxwell stress at constant permittivity."""
    steps: int
    nonlinearity: Estimate | None = None
    mechanical_modulus_mpa: Estimate | None = None
    sensing_region: str = "separate"
    warnings: tuple[str, ...] = ()

    @property
    def modulus_ratio(self) -> Estimate | None:
        one, other = self.modulus_mpa, self.mechanical_modulus_mpa
        if one is None or other is None or not other.value:
            return None
        return one.scaled(1 / other.value, other.sd / other.value)


def current_section_mm2(metadata: RecordingMetadata) -> float | None:
    """Stretched cross-section w h of the film in mm²: undeformed section over the stretch in direction 1."""
    section, stretch = metadata.undeformed_section_mm2, metadata.pre_stretch
    return None if section is None or stretch is None else section / stretch


def actuation_per_voltage_squared(metadata: RecordingMetadata) -> Estimate | None:
    """ε0 εr w/z of the active region in N/kV², current sizes; the prior of the permittivity is 10 % where absent."""
    permittivity, thickness = metadata.relative_permittivity, metadata.layer_thickness_mm
    l1, l2, width = metadata.pre_stretch, metadata.lateral_stretch, metadata.active_width_mm
    if permittivity is None or thickness is None or l1 is None or l2 is None or width is None:
        return None
    current = width * l2 if metadata.active_drawn == "undeformed" else width
    value = VACUUM * permittivity * current * l1 * l2 / thickness * (metadata.layers or 1)
    sd = metadata.relative_permittivity_sd
    return Estimate(value, value * (0.1 if sd is None else sd / permittivity))


def passive_stretch(metadata: RecordingMetadata) -> float | None:
    """∂λ_P/∂λ_AR = −l_AR/(l_tot − l_AR) of the film beside the active region, stretched lengths (thesis, eq 5.1).

    Film that is held rigid (`constrained_length_mm`) takes no part and does not count in l_tot.
    """
    active, total, stretch = metadata.active_length_mm, metadata.total_length_mm, metadata.pre_stretch
    if active is None or total is None:
        return None
    if metadata.active_drawn == "undeformed":
        if stretch is None:
            return None
        active = active * stretch
    total -= metadata.constrained_length_mm or 0.0
    return -active / (total - active) if total > active else None


def shared_region(metadata: RecordingMetadata) -> bool:
    """One region actuates and senses."""
    return metadata.sensing_region == "active"


def predicted_sensitivity(metadata: RecordingMetadata) -> float | None:
    """∂λ_cap/∂λ_AR at rest: that of the passive film (thesis, eq 5.6), or 2 for one region of held width (eq 5.12)."""
    return 2.0 if shared_region(metadata) else passive_stretch(metadata)


def fit_sensing(
    recordings: Sequence[Sequence[StepResponse]],
    metadata: RecordingMetadata,
    mechanical_modulus: Estimate | None = None,
    common_sd: float = 0.0,
) -> SensingFit:
    """Line of force against capacitive strain, and what follows from it, from the steps of each recording.

    Both variables carry noise: weighted total least squares (York), intercept free, with a scatter from step to step
    where the points show one. `common_sd` is a relative standard deviation that all ratios of force to strain share.
    Wrinkled steps are left out. Raises `NotIdentifiableError` without capacitance.
    """
    steps = [step for recording in recordings for step in recording]
    warnings: list[str] = []
    used = [s for s in steps if s.capacitive_strain and not s.wrinkled and math.isfinite(s.force_step_n)]
    if not used:
        raise NotIdentifiableError(
            "no step has a capacitance", where=metadata.specimen_id, expected="a capacitance channel"
        )
    left_out = sum(bool(s.wrinkled) for s in steps)
    if left_out:
        warnings.append(f"{left_out} wrinkled steps left out of the line")
    x = np.array([s.capacitive_strain or 0.0 for s in used])
    y = np.array([s.force_step_n for s in used])
    sx = np.maximum([s.capacitive_strain_sd or 0.0 for s in used], 1e-9)
    sy = np.maximum([s.force_step_sd_n for s in used], 1e-9)
    nonlinearity = None
    if x.size < 3 or np.ptp(x) < 0.2 * x.max() or np.ptp(x) < 6 * float(np.median(sx)):
        slope = weighted_mean(y / x, np.abs(y / x) * np.hypot(sx / x, sy / np.maximum(np.abs(y), 1e-12)))
        r_squared = math.nan
        warnings.append(
            "one step only: no scatter, no linearity"
            if x.size == 1
            else "only one level of voltage: the line is taken through the origin"
        )
    else:
        fitted = line(x, y, sx, sy)
        slope, r_squared = fitted.slope, _r_squared(x, y)
        nonlinearity = _nonlinearity(x, y, fitted.sd)
    slope = slope.scaled(1.0, common_sd)
    modulus = _modulus(slope, metadata)
    if modulus is None:
        warnings.append("no film_width_mm, film_thickness_mm, stretch_1 or lengths of the regions: no modulus")
    sensitivity = _sensitivity(used, slope, metadata, mechanical_modulus)
    if sensitivity is None:
        needed = (
            "modulus of mechanical tests" if shared_region(metadata) else "relative_permittivity or active_width_mm"
        )
        warnings.append(f"no {needed}: the sensitivity cannot be measured")
    return SensingFit(
        slope,
        r_squared,
        modulus,
        sensitivity,
        predicted_sensitivity(metadata),
        _drift(recordings, slope),
        None,
        _exponent(used),
        len(used),
        nonlinearity,
        mechanical_modulus,
        "active" if shared_region(metadata) else "separate",
        tuple(warnings),
    )


def _r_squared(x: Float, y: Float) -> float:
    return float(np.corrcoef(x, y)[0, 1] ** 2)


def _nonlinearity(x: Float, y: Float, sd: Float) -> Estimate | None:
    """Departure c x²/(b x) of the parabola through the points from its tangent at 0, at the largest strain."""
    if x.size < 5 or np.unique(np.round(x / (0.05 * x.max()))).size < 4:
        return None
    top = float(x.max())
    design = np.column_stack([np.ones_like(x), x / top, (x / top) ** 2])
    solution, covariance, freedom = regression(design, y, sd, np.abs(y))
    b, c = float(solution[1]), float(solution[2])
    slopes = np.array([0.0, -c / b**2, 1 / b])
    return Estimate(c / b, math.sqrt(float(slopes @ covariance @ slopes)), freedom)


def _modulus(slope: Estimate, metadata: RecordingMetadata) -> Estimate | None:
    """Y with ΔF = w h Y (1 − λ_P): λ_P is λ_cap itself, or (√λ_cap − 1) ∂λ_P/∂λ_AR for one region of held width."""
    area = current_section_mm2(metadata)
    if area is None:
        return None
    if not shared_region(metadata):
        return slope.scaled(1 / area)
    passive = passive_stretch(metadata)
    return None if not passive else slope.scaled(2 / (-passive * area))


def creep_modulus(relaxation: Callable[[Float], Float], on_s: float, instant: float, mean: float) -> float:
    """Tension over strain at the end of a step, for a strain that creeps: ∫ E(t − s) dy(s), y the course of the strain.

    Neither the relaxation modulus (the strain is no jump) nor k0 (it has not ended): a film that creeps has young strain
    in it, which pulls harder. `instant` and `mean` fix y = a + (1 − a)(1 − e^{−t/τ})/(1 − e^{−T/τ}): its jump and its mean
    over the step's time T = `on_s`.
    """
    jump = min(max(instant, 0.0), 1.0)
    share = 0.999 if jump == 1.0 else min(max((mean - jump) / (1 - jump), 0.501), 0.999)
    rate = float(optimize.brentq(lambda u: 1 / -math.expm1(-u) - 1 / u - share, 1e-2, 2e3))
    edges = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 400)])
    course = -np.expm1(-rate * edges) / -math.expm1(-rate)
    middle = (edges[1:] + edges[:-1]) / 2
    young = np.diff(course) @ relaxation(on_s * np.maximum(1 - middle, 1e-9))
    return float(jump * relaxation(np.array([on_s]))[0] + (1 - jump) * young)


def _exponent(steps: Sequence[StepResponse]) -> Estimate | None:
    """Exponent of the force step in the voltage, from its logarithms; None without two levels."""
    v = np.log([s.voltage_kv for s in steps])
    size = np.array([s.force_step_n for s in steps])
    sd = np.array([s.force_step_sd_n for s in steps])
    kept = size > 5 * sd
    if kept.sum() < 3 or np.ptp(v[kept]) < _LEAST_SPAN:
        return None
    v, size, sd = v[kept], size[kept], sd[kept]
    design = np.column_stack([np.ones_like(v), v - v.mean()])
    solution, covariance, freedom = regression(design, np.log(size), sd / size, np.ones_like(v))
    return Estimate(float(solution[1]), math.sqrt(float(covariance[1, 1])), freedom)


def _sensitivity(
    steps: Sequence[StepResponse], slope: Estimate, metadata: RecordingMetadata, mechanical: Estimate | None
) -> Estimate | None:
    """∂λ_cap/∂λ_AR with λ_AR − 1 = (F_A − ΔF)/(w h Y): the active region carries what the load cell does not see.

    w h Y is the slope itself for a separate region; one region for both needs the modulus of mechanical tests.
    """
    drive, area = actuation_per_voltage_squared(metadata), current_section_mm2(metadata)
    stiffness: Estimate | None = slope
    if shared_region(metadata):
        stiffness = None if mechanical is None or area is None else mechanical.scaled(area)
    if drive is None or stiffness is None:
        return None
    values, noise, shares = [], [], []
    for s in steps:
        maxwell = drive.value * s.voltage_kv**2
        active = maxwell - s.force_step_n
        if not (active > 0 and s.capacitive_strain):
            continue
        sign = 1.0 if (s.capacitance_step_pf or 0.0) > 0 else -1.0
        value = sign * s.capacitive_strain * stiffness.value / active
        values.append(value)
        # Noise of the force is shared by slope and step; that of the strain is the larger by far.
        noise.append(
            abs(value) * math.hypot((s.capacitive_strain_sd or 0.0) / s.capacitive_strain, s.force_step_sd_n / active)
        )
        shares.append(maxwell / active)
    if not values:
        return None
    mean = weighted_mean(np.array(values), np.maximum(noise, 1e-12))
    # Permittivity and stiffness are the same in every step: a common error that averaging does not reduce.
    common = math.hypot(drive.sd / drive.value * float(np.mean(shares)), stiffness.sd / stiffness.value)
    return Estimate(mean.value, math.hypot(mean.sd, common * mean.value))


def _drift(recordings: Sequence[Sequence[StepResponse]], slope: Estimate) -> Estimate | None:
    """Slope of the rest capacitance against time at given force, pF/h: the force's own change is taken out.

    One slope for all recordings with five steps or more; each begins at a level of its own, and what the film has not
    recovered goes with the step before.
    """
    times: list[Float] = []
    levels: list[Float] = []
    before: list[Float] = []
    for recording in recordings:
        rest = [(s.start_s, s.capacitance_rest_pf, s.force_rest_n) for s in recording if s.capacitance_rest_pf]
        if len(rest) < 5:
            continue
        t, c, f = (np.array(column, dtype=float) for column in zip(*rest, strict=True))
        previous = np.array([0.0, *[s.capacitance_step_pf or 0.0 for s in recording if s.capacitance_rest_pf][:-1]])
        at_given_force = c - c.mean() * (f - f.mean()) / slope.value
        for column, kept in ((t, times), (at_given_force, levels), (previous, before)):
            kept.append(column - column.mean())
    if not times:
        return None
    design, y = np.column_stack([np.concatenate(times), np.concatenate(before)]), np.concatenate(levels)
    scale = np.linalg.norm(design, axis=0)
    design = design[:, scale > 0] / scale[scale > 0]
    if not scale[0]:
        return None
    covariance = np.linalg.pinv(design.T @ design)
    solution = covariance @ (design.T @ y)
    freedom = y.size - len(times) - design.shape[1]
    variance = float(np.sum((y - design @ solution) ** 2)) / freedom
    return Estimate(
        3600 * float(solution[0]) / scale[0], 3600 * math.sqrt(variance * covariance[0, 0]) / scale[0], freedom
    )
