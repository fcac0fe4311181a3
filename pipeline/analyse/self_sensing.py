"""Self-sensing of one specimen, from the steps and coats of its recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.controllers import analyse_controllers
from pipeline.analyse.inputs import Measured, all_of
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.relaxation.results import SpecimenFits
from pipeline.fit.sensing.coverage import FEWEST_COATS, fit_coverage
from pipeline.fit.sensing.gains import propose_gains
from pipeline.fit.sensing.self_sensing import SensingFit, creep_modulus, fit_sensing
from pipeline.fit.sensing.wrinkling import wrinkling
from pipeline.fit.weighted import Estimate
from pipeline.transform.coats import Coat
from pipeline.transform.loop import LoopResponse
from pipeline.transform.step import StepAnalysis, StepResponse
from schemas.metadata import RecordingMetadata
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


def analyse_self_sensing(
    analysis: Analysis, specimen_id: str, recordings: Sequence[Measured], forward: SpecimenFits | None
) -> None:
    """Steps of all recordings, the sensing fit and electrode coverage; `forward` is the specimen's mechanical model."""
    opened = _steps(analysis, specimen_id, recordings, forward)
    if forward is not None and opened:
        rig = next(one.rig for one in recordings if one.of(StepAnalysis))
        analyse_controllers(analysis, specimen_id, opened, forward.selected, rig)
    _gains(analysis, recordings)
    _coats(analysis, all_of(Coat, recordings))


def _steps(
    analysis: Analysis, specimen_id: str, recordings: Sequence[Measured], forward: SpecimenFits | None
) -> list[list[StepResponse]]:
    """Rows of all steps; returned are those of each recording with open loop, where they have a capacitance.

    Wrinkling shows only from one voltage to the next: the open-loop ones are marked together.
    """
    stepped = [one for one in recordings if one.of(StepAnalysis)]
    if not stepped or not isinstance(about := stepped[0].metadata, RecordingMetadata):
        return []
    steps = [[step for found in one.of(StepAnalysis) for step in found.steps] for one in stepped]
    levels = [step for one, own in zip(stepped, steps, strict=True) if not _closed(one) for step in own]
    judged = analysis.attempt("wrinkling", wrinkling, levels)
    onset = None
    if judged is not None:
        marked = iter(judged[0])
        onset = judged[1]
        steps = [own if _closed(one) else [next(marked) for _ in own] for one, own in zip(stepped, steps, strict=True)]
    for one, own in zip(stepped, steps, strict=True):
        rows = TABLES["step_responses"].from_objects(own, recording_id=one.recording_id, specimen_id=specimen_id)
        analysis.add({"step_responses": rows})
    if any(step.capacitance_step_pf is not None for own in steps for step in own):
        modulus = _mechanical_modulus(forward, about, steps)
        common = [found.common_sd for one in stepped for found in one.of(StepAnalysis) if found.steps]
        fit = analysis.attempt("self-sensing", fit_sensing, steps, about, modulus, float(np.median(common)))
        if fit is not None:
            analysis.add({"sensing_fits": sensing_table(specimen_id, replace(fit, wrinkling_onset_kv=onset))})
    opened = [own for one, own in zip(stepped, steps, strict=True) if not _closed(one)]
    return [own for own in opened if any(step.capacitance_step_pf is not None for step in own)]


def sensing_table(specimen_id: str, fit: SensingFit) -> pa.Table:
    """The row of `sensing_fits` of one specimen; warnings are empty, not NULL, where there are none."""
    return TABLES["sensing_fits"].from_objects(
        [fit],
        specimen_id=specimen_id,
        force_per_capacitive_strain_n=fit.force_per_capacitive_strain,
        warnings="; ".join(fit.warnings),
    )


def _gains(analysis: Analysis, recordings: Sequence[Measured]) -> None:
    """Gains for the specimen's controller, from the closed loops that were tried."""
    proposals = propose_gains(all_of(LoopResponse, recordings))
    rows = TABLES["controller_gains"].from_objects(
        proposals,
        recording_id=lambda one: one.best and one.best.recording_id,
        proportional_gain=lambda one: one.best and one.best.proportional_gain,
        integral_gain=lambda one: one.best and one.best.integral_gain,
        gentle_recording_id=lambda one: one.gentle and one.gentle.recording_id,
    )
    analysis.add({"controller_gains": rows})


def _coats(analysis: Analysis, coats: Sequence[Coat]) -> None:
    """Capacitance after each coat of electrode, and how coats cover the region, where there are enough of them."""
    rows = TABLES["electrode_coats"].from_objects(coats, capacitance_pf_sd=lambda coat: coat.capacitance_sd_pf)
    analysis.add({"electrode_coats": rows})
    if len(coats) >= FEWEST_COATS:
        fit = analysis.attempt("coverage", fit_coverage, coats)
        if fit is not None:
            analysis.add({"coverage_fits": TABLES["coverage_fits"].from_objects([fit])})


def _closed(recording: Measured) -> bool:
    return isinstance(recording.metadata, RecordingMetadata) and recording.metadata.controller == "closed"


def _mechanical_modulus(
    forward: SpecimenFits | None, about: RecordingMetadata, steps: Sequence[Sequence[StepResponse]]
) -> Estimate | None:
    """Modulus that the mechanical model gives a film that creeps as the capacitance does.

    None without model or sizes.
    """
    geometry = Geometry.of(about)
    courses = [
        (step.end_s - step.start_s, step.capacitance_instant_fraction, step.capacitance_mean_fraction)
        for own in steps
        for step in own
        if step.capacitance_instant_fraction is not None and step.capacitance_mean_fraction is not None
    ]
    if forward is None or geometry is None or not courses:
        return None
    fit = forward.selected
    on_s, instant, mean = (float(np.median(np.array(column, dtype=float))) for column in zip(*courses, strict=True))
    stiffness = creep_modulus(replace(fit.model, c_inf=0.0).relaxation, on_s, instant, mean)
    sd = float(fit.component_band([1 / (2 * np.pi * on_s)])[0][0])
    return Estimate(geometry.modulus_mpa(stiffness), geometry.modulus_mpa(sd))
