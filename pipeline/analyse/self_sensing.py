"""Self-sensing of one specimen, from the steps and coats of its recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.inputs import Measured, all_of
from pipeline.analyse.rows.self_sensing import coverage_tables, gains_table, sensing_table
from pipeline.analyse.rows.steps import step_table
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.relaxation.results import SpecimenFits
from pipeline.fit.sensing.coverage import FEWEST_COATS, fit_coverage
from pipeline.fit.sensing.gains import propose_gains
from pipeline.fit.sensing.self_sensing import creep_modulus, fit_sensing
from pipeline.fit.sensing.wrinkling import wrinkling
from pipeline.fit.weighted import Estimate
from pipeline.transform.coats import Coat
from pipeline.transform.loop import LoopResponse
from pipeline.transform.step import StepAnalysis, StepResponse
from schemas.metadata import RecordingMetadata


def analyse_self_sensing(
    analysis: Analysis, specimen_id: str, recordings: Sequence[Measured], forward: SpecimenFits | None
) -> None:
    """Steps of all recordings, the sensing fit and electrode coverage; `forward` is the specimen's mechanical model."""
    _steps(analysis, specimen_id, recordings, forward)
    analysis.add({"controller_gains": gains_table(propose_gains(all_of(LoopResponse, recordings)))})
    coats = all_of(Coat, recordings)
    if coats:
        fit = analysis.attempt("coverage", fit_coverage, coats) if len(coats) >= FEWEST_COATS else None
        analysis.add(coverage_tables(coats, fit))


def _steps(analysis: Analysis, specimen_id: str, recordings: Sequence[Measured], forward: SpecimenFits | None) -> None:
    """Wrinkling shows only from one voltage to the next, so the open-loop steps of all recordings are marked together."""
    stepped = [one for one in recordings if one.of(StepAnalysis)]
    if not stepped or not isinstance(about := stepped[0].metadata, RecordingMetadata):
        return
    steps = [[step for found in one.of(StepAnalysis) for step in found.steps] for one in stepped]
    levels = [step for one, own in zip(stepped, steps, strict=True) if not _closed(one) for step in own]
    judged = analysis.attempt("wrinkling", wrinkling, levels)
    onset = None
    if judged is not None:
        marked = iter(judged[0])
        onset = judged[1]
        steps = [own if _closed(one) else [next(marked) for _ in own] for one, own in zip(stepped, steps, strict=True)]
    for one, own in zip(stepped, steps, strict=True):
        analysis.add({"step_responses": step_table(one.recording_id, own, specimen_id)})
    if any(step.capacitance_step_pf is not None for own in steps for step in own):
        modulus = _mechanical_modulus(forward, about, steps)
        common = [found.common_sd for one in stepped for found in one.of(StepAnalysis) if found.steps]
        fit = analysis.attempt("self-sensing", fit_sensing, steps, about, modulus, float(np.median(common)))
        if fit is not None:
            analysis.add({"sensing_fits": sensing_table(specimen_id, replace(fit, wrinkling_onset_kv=onset))})


def _closed(recording: Measured) -> bool:
    return isinstance(recording.metadata, RecordingMetadata) and recording.metadata.controller == "closed"


def _mechanical_modulus(
    forward: SpecimenFits | None, about: RecordingMetadata, steps: Sequence[Sequence[StepResponse]]
) -> Estimate | None:
    """Modulus that the mechanical model gives a film that creeps as the capacitance does; None without model or sizes."""
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
