"""NI TDMS through nptdms, an optional extra. A column is `group/channel`, or the channel where the mapping has a group.

A channel's waveform properties give its time where the mapping gives none; `unit_string` is its unit. Scales of NI
(`NI_Scale[0]_…`) are applied; one that nptdms does not know refuses the channel. The index beside a file
(`*.tdms_index`) is never read: it may be that of an earlier copy, and the file itself holds all that it says.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC
from pathlib import Path
from typing import Any

import numpy as np

from ingest.array_numbers import numbers_from_array
from ingest.columns import Numbers, OwnTime, missing_column
from ingest.extras import advise_install
from ingest.mapping import ColumnName, FileMapping, column_label
from ingest.packing import find_scales
from schemas.arrays import Float
from schemas.errors import MissingExtraError, RefusedError
from schemas.units import conversion

_UNSET_BEFORE = np.datetime64("1971-01-01", "ns")
"""LabVIEW writes its epoch, 1904, where no start time was set."""
_UNITS = ("unit_string", "NI_UnitDescription", "unit", "Unit", "units", "Units")
_SCALES = frozenset(
    [
        "Polynomial", "Linear", "RTD", "Strain", "Table", "Thermistor", "Thermocouple", "Add", "Subtract", "AdvancedAPI",
    ]
)  # fmt: skip
"""Types of scales that nptdms applies; of others it gives the raw numbers."""


@dataclass(frozen=True)
class TdmsFile:
    """The channels of a file, as nptdms has them; a `ColumnFile`. `shared`: properties of groups, and of the file ("")."""

    where: str
    channels: Mapping[str, Any]
    group: str | None
    shared: Mapping[str, Mapping[str, Any]]
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        return tuple(self.channels)

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        channel = self._channel(column)
        self._check_scales(channel, column)
        found = numbers_from_array(channel[:], column, index, self.where)
        kind = np.asarray(channel[:0]).dtype.kind
        scales = find_scales(channel.properties) if kind in "iu" else ()
        return replace(found, doubtful=scales)

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        channel = self._channel(column)
        data = np.asarray(channel[:])
        if data.dtype.kind == "M":  # TDMS keeps its stamps in UTC
            found = data.astype("datetime64[us]").tolist()
            return [None if np.isnat(t) else f.replace(tzinfo=UTC) for t, f in zip(data, found, strict=True)]
        self._check_scales(channel, column)
        return list(data.tolist())

    def unit(self, column: ColumnName) -> str | None:
        properties = self._channel(column).properties
        return next((str(properties[name]) for name in _UNITS if properties.get(name)), None)

    def own_time(self, column: ColumnName) -> OwnTime | None:
        channel = self._channel(column)
        step = channel.properties.get("wf_increment")
        if not step:
            return None
        change = conversion(self._time_unit(channel, column), "s")
        offset = float(channel.properties.get("wf_start_offset", 0.0))
        start = channel.properties.get("wf_start_time")
        known = start is not None and np.datetime64(start, "ns") > _UNSET_BEFORE
        start_ns = int(np.datetime64(start, "ns").astype(np.int64)) if known else None
        elapsed = change.apply(offset + np.arange(len(channel), dtype=np.float64) * float(step))
        return OwnTime(elapsed, start_ns)

    def own_frequency(self, column: ColumnName) -> Float | None:
        return None

    def _time_unit(self, channel: Any, column: ColumnName) -> str:
        """The unit of a waveform's axis. Raises `RefusedError` where it is no time (a spectrum)."""
        unit = str(channel.properties.get("wf_xunit_string") or "s").strip()
        try:
            conversion(unit, "s")
        except RefusedError:
            raise RefusedError(
                f'the axis of {column_label(column)} is in "{unit[:40]}" (wf_xunit_string)',
                where=self.where,
                expected="a waveform over time",
                remedy="Map the channel as a table, or give sample_rate_hz in the mapping TOML",
            ) from None
        return unit

    def _check_scales(self, channel: Any, column: ColumnName) -> None:
        """Refuses a channel whose scale is of a type that is not applied: its numbers would be raw ones."""
        properties = {**self.shared.get("", {}), **self.shared.get(channel.group_name, {}), **channel.properties}
        if properties.get("NI_Scaling_Status") == "scaled":
            return
        types = {str(v) for k, v in properties.items() if k.startswith("NI_Scale[") and k.endswith("_Scale_Type")}
        unknown = sorted(types - _SCALES)
        if unknown:
            raise RefusedError(
                f'{column_label(column)} has a scale of type "{unknown[0][:40]}", which is not known here',
                where=self.where,
                expected="scales of type " + ", ".join(sorted(_SCALES)),
                remedy="Save the channel with its scale applied",
            )

    def _channel(self, column: ColumnName) -> Any:
        name = f"{self.group}/{column}" if self.group else str(column)
        if name not in self.channels:
            raise missing_column(self.names(), name, self.where)
        return self.channels[name]


def read_tdms(path: Path, mapping: FileMapping) -> TdmsFile:
    """The channels of a TDMS file. Raises `MissingExtraError` without nptdms, `RefusedError` for a damaged file."""
    try:
        import nptdms
        from nptdms.log import log_manager
    except ImportError:
        raise MissingExtraError(
            "TDMS files need the package nptdms, which is not installed",
            where=path.name,
            remedy=advise_install("tdms"),
        ) from None
    log_manager.set_level(logging.ERROR)  # what it warns of is in `problems`, without the file's bytes
    try:
        with path.open("rb") as content:  # not the path: nptdms would believe an index beside it
            file = nptdms.TdmsFile.read(content)
        cut = file.file_status.incomplete_final_segment
    except Exception as error:  # nptdms raises struct's, numpy's and its own errors for damaged files
        raise RefusedError(
            f"the file cannot be read as TDMS: {str(error)[:200] or type(error).__name__}",
            where=path.name,
            expected="a whole TDMS file",
            remedy="Copy the file again",
        ) from None
    channels = {f"{group.name}/{channel.name}": channel for group in file.groups() for channel in group.channels()}
    if not channels:
        raise RefusedError("the file cannot be read as TDMS: it has no channels", where=path.name, expected="channels")
    problems = ("the last segment is incomplete: the recording stopped while it was written",) if cut else ()
    shared = {"": file.properties} | {group.name: group.properties for group in file.groups()}
    return TdmsFile(path.name, channels, mapping.options.get("group"), shared, problems)
