"""Electrical responses: the actuation force, and what mechanical and electrical recordings say about each other.

    H = −F/V² = a kL/(k + kL − Mω² + jωcL),   a = F_A/V² = ε0 εr w/z

At fixed length the film's relaxation shows only through the compliance of the load cell, so k comes from a mechanical fit with
its covariance as a prior, or is free where there is none. Does not belong here: mechanical fits (`relaxation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.fit.relaxation.assemble import assemble
from pipeline.fit.relaxation.details import Context
from pipeline.fit.relaxation.forward import GaussianPrior, polish
from pipeline.fit.relaxation.identify import ORDERS, Rigs, film_stiffness, identify, per_recording
from pipeline.fit.relaxation.linear import amplitude_given
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.relaxation.observations import Lines
from pipeline.fit.relaxation.positivity import positivity
from pipeline.fit.relaxation.predict import prediction_errors
from pipeline.fit.relaxation.reference import (
    Reference,
    find_reference,
    misfit_probability,
    refuse_hopeless,
    with_estimated_noise,
)
from pipeline.fit.relaxation.results import ELECTRICAL, FORWARD, JOINT, RelaxationFit, SpecimenFits
from pipeline.fit.relaxation.search import OrderFit
from pipeline.fit.relaxation.spread import by_group, with_spread
from pipeline.fit.relaxation.varpro import Candidate, bounds
from pipeline.transform.response import FrequencyResponse
from schemas.metadata import RigConstants
from schemas.numbers import p_equals

CONFLICT = 1e-3
"""Probability below which electrical recordings contradict the mechanical model."""


def fit_electrical(
    responses: Sequence[FrequencyResponse],
    rig: Rigs,
    mechanical: SpecimenFits | None = None,
    *,
    orders: Sequence[int] = ORDERS,
    gains: bool | None = None,
    specimen_id: str | None = None,
) -> SpecimenFits:
    """Models of the electrical recordings: F_A/V² with its standard deviation, and k(jω).

    With `mechanical`, each of its orders is taken up with the covariance of its material and rig constants as a prior, and its
    choice of the order stands; a contradiction between the two is a warning. Without, k is free and only what finite load-cell
    stiffness shows of it is determined. Recordings at different voltages may differ by a factor (random effect).

    Raises `NotIdentifiableError` where nothing is usable or the rig's constants are missing.
    """
    rigs = per_recording(rig, len(responses))
    observations, warnings, unknown = assemble(responses, rigs)
    name = specimen_id or next((r.specimen_id for r in responses if r.specimen_id), None)
    if mechanical is None:
        found = identify(
            observations,
            unknown,
            orders=orders,
            specimen_id=name or "",
            loading=ELECTRICAL,
            method=FORWARD,
            measured=(),
            gains=gains,
            warnings=(
                *warnings,
                "k from electrical recordings alone: it shows only through the load cell's compliance",
            ),
        )
        return replace(found, fits=tuple(_with_phase_error(f, responses, rigs) for f in found.fits))
    reference = find_reference(observations)
    refuse_hopeless(reference)
    if unknown:
        reference = with_estimated_noise(reference, unknown)
    parts = by_group(reference)
    alarm = positivity(parts, variance_estimated=bool(unknown))
    reference, spread = with_spread(reference, parts, gains=gains)
    observations = reference.observations
    fits = [_taken_up(reference, f, f.order >= mechanical.selected_order) for f in mechanical.fits]
    fits = [_with_phase_error(f, responses, rigs) for f in fits]
    remarks: tuple[str, ...] = (alarm.statement,) if alarm.raised else ()
    if spread.gain_sd:
        remarks += (f"recordings differ by a factor, standard deviation {100 * spread.gain_sd:.2g} %",)
    low, high = observations.omega_range
    return SpecimenFits(
        specimen_id=name or mechanical.specimen_id,
        loading=ELECTRICAL,
        method=FORWARD,
        fits=tuple(fits),
        selected_order=mechanical.selected_order,
        choices={"mechanical": mechanical.selected_order},
        positivity=alarm,
        spread=spread,
        frequency_low_hz=low / (2 * np.pi),
        frequency_high_hz=high / (2 * np.pi),
        warnings=warnings + remarks,
    )


def fit_joint(
    mechanical: Sequence[FrequencyResponse],
    electrical: Sequence[FrequencyResponse],
    rig: Rigs,
    *,
    orders: Sequence[int] = ORDERS,
    gains: bool | None = None,
    geometry: Geometry | None = None,
    specimen_id: str | None = None,
) -> SpecimenFits:
    """One model of both loadings: shared arms and rig constants, F_A/V² beside them. `rig` as in `fit_specimen`, for all."""
    responses = [*mechanical, *electrical]
    rigs = per_recording(rig, len(responses))
    observations, warnings, unknown = assemble(responses, rigs)
    name = specimen_id or next((r.specimen_id for r in responses if r.specimen_id), None)
    return identify(
        observations,
        unknown,
        orders=orders,
        specimen_id=name or "",
        loading=JOINT,
        method=FORWARD,
        measured=[film_stiffness(r, c) for r, c in zip(mechanical, rigs, strict=False)],
        geometry=geometry,
        gains=gains,
        warnings=warnings,
    )


def _taken_up(reference: Reference, fit: RelaxationFit, adequate: bool) -> RelaxationFit:
    """The electrical fit that starts from a mechanical one: Gaussian prior from its covariance, F_A/V² free.

    `reference` of the electrical data, with the rig as its file says.
    """
    observations, shape, size = reference.observations, fit.shape, fit.shape.size
    nuisance = observations.nuisance
    q = np.zeros(nuisance.size)
    # places of what both fits share: material, and the rigs that the mechanical fit has sharpened
    here, there = list(range(size)), list(range(size))
    taken: list[int] = []
    for r, prior in enumerate(observations.rigs):
        for s, own in enumerate(fit.rigs):
            if own.matches(prior):
                places = [i for i, n in enumerate(fit.names) if n.startswith(f"rig {s + 1} ")]
                there += places
                here += [size + p for p in nuisance.rigs[r]]
                taken += nuisance.rigs[r]
                q[list(nuisance.rigs[r])] = fit.theta[places]
    rows = ~nuisance.prior[:, taken].any(axis=1) if taken else np.ones(nuisance.target.size, dtype=bool)
    observations = replace(
        observations, nuisance=replace(nuisance, prior=nuisance.prior[rows], target=nuisance.target[rows])
    )
    k = [fit.model.stiffness(b.omega / (2 * np.pi)) for b in observations.blocks if isinstance(b, Lines)]
    if nuisance.amplitude is not None:
        q[nuisance.amplitude] = np.log(amplitude_given(observations, k, q))
    values, vectors = np.linalg.eigh(fit.covariance[np.ix_(there, there)])
    root = np.zeros((len(here), size + nuisance.size))
    root[:, here] = (vectors / np.sqrt(np.maximum(values, 1e-12 * values.max() + 1e-300))).T
    start = np.concatenate([fit.theta[:size], q])
    prior_of_fit = GaussianPrior(start.copy(), root)
    limits = bounds(*observations.omega_range)
    wide = (min(limits[0], *np.log(fit.model.tau), 0.0) - 5, max(limits[1], *np.log(fit.model.tau), 0.0) + 5)
    solution = polish(observations, start, shape, wide, prior=prior_of_fit)
    context = Context(observations, reference, wide, profile_all=False, prior=prior_of_fit)
    nothing = Candidate(np.zeros(0), np.zeros(0), 0.0, 0.0, solution.chi2)
    found = OrderFit(fit.order, solution, nothing, solution.chi2, _arms_only(fit.warnings))
    result = context.finished(context.detailed(found), found, profile=False, adequate=adequate)
    conflict = misfit_probability(solution.chi2, max(observations.data - 1, 1.0))
    if conflict < CONFLICT:
        note = f"the mechanical model does not fit the electrical recordings ({p_equals(conflict)})"
        result = replace(result, warnings=(*result.warnings, note))
    return replace(result, held_out_error=None)


def _arms_only(warnings: Sequence[str]) -> tuple[str, ...]:
    return tuple(w for w in warnings if w.startswith(("only", "arm", "k0 at")))


def _with_phase_error(
    fit: RelaxationFit, responses: Sequence[FrequencyResponse], rigs: Sequence[RigConstants | None]
) -> RelaxationFit:
    """Phase error of H itself; there is no stiffness to compare magnitudes with."""
    found = prediction_errors(fit, responses, rigs)
    return fit if found is None else replace(fit, phase_error_deg=found.phase_deg)
