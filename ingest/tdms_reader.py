"""NI TDMS through nptdms, an optional extra. A column is `group/channel`, or the channel where the mapping has a group.

A channel's waveform properties give its time where the mapping gives none; `unit_string` is its unit.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ingest.columns import Numbers, OwnTime, missing_column, numbers_from_array
from ingest.mapping import ColumnName, FileMapping
from schemas.errors import MissingExtraError, RefusedError

_UNSET_BEFORE = np.datetime64("1971-01-01", "ns")
"""LabVIEW writes its epoch, 1904, where no start time was set."""


@dataclass(frozen=True)
class TdmsFile:
    """The channels of a file, as nptdms has them; a `ColumnFile`."""

    where: str
    channels: Mapping[str, Any]
    group: str | None
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        return tuple(self.channels)

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        return numbers_from_array(self._channel(column)[:], column, index, self.where)

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        data = np.asarray(self._channel(column)[:])
        if data.dtype.kind == "M":
            return [None if np.isnat(t) else t.astype("datetime64[us]").item() for t in data]
        return list(data.tolist())

    def unit(self, column: ColumnName) -> str | None:
        unit = self._channel(column).properties.get("unit_string")
        return str(unit) if unit else None

    def own_time(self, column: ColumnName) -> OwnTime | None:
        channel = self._channel(column)
        step = channel.properties.get("wf_increment")
        if not step:
            return None
        offset = float(channel.properties.get("wf_start_offset", 0.0))
        start = channel.properties.get("wf_start_time")
        known = start is not None and np.datetime64(start, "ns") > _UNSET_BEFORE
        start_ns = int(np.datetime64(start, "ns").astype(np.int64)) if known else None
        return OwnTime(offset + np.arange(len(channel), dtype=np.float64) * float(step), start_ns)

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
            remedy="Install it: pip install dealab[tdms]",
        ) from None
    log_manager.set_level(logging.ERROR)  # what it warns of is in `problems`, without the file's bytes
    try:
        file = nptdms.TdmsFile.read(path)
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
    return TdmsFile(path.name, channels, mapping.options.get("group"), problems)
