"""One recording, or one table that stands instead of recordings: its protocol decides what is computed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ingest.samples import preview
from ingest.tables import LifetimeTable, RelaxationTable, ResponseTable
from pipeline.analyse.alone import alone_of
from pipeline.analyse.analysis import Analysis
from pipeline.analyse.cycle import cycle_fits
from pipeline.analyse.rows.calibrations import calibration_table
from pipeline.analyse.rows.cycles import cycle_tables
from pipeline.analyse.rows.lifetimes import lifetime_table
from pipeline.analyse.rows.recordings import joined, preview_table, recording_row, table_row
from pipeline.analyse.rows.responses import distortion_table, response_table
from pipeline.analyse.rows.self_sensing import loop_table, migration_tables, slow_table
from pipeline.analyse.session_features import SessionFeatures
from pipeline.analyse.tables import relaxation_of, response_of
from pipeline.diagnose.features.encode import pack
from pipeline.diagnose.features.reduce import reduce, reducible
from pipeline.fit.sensing.migration import migration
from pipeline.transform.breakdown import detect_breakdown
from pipeline.transform.calibration import calibrate
from pipeline.transform.capacitance_cycles import capacitance_cycles
from pipeline.transform.coats import measure_coat
from pipeline.transform.force_map import measure_force_map
from pipeline.transform.loop import measure_loop
from pipeline.transform.respond import respond
from pipeline.transform.step import measure_steps
from schemas.errors import NotIdentifiableError
from schemas.protocols import CALIBRATION, ELECTRICAL, OTHER
from schemas.recording import Recording

if TYPE_CHECKING:
    import pyarrow as pa


def analyse_content(
    content: Recording | LifetimeTable | ResponseTable | RelaxationTable, kind: str
) -> tuple[dict[str, Any], Analysis]:
    """The row of `recordings` that a content gets, and everything that is computed from it alone.

    `kind` is the kind of table that stands instead of a recording. What an analysis finds wrong, or fails at, is a problem of the row.
    """
    if isinstance(content, Recording):
        row, analysis = recording_row(content), analyse_recording(content)
        analysis.add({"previews": _draw_previews(content)})
    else:
        row = table_row(content.metadata, kind, content.problems, content.notes)
        analysis = analyse_table(content)
    notes = joined([row["notes"], *analysis.notes] if row["notes"] else analysis.notes)
    failed = [failure.splitlines()[0] for failure in analysis.failures]
    problem = joined([p for p in (row["problem"], *analysis.problems, *(f"analysis failed: {f}" for f in failed)) if p])
    return {**row, "notes": notes, "problem": problem}, analysis


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
    elif about.protocol == "cycle":
        _cycle(analysis, recording)
    elif about.protocol == "coverage":
        _coat(analysis, recording)
    else:
        _responses(analysis, recording)
    if reducible(about.protocol, about.loading) or about.loading == OTHER:
        features = analysis.attempt("features for the diagnosis", session_features, recording)
        if features is not None:
            analysis.carry(features)
    return analysis


def session_features(recording: Recording) -> SessionFeatures:
    """The recording's features for the diagnosis of its specimen, or why there are none."""
    alone = alone_of(recording)
    try:
        return SessionFeatures(pack(reduce(recording)), alone=alone)
    except NotIdentifiableError as error:
        return SessionFeatures("", error.shortcoming, alone)


def analyse_table(table: LifetimeTable | ResponseTable | RelaxationTable) -> Analysis:
    """What a table holds, in the rows and results that a recording would have given."""
    analysis = Analysis()
    if isinstance(table, LifetimeTable):
        analysis.carry(*table.rows)
        analysis.add({"lifetimes": lifetime_table(table.rows)})
    elif isinstance(table, RelaxationTable):
        analysis.carry(relaxation_of(table))
    else:
        response = response_of(table)
        analysis.carry(response)
        analysis.add({"frequency_responses": response_table([response])})
    return analysis


def _draw_previews(recording: Recording) -> pa.Table:
    """The envelopes of all channels over the time since the recording's first sample."""
    envelopes = {}
    for quantity, channel in recording.channels.items():
        time_s, low, high = preview(channel)
        if time_s.size:
            envelopes[quantity] = (time_s + (channel.time_ns[0] - recording.start_ns) * 1e-9, low, high)
    return preview_table(recording.metadata.recording_id, envelopes)


def _calibration(analysis: Analysis, recording: Recording) -> None:
    result = analysis.attempt("calibration", calibrate, recording)
    if result is not None:
        analysis.carry(result)
        analysis.note(result.warnings)
        analysis.add({"calibrations": calibration_table(recording.metadata.recording_id, result)})


def _life(analysis: Analysis, recording: Recording) -> None:
    life = analysis.attempt("breakdown", detect_breakdown, recording)
    if life is not None:
        analysis.carry(life)
        analysis.add({"lifetimes": lifetime_table([life])})
        if life.contradiction:
            analysis.problems.append(f"breakdown: {life.contradiction}")
        if life.undecided:
            analysis.problems.append(f"breakdown: cannot be decided ({life.evidence or life.censored_because})")


def _steps(analysis: Analysis, recording: Recording) -> None:
    found = analysis.attempt("steps", measure_steps, recording)
    if found is not None:
        analysis.carry(found)
        analysis.note(found.warnings)
        analysis.add({"slow_changes": slow_table(recording.metadata, found)})
    if recording.metadata.controller == "closed":
        loop = analysis.attempt("closed loop", measure_loop, recording)
        if loop is not None:
            analysis.carry(loop)
            analysis.note(loop.warnings)
            analysis.add({"loop_responses": loop_table(loop)})


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
        analysis.add(cycle_tables(found.fits, found.time_s, found.stretch, found.stress))


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
        if recording.metadata.protocol == "cyclic" and "capacitance" in recording.channels:
            _migration(analysis, recording, float(found.responses[0].frequency_hz[0]))


def _migration(analysis: Analysis, recording: Recording, frequency_hz: float) -> None:
    cycles = analysis.attempt("capacitance by cycle", capacitance_cycles, recording, frequency_hz)
    if cycles is not None:
        onset = analysis.attempt("electrode migration", migration, cycles)
        analysis.add(migration_tables(cycles, onset))
