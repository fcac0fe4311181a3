"""The recording stage: read a raw file, check it, write its samples, analyse it, keep the results.

Whatever is wrong with the file ends as an outcome with its reason; only a lab that cannot be written stops the night.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ingest.canonical import canonical
from ingest.discover import check_unchanged
from ingest.read import read_raw
from ingest.remote import staged
from ingest.rigs import find_rig
from ingest.samples import preview, write_samples
from pipeline.analyse.analysis import Analysis
from pipeline.analyse.carried import carried_table
from pipeline.analyse.recording import analyse_recording, analyse_table
from pipeline.analyse.rows.recordings import (
    joined,
    preview_table,
    recording_row,
    recordings_table,
    refused_row,
    table_row,
)
from pipeline.lab.journal import (
    DAMAGED,
    FAILED,
    OK,
    PENDING,
    QUARANTINED,
    Freshness,
    Outcome,
    unwritable,
    write_entry,
)
from pipeline.lab.paths import source_text
from pipeline.nightly.stages import RecordingTask, as_facts, input_hash, mapping_hash, rig_hash
from schemas.errors import DealabError, LabError, PendingError
from schemas.recording import RawRecording, Recording, Source

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass
class _Progress:
    """What is known so far, for the outcome of a file that turns out to be unusable."""

    given: Mapping[str, Any] = field(default_factory=dict)
    rig_id: str | None = None


def run(task: RecordingTask) -> Outcome:
    """Reads and analyses a file. Raises `LabError` when the lab cannot be written, `MemoryError` when memory ends."""
    started = time.monotonic()
    progress = _Progress()
    problem: DealabError | None = None
    error_text = None
    try:
        with staged(task.source.path, task.source.remote):
            row, analysis, samples = _processed(task, progress)
        outcome = OK if row["status"] == "ok" else DAMAGED
        if analysis.failures:
            outcome, error_text = FAILED, "\n".join(analysis.failures)
    except (LabError, MemoryError):
        raise
    except PendingError as error:
        return _outcome(task, progress, PENDING, started, str(error))
    except DealabError as error:
        problem = error
    except Exception as error:
        summary = f"reading it failed unexpectedly: {type(error).__name__}: {error}"
        problem = DealabError(summary, where=task.source.path.name, remedy="Report this with the file")
        error_text = f"{summary}\n{traceback.format_exc()}"
    if problem is not None:
        kind = task.source.mapping.kind if task.source.mapping is not None else "recording"
        row, analysis, samples = refused_row(progress.given, str(problem), kind), Analysis(), None
        outcome, error_text = QUARANTINED, error_text or str(problem)
    done = _outcome(
        task,
        progress,
        outcome,
        started,
        error_text,
        retry=problem is not None and problem.transient,
        recording_id=row.get("recording_id"),
        specimen_id=row.get("specimen_id"),
        protocol=row.get("protocol"),
        status=row["status"],
        problem=row["problem"],
        samples_path=samples,
        refusal=None if problem is None else as_facts(problem),
        carried=sorted({type(result).__name__ for result in analysis.carried}),
    )
    row |= {
        "rig_id": row.get("rig_id") or progress.rig_id,
        "source_path": source_text(task.source),
        "source_sha256": task.sha256,
        "samples_path": samples,
        "source_present": True,
    }
    analysis.add({"recordings": recordings_table([row])})
    _keep(task.journal, done, analysis, row.get("recording_id"))
    return done


def _processed(task: RecordingTask, progress: _Progress) -> tuple[dict[str, Any], Analysis, str | None]:
    """The file's row of `recordings`, its results and where its samples are. Raises `DealabError` for unusable files."""
    source = task.source
    if source.error is not None:
        raise source.error
    raw = read_raw(source.path, source.mapping)
    check_unchanged(source.path, size=source.size, mtime_ns=source.mtime_ns)
    if not isinstance(raw, RawRecording):
        progress.given = {key: getattr(raw.metadata, key) for key in ("recording_id", "specimen_id")}
        analysis = analyse_table(raw)
        kind = source.mapping.kind if source.mapping is not None else "table"
        return _with_notes(table_row(raw.metadata, kind, raw.problems, raw.notes), analysis), analysis, None
    progress.given = raw.metadata
    named = raw.rig.get("rig_id") or raw.metadata.get("rig_id")
    progress.rig_id = None if named is None else str(named)
    rig = find_rig(progress.rig_id, source.path, root=source.root, rigs=task.rigs)
    recording = canonical(
        raw,
        where=source.path.name,
        rig_file=None if rig is None else rig.values,
        source=Source(source_text(source), task.sha256, source.size),
    )
    samples = _written(recording, task)
    analysis = analyse_recording(recording)
    analysis.add({"previews": _previews(recording)})
    return _with_notes(recording_row(recording), analysis), analysis, samples


def _with_notes(row: dict[str, Any], analysis: Analysis) -> dict[str, Any]:
    """The row with what the analysis had to say; an analysis that failed is a problem of the recording."""
    notes = joined([row["notes"], *analysis.notes] if row["notes"] else analysis.notes)
    failed = [failure.splitlines()[0] for failure in analysis.failures]
    problem = joined([p for p in (row["problem"], *(f"analysis failed: {f}" for f in failed)) if p])
    return {**row, "notes": notes, "problem": problem}


def _written(recording: Recording, task: RecordingTask) -> str:
    try:
        return write_samples(recording, task.lab, staged=task.staged)
    except OSError as error:
        raise unwritable(task.staged.parent, error) from error


def _keep(journal: Path, outcome: Outcome, analysis: Analysis, recording_id: str | None) -> None:
    tables: dict[str, pa.Table] = analysis.joined()
    if recording_id is not None:
        tables["carried"] = carried_table(recording_id, analysis.carried)
    write_entry(journal, outcome, tables)


def _previews(recording: Recording) -> pa.Table:
    envelopes = {}
    for quantity, channel in recording.channels.items():
        time_s, low, high = preview(channel)
        if time_s.size:
            envelopes[quantity] = (time_s + (channel.time_ns[0] - recording.start_ns) * 1e-9, low, high)
    return preview_table(recording.metadata.recording_id, envelopes)


def _outcome(
    task: RecordingTask,
    progress: _Progress,
    outcome: str,
    started: float,
    error: str | None,
    *,
    retry: bool = False,
    **facts: Any,
) -> Outcome:
    rig = rig_hash(task.source, progress.rig_id, task.rigs)
    made_from = "" if retry else input_hash(mapping_hash(task.source), task.sha256, rig)
    return Outcome(
        task.item_id,
        task.stage,
        Freshness(made_from, task.code_version, task.settings_hash),
        outcome,
        round(time.monotonic() - started, 3),
        error,
        {"rig_id": progress.rig_id, **facts},
    )
