"""From responses, relaxation curves and rig files to the `Observations` of a fit; refuses what cannot be fitted.

Weights: a response's `variance` covers both components, a component has half of it. Where neighbouring lines share data
(`effective_lines` below the number of lines) every weight is reduced so that χ² counts independent values only. A response
without variance gets relative weights of one unknown size, found later from the misfit of the best relaxation of any
order (`reference`). Does not belong here: models and searches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.fit.relaxation.observations import ELECTRICAL, FILM, MECHANICAL, Curve, Lines, Nuisance, Observations
from pipeline.fit.relaxation.staircase import UNEQUAL, find_step_factors
from pipeline.physics.held_step import FurtherRamp, Hold
from pipeline.physics.rig import RigPrior, missing_constants, rig_prior
from pipeline.transform.relaxation import SETTLED, RelaxationCurve
from pipeline.transform.response import FORCE_PER_VOLTAGE_SQUARED, STIFFNESS, FrequencyResponse
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants

UNKNOWN_RELATIVE_SD = 0.01
"""First guess of the relative noise of a response that comes without variance."""
RELATIVE_FLOOR = 1e-5
"""Least relative standard deviation that a variance may claim: no rig is better."""
CURVE_FLOOR = 1e-3
"""The same for relaxation curves, whose ramp is taken as a straight line between two samples."""


def assemble(
    responses: Sequence[FrequencyResponse],
    rigs: Sequence[RigConstants | None],
    relaxations: Sequence[RelaxationCurve] = (),
    relaxation_rigs: Sequence[RigConstants | None] = (),
    *,
    divided: bool = False,
) -> tuple[Observations, tuple[str, ...], frozenset[int]]:
    """Observations, warnings, and the numbers of the groups that came without variance.

    `divided`: the responses are the film's own (corrected); rigs are ignored, `systematic` columns become nuisance
    parameters. Raises `NotIdentifiableError` when nothing usable is there.
    """
    warnings: list[str] = []
    priors: list[RigPrior] = []
    known: list[RigConstants] = []
    groups: list[str] = []
    unknown: set[int] = set()
    parts: dict[tuple[str, int | None], list[Lines]] = {}
    single: list[Lines] = []
    data = 0.0
    lines = 0
    reasons: list[str] = []

    def rig_number(rig: RigConstants | None) -> int | None:
        if divided or rig is None:
            return None
        if rig in known:
            return known.index(rig)
        prior = rig_prior(rig)
        if prior is None:
            lack = missing_constants(rig)
            if lack and lack not in warnings:
                warnings.append(lack)
            return None
        warnings.extend(f"the rig file says nothing of it: {w}" for w in prior.assumed)
        warnings[:] = list(dict.fromkeys(warnings))
        known.append(rig)
        priors.append(prior)
        return len(known) - 1

    for response, rig in zip(responses, rigs, strict=True):
        usable, estimated, reason = _usable(response)
        if reason:
            reasons.append(f"{_name(response)}: {reason}")
        if not usable.frequency_hz.size:
            continue
        number = rig_number(rig)
        kind = _kind(usable, number)
        group = _group(groups, usable)
        if estimated:
            unknown.add(group)
        share = 1.0
        if usable.effective_lines is not None:
            share = min(1.0, usable.effective_lines / usable.frequency_hz.size)
        data += 2 * share * usable.frequency_hz.size
        lines += usable.frequency_hz.size
        block = Lines(
            kind=kind,
            omega=2 * np.pi * usable.frequency_hz,
            value=usable.value,
            weight=np.sqrt(2 * share / usable.variance),
            group=np.full(usable.frequency_hz.size, group, dtype=np.int64),
            rig=number,
            systematic=usable.systematic if divided else None,
        )
        if block.systematic is not None:
            single.append(block)
        else:
            parts.setdefault((kind, number), []).append(block)
    blocks: list[Lines | Curve] = [_concatenated(same) for same in parts.values()]
    blocks += single
    for curve, rig in zip(relaxations, relaxation_rigs, strict=True):
        number = rig_number(rig)
        prior = None if number is None else priors[number]
        part, estimated, reason = _curve(curve, len(groups), number, prior)
        if reason:
            reasons.append(f"{curve.recording_id or 'relaxation'}: {reason}")
        if part is None:
            continue
        if estimated:
            unknown.add(len(groups))
        groups.append(curve.recording_id or f"relaxation {len(groups) + 1}")
        blocks.append(part)
        data += part.rows
        lines += part.rows
    if not blocks:
        raise NotIdentifiableError(
            "no usable value to fit" + (": " + "; ".join(reasons[:4]) if reasons else ""),
            expected="at least one response with usable lines of finite value and variance",
            remedy="See unusable_because of frequency_responses",
        )
    warnings += reasons
    numbered = [replace(part, number=i) for i, part in enumerate(blocks)]
    observations = Observations(
        blocks=tuple(numbered),
        rigs=tuple(priors),
        nuisance=_nuisance(numbered, priors),
        groups=tuple(groups),
        data=data,
        lines=lines,
        variance_estimated=bool(unknown),
    )
    return observations, tuple(warnings), frozenset(unknown)


def _usable(response: FrequencyResponse) -> tuple[FrequencyResponse, bool, str]:
    """The lines to fit with a variance each, whether that variance is a guess, and why lines or all of it are left out."""
    finite = np.isfinite(response.value) & np.isfinite(response.frequency_hz) & (response.frequency_hz > 0)
    keep = response.usable & finite & (response.value != 0)
    if not keep.any():
        why = next((r for r in response.unusable_because if r), "no finite value above 0 Hz")
        return response.select(keep), False, f"no usable line ({why})"
    variance = np.asarray(response.variance, dtype=float)
    magnitude = np.abs(response.value)
    if np.isnan(variance[keep]).all() or not (variance[keep] > 0).any():
        guess = (UNKNOWN_RELATIVE_SD * magnitude) ** 2
        return replace(response, variance=guess).select(keep), True, ""
    good = keep & np.isfinite(variance) & (variance >= 0)
    reason = "" if (good == keep).all() else f"{int((keep & ~good).sum())} lines left out: variance not finite"
    if not good.any():
        return response.select(good), False, "no line has a finite variance"
    floor = np.maximum((RELATIVE_FLOOR * magnitude) ** 2, 1e-4 * float(np.median(variance[good])))
    return replace(response, variance=np.where(good, np.maximum(variance, floor), 1.0)).select(good), False, reason


def _curve(
    curve: RelaxationCurve, group: int, rig: int | None, prior: RigPrior | None
) -> tuple[Curve | None, bool, str]:
    """The block of a relaxation curve, whether its variance is a guess, and why it is left out or what must be said of it."""
    if curve.quantity != STIFFNESS:
        return None, False, f"a step response of {curve.quantity} is no stiffness"
    further = tuple(FurtherRamp(ramp.end_s - curve.ramp_s, ramp.ramp_s, ramp.step / curve.step) for ramp in curve.later)
    start, width = curve.window_s[:, 0] - curve.ramp_s, np.diff(curve.window_s, axis=1)[:, 0]
    hold = Hold(start, width, curve.ramp_s, further)
    good = curve.usable & np.isfinite(curve.stiffness) & (hold.since_last >= SETTLED * hold.last_ramp)
    good &= (curve.stiffness > 0) | bool(further)
    good &= curve.window_s[:, 1] > 0
    if not good.any():
        return None, False, "no usable value"
    variance, value = curve.variance[good], curve.stiffness[good]
    hold = replace(hold, start=start[good], width=width[good])
    # On the way down the force may be anything: what its ramps are off by goes with the largest that they led to.
    size = np.maximum.accumulate(np.abs(value)) if further else value
    estimated = not bool(np.isfinite(variance).all() and (variance > 0).all())
    if estimated:
        variance = (UNKNOWN_RELATIVE_SD * size) ** 2
    variance = np.maximum(variance, (CURVE_FLOOR * size) ** 2)
    variance = variance + (size * _ringing(hold.since_last, width[good], hold.last_ramp, size, prior)) ** 2 / 2
    offset = np.sqrt(curve.rest_variance) if np.isfinite(curve.rest_variance) else 0.0
    height = curve.step_sd / abs(curve.step) if np.isfinite(curve.step_sd) and curve.step else 0.0
    factors = None if estimated else find_step_factors(hold, value, variance, float(offset))
    unequal = 0.0 if factors is None else UNEQUAL
    told = "" if factors is None else factors.statement
    return Curve(hold, value, 1 / np.sqrt(variance), group, rig, float(offset), height, unequal), estimated, told


def _ringing(since: Float, width: Float, ramp: Float, stiffness: Float, prior: RigPrior | None) -> Float:
    """Amplitude (p,) of the clamp's ringing in means over windows (p,) s wide, (p,) s after ramps of (p,) s, as a share of the force.

    The model of a relaxation curve has the clamp at rest: it neglects the ringing that the ramp leaves, so that this counts as
    noise. Amplitude after a ramp of duration T: at most 2/(ωT) of the force, decaying with cL/2M; a mean over W leaves 2/(ωW).
    """
    if prior is None or prior.nominal[0] <= 0:
        return np.zeros(stiffness.size)
    rig = prior.rig
    omega = rig.clamp_omega * np.sqrt(rig.at_rest(stiffness))
    start = np.minimum(1.0, 2 / (omega * np.maximum(ramp, 1e-12)))
    decay = np.exp(-rig.damping / (2 * rig.mass) * np.maximum(since, 0.0))
    return np.asarray(start * decay * np.minimum(1.0, 2 / (omega * np.maximum(width, 1e-12))))


def _kind(response: FrequencyResponse, rig: int | None) -> str:
    if response.quantity == FORCE_PER_VOLTAGE_SQUARED:
        if rig is None:
            raise NotIdentifiableError(
                "an electrical response without the load cell's stiffness",
                where=_name(response),
                expected="load_cell_stiffness_n_per_mm in the rig file",
                remedy="Add the clamp and load-cell constants to the rig file",
            )
        return ELECTRICAL
    if response.quantity != STIFFNESS:
        raise NotIdentifiableError(
            f"a response of {response.quantity} is no stiffness", where=_name(response), expected=STIFFNESS
        )
    return FILM if rig is None else MECHANICAL


def _name(response: FrequencyResponse) -> str:
    return response.recording_id or f"{response.loading} response"


def _group(groups: list[str], response: FrequencyResponse) -> int:
    """Recordings that share a gain: single lines of one amplitude together, everything else by itself."""
    if response.frequency_hz.size <= 2 and response.amplitude is not None:
        name = f"amplitude {response.amplitude:.3g}"
        if name in groups:
            return groups.index(name)
    else:
        name = _name(response)
        if name in groups:
            name = f"{name} ({len(groups) + 1})"
    groups.append(name)
    return len(groups) - 1


def _concatenated(same: Sequence[Lines]) -> Lines:
    return Lines(
        kind=same[0].kind,
        omega=np.concatenate([b.omega for b in same]),
        value=np.concatenate([b.value for b in same]),
        weight=np.concatenate([b.weight for b in same]),
        group=np.concatenate([b.group for b in same]),
        rig=same[0].rig,
    )


def _nuisance(blocks: Sequence[Lines | Curve], priors: Sequence[RigPrior]) -> Nuisance:
    names: list[str] = []

    def places(stem: str, count: int) -> tuple[int, ...]:
        first = len(names)
        names.extend(f"{stem} {i + 1}" for i in range(count))
        return tuple(range(first, first + count))

    rigs = {r: places(f"rig {r + 1} direction", prior.size) for r, prior in enumerate(priors)}
    calibration: dict[int, tuple[int, ...]] = {}
    for i, block in enumerate(blocks):
        if isinstance(block, Curve):
            calibration[i] = places(f"curve {i + 1} offset and height", 2) + places(
                f"curve {i + 1} step", block.own_gains
            )
        elif block.systematic is not None:
            calibration[i] = places(f"response {i + 1} calibration", block.systematic.shape[1])
    amplitude = None
    if any(isinstance(b, Lines) and b.kind == ELECTRICAL for b in blocks):
        amplitude = len(names)
        names.append("log force_per_voltage_squared_n_per_kv2")
    prior_rows = np.eye(len(names))
    if amplitude is not None:
        prior_rows = np.delete(prior_rows, amplitude, axis=0)
    return Nuisance(
        names=tuple(names),
        prior=prior_rows,
        target=np.zeros(prior_rows.shape[0]),
        rigs=rigs,
        amplitude=amplitude,
        calibration=calibration,
    )
