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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ingest.columns import ColumnFile
from ingest.lives import read_failure_modes, read_lives
from ingest.mapping import FileMapping
from ingest.mapping_keys import TAN_DELTA
from ingest.own_covariates import read_covariates
from ingest.table_rows import TableRows, cell_text, join_repeats, ordered, standard_error, stiffness_scale
from schemas.alike import ask_meant
from schemas.arrays import Complex, Float
from schemas.assumptions import Assumption, assume_campaign
from schemas.errors import RefusedError
from schemas.lifetimes import FAILURE_MODES, LifetimeRow
from schemas.metadata import TableMetadata

_MOST_COPIES = 100_000
"""Specimens that one row may stand for."""


@dataclass(frozen=True)
class LifetimeTable:
    """Lives of specimens. Every row has the table's `recording_id`."""

    metadata: TableMetadata
    rows: tuple[LifetimeRow, ...]
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    assumptions: tuple[Assumption, ...] = ()


@dataclass(frozen=True)
class ResponseTable:
    """A complex stiffness over frequency, as a machine computed it.

    `frequency_hz` (n,) ascending, `value` (n,) N/mm with e^{+jωt}, `standard_error` (n,) N/mm, √E|Δ|² of both components
    together, NaN where unknown, `temperature_c` (n,) or None. `own_deformation` (n,) or None: displacement of the machine's
    transducer over that of the specimen. `measured_as` is `modulus` or `stiffness`, `scale` the N/mm that one MPa became
    (1 for a stiffness). `unit`: in which the file has its values, "" where it names none.
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
    assumptions: tuple[Assumption, ...] = ()
    unit: str = ""


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
    assumptions: tuple[Assumption, ...] = ()
    temperature_c: Float | None = None
    unit: str = ""


def _in_a_campaign(table: TableRows) -> TableMetadata:
    """The table's metadata; a list that names no campaign is one of its own: no other list's lives are compared with its."""
    metadata = table.metadata
    if metadata.campaign:
        return metadata
    table.assumptions.append(assume_campaign(metadata.recording_id))
    return replace(metadata, campaign=metadata.recording_id)


def lifetime_table(file: ColumnFile, mapping: FileMapping, *, stem: str, where: str) -> LifetimeTable:
    """Lives from a table, one for each specimen. Raises `RefusedError`, see `ingest.lives`."""
    table = TableRows(file, mapping, where)
    metadata = _in_a_campaign(table)
    lives = read_lives(table)
    count = lives.life_s.size
    voltage = table.numbers_or("voltage", "kV", metadata.voltage_setpoint_kv, count)
    breakdown = table.numbers_or("breakdown_voltage", "kV", None, count)
    specimens = table.texts_or("specimen_id", None, count)
    copies = _copies(table, count)
    fixed = {
        name: table.groups_or(name, getattr(metadata, name), count)
        for name in ("configuration", "failure_site", "failure_region")
    }
    _check_places(fixed, where)
    modes = read_failure_modes(table, lives.failed)
    conditions = {
        "temperature": table.numbers_or("temperature", "degC", metadata.temperature_c, count),
        "humidity": table.numbers_or("humidity", "1", metadata.humidity, count),
        "frequency": table.numbers_or("frequency", "Hz", None, count),
    }
    _check_conditions(table, conditions)
    electrodes, batches = (table.groups_or(name, getattr(metadata, name), count) for name in ("electrode", "batch"))
    covariates = read_covariates(table)
    censored_modes = mapping.columns["failure_mode"].censored_modes if "failure_mode" in mapping.columns else ()
    _check_censored(censored_modes, modes, where)
    rows, ended_by = [], 0
    for i in range(count):
        if math.isnan(lives.life_s[i]):
            continue
        name = specimens[i] or f"{stem}-{table.row_numbers[i]}"
        not_counted = bool(lives.failed[i]) and not {modes[i][0], modes[i][1]}.isdisjoint(censored_modes)
        ended_by += not_counted
        failed = bool(lives.failed[i]) and not not_counted
        rows += [
            LifetimeRow(
                specimen_id=specimen,
                lifetime_s=float(lives.life_s[i]),
                failed=failed,
                recording_id=metadata.recording_id,
                configuration=fixed["configuration"][i],
                campaign=metadata.campaign,
                voltage_kv=_number_or_none(voltage[i]),
                censored_because=None
                if failed
                else f"failed: {modes[i][0] if modes[i][0] in censored_modes else modes[i][1]}"
                if not_counted
                else "censored in the table",
                breakdown_voltage_kv=_number_or_none(breakdown[i]),
                failure_site=fixed["failure_site"][i],
                failure_region=fixed["failure_region"][i],
                test_duration_s=metadata.test_duration_s,
                alive_at_s=_number_or_none(lives.alive_at_s[i]),
                entered_s=_number_or_none(lives.entered_s[i]),
                failure_mode=modes[i][0] if failed else None,
                written_mode=modes[i][1],
                temperature_c=_number_or_none(conditions["temperature"][i]),
                humidity=_number_or_none(conditions["humidity"][i]),
                frequency_hz=_number_or_none(conditions["frequency"][i]),
                electrode=electrodes[i],
                batch=batches[i],
                covariates=covariates[i],
            )
            for specimen in (name if copies[i] == 1 else f"{name}-{k}" for k in range(1, copies[i] + 1))
        ]
    if not rows:
        raise RefusedError(
            "no row has a life that says anything", where=where, expected="lives above 0, or failures at 0"
        )
    _check_names(rows, where)
    if ended_by:
        table.notes.append(
            f"{ended_by} failures ({', '.join(censored_modes)}) count as survivors until then: columns.failure_mode.censored_modes"
        )
    return LifetimeTable(metadata, tuple(rows), *table.remarks, tuple(table.assumptions))


def _check_censored(said: Sequence[str], modes: Sequence[tuple[str | None, str | None]], where: str) -> None:
    """Raises `RefusedError` for what is said not to count and is neither a failure mode nor a text of the table."""
    texts = {written for _, written in modes if written is not None}
    for one in said:
        if one not in texts and one not in FAILURE_MODES:
            known = [*FAILURE_MODES, *sorted(texts)]
            raise RefusedError(
                f'columns.failure_mode.censored_modes is "{one[:80]}"{ask_meant(one, known)}',
                where=where,
                expected=f"one of {', '.join(FAILURE_MODES)}, or a text as the table writes it",
            )


def _check_conditions(table: TableRows, conditions: Mapping[str, Float]) -> None:
    """Raises `RefusedError` for a condition of the test that no test can have."""
    ranges = {
        "temperature": (-273.15, math.inf, "above −273.15 °C"),
        "humidity": (0.0, 1.0, "from 0 to 1 (or from 0 to 100 with the unit %)"),
        "frequency": (0.0, math.inf, "not below 0 Hz"),
    }
    for name, values in conditions.items():
        low, high, expected = ranges[name]
        for i in np.flatnonzero((values < low) | (values > high))[:1]:
            row = int(table.row_numbers[i]) - 1
            raise table.refused_row(row, f"the {name} is {values[i]:g}", f"a {name} {expected}")


def _copies(table: TableRows, count: int) -> list[int]:
    """How many specimens each row stands for: one, or what the column `count` says."""
    if "count" not in table.mapping.columns:
        return [1] * count
    found = []
    for i, cell in enumerate(table.cells("count")):
        try:
            number = float(cell)
        except (TypeError, ValueError):
            number = math.nan
        if not (number.is_integer() and 1 <= number <= _MOST_COPIES):
            row = int(table.row_numbers[i]) - 1
            raise table.refused_row(
                row, f'the count is "{cell_text(cell) or ""}"', f"a whole number from 1 to {_MOST_COPIES}"
            )
        found.append(int(number))
    return found


def response_table(file: ColumnFile, mapping: FileMapping, *, where: str) -> ResponseTable:
    """A frequency response from a table. Rows without a number are left out, a problem. Raises `RefusedError`."""
    table = TableRows(file, mapping, where)
    chosen = table.one_of(
        ("storage", "loss"), ("magnitude", "phase"), ("response",), ("storage", TAN_DELTA), ("magnitude", TAN_DELTA)
    )
    frequency = _frequency(table, chosen[0])
    if chosen[0] == "response":
        value, measured_as = table.response(frequency)
    else:
        value, measured_as = _of_parts(table, chosen)
    scale = stiffness_scale(table.metadata, measured_as, where)
    error = standard_error(table, measured_as, frequency.size)
    temperature = _temperature(table, frequency.size)
    own = table.ratio("transducer_displacement", "displacement")
    if (groups := join_repeats(table, frequency, value, "frequency")) is not None:
        frequency, value, error, temperature, own = _means(groups, frequency, value, error, temperature, own)
    at_rest = (frequency == 0) & ("frequency" not in mapping.columns)  # the axis of an analyser begins there
    if at_rest.any():
        table.notes.append("the line at 0 Hz is left out")
    keep = ordered(table, frequency, np.isfinite(value) & (frequency > 0), "frequency", "Hz", left_out=at_rest)
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
        assumptions=tuple(table.assumptions),
        unit=table.unit_as_written(chosen[0]),
    )


def _means(
    groups: Sequence[NDArray[np.intp]], axis: Float, value: Any, error: Float, warm: Float | None, own: Float | None
) -> tuple[Float, Any, Float, Float | None, Float | None]:
    """The mean row of each group: axis, value, its standard error, temperature, and the transducer's share."""
    counts = np.array([group.size for group in groups])

    def mean(values: Any) -> Any:
        return np.array([values[group].sum() for group in groups]) / counts

    joined = np.sqrt(np.array([np.sum(error[group] ** 2) for group in groups])) / counts
    return mean(axis), mean(value), joined, None if warm is None else mean(warm), None if own is None else mean(own)


def _temperature(table: TableRows, count: int) -> Float | None:
    """The temperature of each row: its column, else that of the whole table; None where neither says it."""
    if "temperature" in table.mapping.columns:
        return table.numbers("temperature", "degC")
    stated = table.metadata.temperature_c
    return None if stated is None else np.full(count, stated)


def _frequency(table: TableRows, name: str) -> Float:
    """The frequencies of the rows: the column of that name, else those that the file gives the column of values."""
    if "frequency" not in table.mapping.columns:
        own = table.own_frequency(name)
        if own is not None:
            return own
    table.require("frequency")
    return table.numbers("frequency", "Hz")


def _of_parts(table: TableRows, chosen: tuple[str, ...]) -> tuple[Complex, str]:
    """A complex modulus or stiffness from its two columns, and which of the two it is."""
    first, measured_as = table.elastic(chosen[0])
    if chosen == ("storage", TAN_DELTA):
        return np.asarray(first * (1 + 1j * table.numbers(TAN_DELTA, "1")), dtype=np.complex128), measured_as
    if chosen[0] == "magnitude":
        phase = np.arctan(table.numbers(TAN_DELTA, "1")) if TAN_DELTA in chosen else table.numbers("phase", "rad")
        with np.errstate(invalid="ignore", over="ignore"):  # rows without a finite value are left out below
            return np.asarray(first * np.exp(1j * phase), dtype=np.complex128), measured_as
    second, same = table.elastic("loss")
    if same != measured_as:
        raise RefusedError(
            f"storage is a {measured_as}, loss a {same}", where=table.where, expected="units of the same dimension"
        )
    value: Complex = first.astype(np.complex128)
    value.imag = second
    return value, measured_as


def relaxation_table(file: ColumnFile, mapping: FileMapping, *, where: str) -> RelaxationTable:
    """A relaxation curve from a table. Rows without a number are left out, a problem. Raises `RefusedError`."""
    table = TableRows(file, mapping, where)
    table.require("time", "relaxation")
    time = table.numbers("time", "s")
    value, measured_as = table.elastic("relaxation")
    scale = stiffness_scale(table.metadata, measured_as, where)
    error = standard_error(table, measured_as, time.size)
    temperature = _temperature(table, time.size)
    if (groups := join_repeats(table, time, value.astype(np.complex128), "time")) is not None:
        time, value, error, temperature, _ = _means(groups, time, value, error, temperature, None)
    keep = ordered(table, time, np.isfinite(value) & (time > 0), "time", "s")
    return RelaxationTable(
        table.metadata,
        time[keep],
        value[keep] * scale,
        error[keep] * scale,
        measured_as,
        scale,
        *table.remarks,
        assumptions=tuple(table.assumptions),
        temperature_c=None if temperature is None else temperature[keep],
        unit=table.unit_as_written("relaxation"),
    )


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
