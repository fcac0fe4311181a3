"""What was measured: recordings, who took them out and why, their envelopes."""

from __future__ import annotations

from schemas.assumptions import BETWEEN_SAMPLES
from schemas.tables.table import (
    CONFIGURATION,
    RECORDING_ID,
    MadeBy,
    Table,
    instant,
    real,
    text,
    truth,
    whole,
)

TABLES: tuple[Table, ...] = (
    Table(
        "recordings",
        "one row per file that was found as a recording or refused as one",
        (
            text("recording_id", "identity of the recording; NULL where a refused file's cannot be read"),
            text("campaign", "the campaign"),
            text("specimen_id", "the specimen"),
            text("material", "the film's material"),
            CONFIGURATION,
            text("protocol", "kind of test"),
            text("loading", "mechanical, electrical, calibration or other"),
            text("rig_id", "the rig"),
            text("operator", "who measured"),
            instant("started_at", "start of the test, UTC"),
            real("duration_s", "s", "first to last sample"),
            whole("sample_count", "samples of all channels together"),
            text("source_path", "file it was read from, absolute"),
            text(
                "source_sha256",
                "SHA-256 of that file; where mappings read the same bytes in different ways, further ones have a mark",
            ),
            text("samples_path", "samples Parquet, relative to the lab"),
            text("status", "ok, damaged (usable in part), quarantined, duplicate, pending or excluded"),
            text("problem", "what is lost, wrong or refused, and what was expected; NULL when nothing is"),
            text("notes", "what is worth knowing and no fault: jitter, gaps"),
            text("kind", "recording, lifetimes or frequency_response"),
            text("metadata", "all keys of the recording and its rig, JSON"),
            text("software_version", "version that read it"),
            text("run_id", "run in which it came in or last changed"),
            truth("source_present", "the source file was still there in the last run that looked for it"),
        ),
        key=("started_at", "recording_id", "source_path"),
        made_by=(MadeBy("night"),),
        pages=("index", "campaign", "specimen", "recording", "control"),
        result_where="false",
    ),
    Table(
        "annotations",
        "recordings taken out of the analysis or back in, by whom and why",
        (
            text("recording_id", "the recording"),  # which may have been forgotten since
            text("action", "exclude or include"),
            text("why", "the reason given"),
            text("author", "who"),
            instant("at", "when, UTC"),
        ),
        key=("at", "recording_id"),
        made_by=(MadeBy("night"),),
        pages=("index", "specimen", "recording"),
        result_where="false",
    ),
    Table(
        "previews",
        "envelope of each channel for the pages, at most 2000 points",
        (
            RECORDING_ID,
            text("quantity", "the channel"),
            real("time_s", "s", "since the recording's first sample"),
            real("low", "canonical unit", "least value in the interval that begins here"),
            real("high", "canonical unit", "largest value in that interval"),
        ),
        key=("recording_id", "quantity", "time_s"),
        made_by=(MadeBy("recording"),),
        pages=("specimen", "recording"),
        result_where="false",
    ),
    Table(
        "assumptions",
        "what the results of a recording or table rest on that nothing says: one row per assumption and recording",
        (
            RECORDING_ID,
            text("specimen_id", "the specimen; NULL for a table of many", refers_to="specimen_id"),
            text("what", "what is assumed", required=True),
            text("value", "the value that it is taken to have, with its unit", required=True),
            text("because", "what is missing, or why it cannot be known"),
            text("touches", "results that rest on it"),
        ),
        key=("recording_id", "what"),
        made_by=(
            MadeBy("recording", where=f"what <> '{BETWEEN_SAMPLES}'"),
            MadeBy("diagnosis", where=f"what = '{BETWEEN_SAMPLES}'"),
        ),
        pages=("specimen", "recording"),
        result_where="false",
    ),
    Table(
        "without_result",
        "every recording or table that led to no result, or to no diagnosis for want of a key that its protocol needs, and what was"
        " missing; refused files as well",
        (
            text("recording_id", "the recording; NULL where a refused file's id cannot be read"),
            text("source_path", "file it was read from, absolute"),
            text("status", "ok, damaged (usable in part) or quarantined"),
            text("what_was_missing", "why there is no result, and what was expected", required=True),
        ),
        key=("source_path", "recording_id"),
        made_by=(MadeBy("night"),),
        pages=("index", "specimen", "recording"),
        result_where="false",
    ),
)
