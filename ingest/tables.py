"""Tables that stand instead of recordings: lifetimes, frequency responses, relaxation curves.

`kind` in the mapping says which; `columns.<name>` says where each thing stands, with `unit`, `scale` and `offset` as for
recordings, or `value = …` for what is the same in every row. Only rows that pass every `[[select]]` (column, equals)
are read. `[recording]` holds the table's own metadata (`schemas.metadata.TableMetadata`).

The columns of each kind, and what they mean: `ingest.mapping_keys.TABLE_COLUMNS`. Frequency responses are those of e^{jωt}, so
that a lossy material has a positive phase; whether a value is a modulus or a stiffness tells its unit.

A modulus becomes a stiffness with `film_length_mm`, `film_width_mm` and `film_thickness_mm` of [recording]: E·w·t/L. With
none of them it is that of a 1 mm cube (1 MPa = 1 N/mm); with some of them only the table is refused.

Rows are ordered by frequency or time; the same frequency or time twice is refused (`[[select]]` picks one set of several).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ingest.columns import ColumnFile
from ingest.mapping import FileMapping
from ingest.table_rows import TableRows, cell_text, ordered, same_cell, standard_error, stiffness_scale
from schemas.arrays import Bool, Complex, Float
from schemas.errors import RefusedError
from schemas.lifetimes import LifetimeRow
from schemas.metadata import TableMetadata


@dataclass(frozen=True)
class LifetimeTable:
    """Lives of specimens. Every row has the table's `recording_id`."""

    metadata: TableMetadata
    rows: tuple[LifetimeRow, ...]
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ResponseTable:
    """A complex stiffness over frequency, as a machine computed it.

    `frequency_hz` (n,) ascending, `value` (n,) N/mm with e^{+jωt}, `standard_error` (n,) N/mm, √E|Δ|² of both components
    together, NaN where unknown, `temperature_c` (n,) or None. `own_deformation` (n,) or None: displacement of the machine's
    transducer over that of the specimen. `measured_as` is `modulus` or `stiffness`, `scale` the N/mm that one MPa became
    (1 for a stiffness).
    """

    metadata: TableMetadata
    frequency_hz: Float
    value: Complex
    standard_error: Float
    temperature_c: Float | None
    measured_as: str
    scale: float
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    own_deformation: Float | None = None


@dataclass(frozen=True)
class RelaxationTable:
    """A relaxation stiffness over the time since the step: `time_s` (n,) ascending, `value` (n,) N/mm, see above."""

    metadata: TableMetadata
    time_s: Float
    value: Float
    standard_error: Float
    measured_as: str
    scale: float
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def lifetime_table(file: ColumnFile, mapping: FileMapping, *, stem: str, where: str) -> LifetimeTable:
    """Lives from a table. A failure at 0 counts; a row without a life, or a survivor of 0 s, is left out, a problem. Raises `RefusedError`."""
    table = TableRows(file, mapping, where)
    metadata = table.metadata
    table.require("lifetime", "failed")
    life = table.numbers("lifetime", "s")
    failed = _failed(table)
    count = life.size
    voltage = table.numbers_or("voltage", "kV", metadata.voltage_setpoint_kv, count)
    breakdown = table.numbers_or("breakdown_voltage", "kV", None, count)
    specimens = table.texts_or("specimen_id", None, count)
    fixed = {
        name: table.texts_or(name, getattr(metadata, name), count)
        for name in ("configuration", "failure_site", "failure_region")
    }
    _check_places(fixed, where)
    rows = []
    wrong = []
    for i in range(count):
        if not (math.isfinite(life[i]) and (life[i] > 0 or (failed[i] and life[i] == 0))):
            wrong.append(i)
            continue
        rows.append(
            LifetimeRow(
                specimen_id=specimens[i] or f"{stem}-{table.row_numbers[i]}",
                lifetime_s=float(life[i]),
                failed=bool(failed[i]),
                recording_id=metadata.recording_id,
                configuration=fixed["configuration"][i],
                campaign=metadata.campaign,
                voltage_kv=_number_or_none(voltage[i]),
                censored_because=None if failed[i] else "censored in the table",
                breakdown_voltage_kv=_number_or_none(breakdown[i]),
                failure_site=fixed["failure_site"][i],
                failure_region=fixed["failure_region"][i],
                test_duration_s=metadata.test_duration_s,
            )
        )
    if wrong:
        table.problems.append(
            f"{len(wrong)} of {count} rows have no life, or survived 0 s (row {table.row_numbers[wrong[0]]}: {life[wrong[0]]:g} s):"
            " left out"
        )
    if not rows:
        raise RefusedError(
            "no row has a life that says anything", where=where, expected="lives above 0, or failures at 0"
        )
    _check_names(rows, where)
    return LifetimeTable(metadata, tuple(rows), *table.remarks)


def response_table(file: ColumnFile, mapping: FileMapping, *, where: str) -> ResponseTable:
    """A frequency response from a table. Rows without a number are left out, a problem. Raises `RefusedError`."""
    table = TableRows(file, mapping, where)
    table.require("frequency")
    pair = table.one_of(("storage", "loss"), ("magnitude", "phase"))
    frequency = table.numbers("frequency", "Hz")
    first, measured_as = table.elastic(pair[0])
    if pair[0] == "storage":
        second, same = table.elastic("loss")
        if same != measured_as:
            raise RefusedError(
                f"storage is a {measured_as}, loss a {same}", where=where, expected="units of the same dimension"
            )
        value: Complex = first.astype(np.complex128)
        value.imag = second
    else:
        phase = table.numbers("phase", "rad")
        with np.errstate(invalid="ignore", over="ignore"):  # rows without a finite value are left out below
            value = first * np.exp(1j * phase)
    scale = stiffness_scale(table.metadata, measured_as, where)
    error = standard_error(table, measured_as, frequency.size)
    temperature = table.numbers("temperature", "degC") if "temperature" in mapping.columns else None
    own = table.ratio("transducer_displacement", "displacement")
    keep = ordered(table, frequency, np.isfinite(value) & (frequency > 0), "frequency", "Hz")
    table.note_signs(value[keep])
    return ResponseTable(
        table.metadata,
        frequency[keep],
        value[keep] * scale,
        error[keep] * scale,
        None if temperature is None else temperature[keep],
        measured_as,
        scale,
        *table.remarks,
        own_deformation=None if own is None else own[keep],
    )


def relaxation_table(file: ColumnFile, mapping: FileMapping, *, where: str) -> RelaxationTable:
    """A relaxation curve from a table. Rows without a number are left out, a problem. Raises `RefusedError`."""
    table = TableRows(file, mapping, where)
    table.require("time", "relaxation")
    time = table.numbers("time", "s")
    value, measured_as = table.elastic("relaxation")
    scale = stiffness_scale(table.metadata, measured_as, where)
    error = standard_error(table, measured_as, time.size)
    keep = ordered(table, time, np.isfinite(value) & (time > 0), "time", "s")
    return RelaxationTable(
        table.metadata, time[keep], value[keep] * scale, error[keep] * scale, measured_as, scale, *table.remarks
    )


def _failed(table: TableRows) -> Bool:
    """(n,) true for a failure, false for a life that is only known to be longer."""
    meanings = table.mapping.columns["failed"].meanings
    source = table.mapping.source or table.where
    if not meanings.get("failed") and not meanings.get("censored"):
        raise RefusedError(
            "columns.failed does not say which values mean what",
            where=source,
            expected="failed_values = [1] and censored_values = [0], as this table means it",
            remedy="Look it up at the source of the table: the convention is not the same everywhere",
        )
    failed = np.zeros(int(table.rows.sum()), dtype=bool)
    for i, cell in enumerate(table.cells("failed")):
        means = [m for m, values in meanings.items() if any(same_cell(cell, value) for value in values)]
        if len(means) != 1:
            both = " and ".join(m.replace("_", "-") for m in means) or "neither failed nor censored"
            raise RefusedError(
                f'"{cell_text(cell) or ""}" in row {table.row_numbers[i]} of the data means {both}',
                where=table.where,
                expected="each value in one of failed_values and censored_values",
                remedy="Correct [columns.failed] in the mapping TOML",
            )
        if means[0] == "left_censored":
            raise RefusedError(
                f"row {table.row_numbers[i]} of the data is left-censored: its life is only known to be shorter",
                where=table.where,
                expected="failures and right-censored lives",
                remedy="Survival curves from left-censored lives are not estimated here",
            )
        failed[i] = means[0] == "failed"
    return failed


def _check_places(fixed: dict[str, list[str | None]], where: str) -> None:
    for name in ("failure_site", "failure_region"):
        for value in dict.fromkeys(fixed[name]):
            if value is not None:
                TableMetadata.parse({"recording_id": "x", name: value}, where=where)


def _check_names(rows: Sequence[LifetimeRow], where: str) -> None:
    seen: set[str] = set()
    for row in rows:
        if row.specimen_id in seen:
            raise RefusedError(
                f'specimen_id "{row.specimen_id[:80]}" stands in two rows',
                where=where,
                expected="one row per specimen",
                remedy="Leave columns.specimen_id out of the mapping TOML to number the rows",
            )
        seen.add(row.specimen_id)


def _number_or_none(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None
