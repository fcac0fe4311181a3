"""Sensing electrodes: coats that cover a region, and their migration under cyclic strain."""

from __future__ import annotations

from schemas.tables.table import (
    RECORDING_ID,
    SPECIMEN_ID,
    MadeBy,
    Table,
    real,
    text,
    whole,
    with_bounds,
    with_sd,
    with_uncertainty,
)

TABLES: tuple[Table, ...] = (
    Table(
        "electrode_coats",
        "capacitance at rest after each coat of electrode",
        (
            RECORDING_ID,
            SPECIMEN_ID,
            whole("coats", "coats so far"),
            *with_sd("capacitance_pf", "pF", "capacitance at rest"),
        ),
        key=("specimen_id", "coats"),
        made_by=(MadeBy("specimen"),),
        pages=("specimen",),
    ),
    Table(
        "coverage_fits",
        "how coats of electrode cover a sensing region",
        (
            SPECIMEN_ID,
            whole("coats", "most coats measured"),
            *with_uncertainty("full_pf", "pF", "capacitance of the covered region"),
            *with_uncertainty("first_share", "", "share that the first coat covers"),
            *with_uncertainty("coats_to_cover", "", "coats that cover 99 %"),
            text("form", "likeliest form of the rise; the numbers are averages over three"),
            text("warnings", "what limits the fit"),
        ),
        key=("specimen_id",),
        made_by=(MadeBy("specimen"),),
        pages=("specimen",),
    ),
    Table(
        "electrode_cycles",
        "wave of a capacitance under cyclic strain, cycle by cycle",
        (
            RECORDING_ID,
            SPECIMEN_ID,
            whole("cycle", "number of the cycle, from 1"),
            real("mean_pf", "pF", "mean"),
            real("amplitude_pf", "pF", "amplitude of the fundamental"),
            real("distortion", "", "root sum of squares of the harmonics over the fundamental"),
            real("second_harmonic", "", "second harmonic over the fundamental"),
            real("third_harmonic", "", "third harmonic over the fundamental"),
        ),
        key=("recording_id", "cycle"),
        made_by=(MadeBy("recording"),),
        pages=("specimen",),
    ),
    Table(
        "electrode_migrations",
        "from which cycle on a sensing electrode migrates",
        (
            RECORDING_ID,
            SPECIMEN_ID,
            whole("cycles", "cycles measured"),
            *with_bounds("onset_cycle", "", "cycle from which the wave distorts; NULL where it does not"),
            real("p_value", "", "of a wave that does not change"),
            real("distortion_before", "", "harmonics over the fundamental before the onset"),
            real("distortion_after", "", "the same at the end"),
            text("warnings", "what limits the onset"),
        ),
        key=("recording_id",),
        made_by=(MadeBy("recording"),),
        pages=("index", "campaign", "specimen"),
    ),
)
