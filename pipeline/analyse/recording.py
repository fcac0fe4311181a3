"""One recording, or one table that stands instead of recordings: its protocol decides what is computed."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ingest.samples import preview
from ingest.tables import LifetimeTable, RelaxationTable, ResponseTable
from pipeline.analyse.analysis import Analysis
from pipeline.analyse.assumptions import assumption_table, find_assumptions, find_table_assumptions
from pipeline.analyse.creep import NOT_ASKED as CREEP_NOT_ASKED
from pipeline.analyse.creep import analyse_creep
from pipeline.analyse.cycle import cycle_fits, cycle_loops, cycle_tables, lacks_stretch
from pipeline.analyse.description import join_texts, recording_row, table_row
from pipeline.analyse.isotonic import NOT_ASKED as ISOTONIC_NOT_ASKED
from pipeline.analyse.isotonic import analyse_isotonic
from pipeline.analyse.pull import NOT_ASKED, analyse_pull, pull_tables
from pipeline.analyse.responses import distortion_table, relaxation_table, response_table
from pipeline.analyse.session_features import SessionFeatures
from pipeline.analyse.signs import find_negative, sign_table
from pipeline.analyse.single import take_single
from pipeline.analyse.slow_voltage import NOT_ASKED as SLOW_VOLTAGE_NOT_ASKED
from pipeline.analyse.slow_voltage import analyse_slow_voltage
from pipeline.analyse.temperatures import TEMPERATURE
from pipeline.diagnose.features.encode import pack
from pipeline.diagnose.features.reduce import reduce, reducible
from pipeline.fit.sensing.migration import migration
from pipeline.transform.breakdown import detect_breakdown
from pipeline.transform.calibration import Calibration, TapCalibration, calibrate
from pipeline.transform.capacitance_cycles import capacitance_cycles
from pipeline.transform.coats import measure_coat
from pipeline.transform.correction import judged_machine
from pipeline.transform.force_map import measure_force_map
from pipeline.transform.loop import measure_loop
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.respond import respond
from pipeline.transform.response import STIFFNESS, FrequencyResponse
from pipeline.transform.step import StepAnalysis, StepResponse, measure_steps
from schemas.errors import NotIdentifiableError
from schemas.life_covariates import as_json
from schemas.lifetimes import LifetimeRow
from schemas.metadata import RecordingMetadata
from schemas.protocols import CALIBRATION, ELECTRICAL, MECHANICAL, OTHER
from schemas.recording import Recording
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

_ANSWERED = ("chirp", "noise", "sphs", "cyclic")
"""Protocols that give frequency responses."""
_RESPONSE = "response: "
"""Begins what is missing of a response."""


def analyse_content(
    content: Recording | LifetimeTable | ResponseTable | RelaxationTable, kind: str
) -> tuple[dict[str, Any], Analysis]:
    """The row of `recordings` that a content gets, and everything that is computed from it alone.

    `kind` is the kind of table that stands instead of a recording. What an analysis finds wrong, or fails at, is a problem of the row.
    """
    if isinstance(content, Recording):
        row, analysis = recording_row(content), analyse_recording(content)
        analysis.add({"previews": _draw_previews(content)})
        assumed = find_assumptions(content)
    else:
        row = table_row(content.metadata, kind, content.problems, content.notes)
        analysis = analyse_table(content)
        assumed = find_table_assumptions(content)
    analysis.add({"assumptions": assumption_table(content.metadata, assumed)})
    _tell_signs(analysis, content)
    notes = join_texts([row["notes"], *analysis.notes] if row["notes"] else analysis.notes)
    failed = [failure.splitlines()[0] for failure in analysis.failures]
    problem = join_texts(
        [p for p in (row["problem"], *analysis.problems, *(f"analysis failed: {f}" for f in failed)) if p]
    )
    return {**row, "notes": notes, "problem": problem}, analysis


def _tell_signs(analysis: Analysis, content: Recording | LifetimeTable | ResponseTable | RelaxationTable) -> None:
    """What came out negative is a finding, and somebody has to look at it."""
    about = content.metadata
    found = find_negative(content if isinstance(content, Recording) else None, analysis.carried)
    if found:
        analysis.problems += [one.statement for one in found]
        analysis.add({"discrepancies": sign_table(about.recording_id, about.specimen_id, found)})


def analyse_recording(recording: Recording) -> Analysis:
    """Everything that is computed from one recording alone."""
    about = recording.metadata
    analysis = Analysis()
    if about.loading == CALIBRATION:
        _calibration(analysis, recording)
    elif about.protocol == "lifetime":
        _life(analysis, recording)
    elif about.protocol == "step" and about.loading == ELECTRICAL:
        _steps(analysis, recording)
    elif about.protocol == "force_map":
        _force_map(analysis, recording)
    elif about.protocol == "cycle" and about.loading == ELECTRICAL:
        _slow_voltage(analysis, recording)
    elif about.protocol == "cycle":
        _cycle(analysis, recording)
    elif about.protocol == "creep":
        _creep(analysis, recording)
    elif about.protocol == "isotonic":
        _isotonic(analysis, recording)
    elif about.protocol == "pull":
        _pull(analysis, recording)
    elif about.protocol == "coverage":
        _coat(analysis, recording)
    else:
        _responses(analysis, recording)
    if reducible(about.protocol, about.loading) or about.loading == OTHER:
        if analysis.premises:
            features: SessionFeatures | None = SessionFeatures("", analysis.premises[0])
        else:
            features = analysis.attempt("features for the diagnosis", session_features, recording)
        if features is not None:
            analysis.carry(replace(features, unanswered=_find_unanswered(analysis, about)))
    return analysis


def _find_unanswered(analysis: Analysis, about: RecordingMetadata) -> str:
    """Why a test that gives a frequency response gave none with a line that can be used; empty where it did."""
    if about.protocol not in _ANSWERED:
        return ""
    responses = [one for one in analysis.carried if isinstance(one, FrequencyResponse)]
    if any(one.usable.any() for one in responses):
        return ""
    reasons = [text.removeprefix(_RESPONSE) for text in analysis.missing if text.startswith(_RESPONSE)]
    reasons += [because for one in responses for because in one.unusable_because if because]
    return reasons[0] if reasons else "no frequency can be used"


def session_features(recording: Recording) -> SessionFeatures:
    """The recording's features for the diagnosis of its specimen, or why there are none."""
    if recording.metadata.protocol == "cycle" and lacks_stretch(recording):
        return SessionFeatures("", "film_length_mm is missing: how far the film was stretched is not known")
    single = take_single(recording)
    try:
        return SessionFeatures(pack(reduce(_from_one_turn(recording))), single=single)
    except NotIdentifiableError as error:
        return SessionFeatures("", error.shortcoming, single)


def _from_one_turn(recording: Recording) -> Recording:
    """A sweep from 0 Hz as one from the lowest frequency that its record tells of: one turn in all of it."""
    about = recording.metadata
    start, stop = about.frequency_start_hz, about.frequency_stop_hz
    if 0 not in (start, stop) or not recording.duration_s > 0:
        return recording
    turn = 1 / recording.duration_s
    start, stop = turn if start == 0 else start, turn if stop == 0 else stop
    return replace(recording, metadata=replace(about, frequency_start_hz=start, frequency_stop_hz=stop))


def analyse_table(table: LifetimeTable | ResponseTable | RelaxationTable) -> Analysis:
    """What a table holds, in the rows and results that a recording would have given."""
    analysis = Analysis()
    if isinstance(table, LifetimeTable):
        analysis.carry(*table.rows)
        analysis.add({"lifetimes": lifetimes_table(table.rows)})
    elif isinstance(table, RelaxationTable):
        curve = relaxation_of(table)
        analysis.carry(curve)
        analysis.add({"relaxation_curves": relaxation_table(curve)})
    else:
        response = response_of(table)
        analysis.carry(response)
        analysis.add({"frequency_responses": response_table([response])})
    return analysis


def _draw_previews(recording: Recording) -> pa.Table:
    """The envelopes of all channels over the time since the recording's first sample."""
    table = TABLES["previews"]
    parts = []
    for quantity, channel in recording.channels.items():
        time_s, low, high = preview(channel)
        if time_s.size:
            since = time_s + (channel.time_ns[0] - recording.start_ns) * 1e-9
            about = {"recording_id": recording.metadata.recording_id, "quantity": quantity}
            parts.append(table.arrays(time_s.size, **about, time_s=since, low=low, high=high))
    return table.stack(parts)


def _calibration(analysis: Analysis, recording: Recording) -> None:
    result = analysis.attempt("calibration", calibrate, recording)
    if result is not None:
        analysis.carry(result)
        analysis.note(result.warnings)
        analysis.add({"calibrations": calibration_table(recording.metadata.recording_id, result)})


def calibration_table(recording_id: str, found: Calibration) -> pa.Table:
    """Two rows of `calibrations`: frequency and damping of a tapped clamp, gain and offset of a weighed force channel."""
    if isinstance(found, TapCalibration):
        repeats, prefix = found.taps, "loaded_" if found.extra_mass_kg else ""
        values = (
            (f"{prefix}clamp_frequency_hz", "Hz", found.frequency_hz, found.frequency_sd),
            (f"{prefix}damping_ratio", "", found.damping_ratio, found.damping_ratio_sd),
        )
    else:
        repeats = found.plateaus
        values = (
            ("force_gain", "", found.gain, found.gain_sd),
            ("force_offset_n", "N", found.offset_n, found.offset_sd),
        )
    about = {"recording_id": recording_id, "repeats": repeats, "warnings": "; ".join(found.warnings) or None}
    return TABLES["calibrations"].rows(
        {**about, "quantity": quantity, "unit": unit, "value": value, "sd": sd} for quantity, unit, value, sd in values
    )


def lifetimes_table(lives: Sequence[LifetimeRow]) -> pa.Table:
    """Rows of `lifetimes`."""
    return TABLES["lifetimes"].from_objects(
        lives, failure_mode=lambda life: life.mode, covariates=lambda life: as_json(life.covariates)
    )


def _life(analysis: Analysis, recording: Recording) -> None:
    life = analysis.attempt("breakdown", detect_breakdown, recording)
    if life is not None:
        analysis.carry(life)
        analysis.note(life.warnings)
        analysis.add({"lifetimes": lifetimes_table([life])})
        if life.contradiction:
            analysis.problems.append(f"breakdown: {life.contradiction}")
        if life.undecided:
            analysis.problems.append(f"breakdown: cannot be decided ({life.evidence or life.censored_because})")


def _steps(analysis: Analysis, recording: Recording) -> None:
    found = analysis.attempt("steps", measure_steps, recording)
    if found is not None:
        analysis.carry(found)
        analysis.note(found.warnings)
        if not any(math.isfinite(step.force_step_n) or step.capacitance_step_pf is not None for step in found.steps):
            analysis.lack(_tell_refused(found.steps))
        _slow_changes(analysis, recording.metadata, found)
    if recording.metadata.controller == "closed":
        loop = analysis.attempt("closed loop", measure_loop, recording)
        if loop is not None:
            analysis.carry(loop)
            analysis.note(loop.warnings)
            analysis.add({"loop_responses": TABLES["loop_responses"].from_objects([loop])})


def _tell_refused(steps: Sequence[StepResponse]) -> list[str]:
    """Why no step has a value, each reason once with how many it is of."""
    reasons = Counter(step.warnings[-1] for step in steps if step.warnings)
    return [f"steps: {count} of {len(steps)} have no value: {reason}" for reason, count in reasons.items()]


def _slow_changes(analysis: Analysis, about: RecordingMetadata, found: StepAnalysis) -> None:
    changes = {"force": found.force_change, "capacitance": found.capacitance_change}
    for quantity, change in changes.items():
        if change is not None:
            rows = TABLES["slow_changes"].from_objects(
                [change], recording_id=about.recording_id, specimen_id=about.specimen_id, quantity=quantity
            )
            analysis.add({"slow_changes": rows})


def _coat(analysis: Analysis, recording: Recording) -> None:
    coat = analysis.attempt("coverage", measure_coat, recording)
    if coat is not None:
        analysis.carry(coat)


def _force_map(analysis: Analysis, recording: Recording) -> None:
    found = analysis.attempt("force map", measure_force_map, recording)
    if found is not None:
        analysis.carry(found)
        analysis.note(found.warnings)


def _cycle(analysis: Analysis, recording: Recording) -> None:
    found = analysis.attempt("cycle", cycle_fits, recording)
    if found is not None:
        analysis.carry(found.fits[0])
        analysis.add(cycle_tables(found))
    _loops(analysis, recording)


def _loops(analysis: Analysis, recording: Recording) -> None:
    loops = analysis.attempt("loops", cycle_loops, recording)
    if loops is not None:
        analysis.add({"cycle_loops": loops})


def _pull(analysis: Analysis, recording: Recording) -> None:
    about = recording.metadata
    found = analysis.attempt("pull", analyse_pull, recording)
    if found is not None:
        analysis.note((*found.pull.warnings, NOT_ASKED))
        analysis.add(pull_tables(about.recording_id, about.specimen_id, found))


def _creep(analysis: Analysis, recording: Recording) -> None:
    _note_and_add(analysis, analysis.attempt("creep", analyse_creep, recording), CREEP_NOT_ASKED)


def _isotonic(analysis: Analysis, recording: Recording) -> None:
    made = analysis.attempt("strokes at constant load", analyse_isotonic, recording)
    _note_and_add(analysis, made, ISOTONIC_NOT_ASKED)


def _slow_voltage(analysis: Analysis, recording: Recording) -> None:
    made = analysis.attempt("force under a slow voltage", analyse_slow_voltage, recording)
    _note_and_add(analysis, made, SLOW_VOLTAGE_NOT_ASKED)


def _note_and_add(analysis: Analysis, made: tuple[tuple[str, ...], dict[str, pa.Table]] | None, not_asked: str) -> None:
    """Warnings and tables of a test that the diagnosis does not ask; nothing where none could be made."""
    if made is not None:
        warnings, tables = made
        analysis.note((*warnings, not_asked))
        analysis.add(tables)


def _responses(analysis: Analysis, recording: Recording) -> None:
    found = analysis.attempt("response", respond, recording)
    if found is not None:
        analysis.carry(*found.responses)
        analysis.note(found.warnings)
        analysis.add(
            {
                "frequency_responses": response_table(found.responses),
                "distortions": distortion_table(recording.metadata.recording_id, found.distortions),
            }
        )
        if found.relaxation is not None:
            analysis.carry(found.relaxation)
            analysis.add({"relaxation_curves": relaxation_table(found.relaxation)})
        if (recording.metadata.protocol, recording.metadata.loading) == ("cyclic", MECHANICAL):
            _loops(analysis, recording)
        if recording.metadata.protocol == "cyclic" and "capacitance" in recording.channels:
            _migration(analysis, recording, float(found.responses[0].frequency_hz[0]))


def _migration(analysis: Analysis, recording: Recording, frequency_hz: float) -> None:
    cycles = analysis.attempt("capacitance by cycle", capacitance_cycles, recording, frequency_hz)
    if cycles is None:
        return
    size = np.abs(cycles.harmonics)
    rows = TABLES["electrode_cycles"].arrays(
        cycles.cycle.size,
        recording_id=cycles.recording_id,
        specimen_id=cycles.specimen_id,
        cycle=cycles.cycle,
        mean_pf=cycles.mean_pf,
        amplitude_pf=cycles.amplitude_pf,
        distortion=cycles.distortion,
        second_harmonic=size[:, 0],
        third_harmonic=size[:, 1] if size.shape[1] > 1 else None,
    )
    analysis.add({"electrode_cycles": rows})
    onset = analysis.attempt("electrode migration", migration, cycles)
    if onset is not None:
        analysis.add({"electrode_migrations": TABLES["electrode_migrations"].from_objects([onset])})


def response_of(table: ResponseTable) -> FrequencyResponse:
    """The response of a film that a machine computed: clamp and load cell are not in it (no rig goes with it)."""
    usable = np.isfinite(table.value) & (table.frequency_hz > 0)
    response = FrequencyResponse(
        frequency_hz=table.frequency_hz,
        value=table.value,
        variance=table.standard_error**2,
        usable=usable,
        unusable_because=tuple("" if good else "no value" for good in usable),
        quantity=STIFFNESS,
        loading=MECHANICAL,
        amplitude=table.metadata.strain_pp,
        recording_id=table.metadata.recording_id,
        specimen_id=table.metadata.specimen_id,
        details=_details(table),
    )
    return judged_machine(response, table.own_deformation)


def relaxation_of(table: RelaxationTable) -> RelaxationCurve:
    """The relaxation that a machine computed: the step is a jump, the values belong to instants."""
    usable = np.isfinite(table.value) & (table.time_s > 0)
    return RelaxationCurve(
        time_s=table.time_s,
        window_s=np.column_stack([table.time_s, table.time_s]),
        stiffness=table.value,
        variance=table.standard_error**2,
        usable=usable,
        ramp_s=0.0,
        step=1.0,
        rest_variance=0.0,
        step_sd=0.0,
        unusable_because=tuple("" if good else "no value" for good in usable),
        quantity=STIFFNESS,
        recording_id=table.metadata.recording_id,
        specimen_id=table.metadata.specimen_id,
        details=_details(table),
    )


def _details(table: ResponseTable | RelaxationTable) -> dict[str, Any]:
    """What a table says beside its values: what they are, in which unit they came, at which temperature."""
    about = {"measured_as": table.measured_as, "scale": table.scale, "unit": table.unit}
    given = table.temperature_c
    if given is None or not np.isfinite(given).any():
        return about
    return about | {TEMPERATURE: float(np.nanmean(given))}
