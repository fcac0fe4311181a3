"""ASAM MDF (versions 3 and 4) through asammdf, an optional extra. A column is a channel by its name, or `group/channel`.

Each group of channels has a time of its own, which is used where the mapping gives none; its channels have no others. Groups
count from 0 in the order of the file. Samples that the file marks as invalid are empty. asammdf parses in a child process
(`ingest.apart`): parts of it are compiled, and it believes the lengths in a file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC
from pathlib import Path
from typing import Any

import numpy as np

from ingest.apart import apart
from ingest.array_numbers import numbers_from_array
from ingest.columns import CELL_LIMIT, Numbers, OwnTime, named_column
from ingest.extras import advise_install
from ingest.mapping import ColumnName, FileMapping
from schemas.arrays import Bool, Float
from schemas.errors import MissingExtraError, RefusedError

_UNSET = 1970
"""Year of the start that is written where none was set."""


@dataclass(frozen=True)
class MdfChannel:
    """A channel of a file.

    Parameters
    ----------
    name, unit : as the file has them; unit empty for none
    samples : (n,) physical values
    invalid : (n,) which of them the file marks as invalid
    time_s : (n,) since the start of the measurement; shared by the channels of a group
    """

    name: str
    unit: str
    samples: Any
    invalid: Bool
    time_s: Float


@dataclass(frozen=True)
class MdfFile:
    """The channels of a file; a `ColumnFile`. `start_ns`: when the measurement began, None where the file does not say."""

    where: str
    channels: tuple[MdfChannel, ...]
    start_ns: int | None
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.channels)

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        channel = self._channel(column)
        samples = channel.samples
        if channel.invalid.any() and samples.dtype.kind in "iufb":
            samples = np.where(channel.invalid, np.nan, samples.astype(np.float64))
        found = numbers_from_array(samples, column, index, self.where)
        return replace(found, empty=found.empty | channel.invalid) if channel.invalid.any() else found

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        channel = self._channel(column)
        cells = [c.decode("utf-8", "replace") if isinstance(c, bytes) else c for c in channel.samples.tolist()]
        return [None if bad else cell for cell, bad in zip(cells, channel.invalid, strict=True)]

    def unit(self, column: ColumnName) -> str | None:
        return self._channel(column).unit or None

    def own_time(self, column: ColumnName) -> OwnTime | None:
        channel = self._channel(column)
        return OwnTime(channel.time_s, self.start_ns) if channel.time_s.size else None

    def own_frequency(self, column: ColumnName) -> Float | None:
        return None

    def _channel(self, column: ColumnName) -> MdfChannel:
        return self.channels[named_column(self.names(), column, self.where)]


def read_mdf(path: Path, mapping: FileMapping) -> MdfFile:
    """The channels of an MDF file. Raises `MissingExtraError` without asammdf, `RefusedError` for a damaged file."""
    from importlib.util import find_spec

    if find_spec("asammdf") is None:
        raise MissingExtraError(
            "MDF files need the package asammdf, which is not installed",
            where=path.name,
            remedy=advise_install("mdf"),
        )
    import asammdf  # noqa: F401 - in this process, so that no child has to: its time is that of a small file

    start_ns, groups, problems = apart(path, _load, path)
    counts = Counter(name for _, channels in groups for name, *_ in channels)
    channels = tuple(
        MdfChannel(name if counts[name] == 1 else f"{number}/{name}", unit, samples, invalid, time_s)
        for number, (time_s, found) in enumerate(groups)
        for name, unit, samples, invalid in found
    )
    if not channels:
        raise RefusedError("the file has no channels", where=path.name, expected="channels with samples")
    return MdfFile(path.name, channels, start_ns, problems)


_Group = tuple[Float, list[tuple[str, str, Any, Bool]]]


def _load(path: Path) -> tuple[int | None, list[_Group], tuple[str, ...]]:
    """Start and groups of a file, as plain arrays that can leave the process, and what of them is lost."""
    import logging

    from asammdf import MDF

    from ingest.mdf_cut import open_left

    logging.disable(logging.CRITICAL)  # what it warns of stands in the error
    try:
        with MDF(open_left(path)) as file:
            start = file.header.start_time.astimezone(UTC).replace(tzinfo=None)
            start_ns = int(np.datetime64(start, "ns").astype(np.int64)) if start.year > _UNSET else None
            groups = [_load_group(file, number) for number in range(len(file.groups))]
            return start_ns, groups, tuple(_tell_lost(file, groups))
    except RefusedError:
        raise
    except Exception as error:  # asammdf raises its own, struct's, numpy's and zlib's errors for damaged files
        why = str(error).replace(str(path), path.name)  # a file is the same wherever it lies
        raise RefusedError(
            f"the file cannot be read as MDF: {why[:200] or type(error).__name__}",
            where=path.name,
            expected="a whole MDF file of version 3 or 4",
            remedy="Copy the file again; a file whose measurement was not ended can be finalised by asammdf",
        ) from None


def _tell_lost(file: Any, groups: Sequence[_Group]) -> Iterator[str]:
    """Groups that hold fewer samples than they say: the file ends too early."""
    for number, (group, (time_s, _)) in enumerate(zip(file.groups, groups, strict=True)):
        stated = int(group.channel_group.cycles_nr)
        if time_s.size < stated:
            yield f"the file ends too early: group {number} states {stated} samples and holds {time_s.size}"


def _load_group(file: Any, number: int) -> tuple[Float, list[tuple[str, str, Any, Bool]]]:
    channels = file.groups[number].channels
    master = file.masters_db.get(number)
    time_s = np.asarray(file.get_master(number), dtype=np.float64)
    if time_s.size * len(channels) > CELL_LIMIT:
        raise RefusedError(
            f"a group has {time_s.size} samples of {len(channels)} channels",
            expected=f"at most {CELL_LIMIT} values",
            remedy="Cut the recording into parts",
        )
    found = []
    for index, channel in enumerate(channels):
        if index == master:
            continue
        signal = file.get(group=number, index=index, ignore_invalidation_bits=True)
        samples = np.asarray(signal.samples)
        bits = getattr(signal, "invalidation_bits", None)
        invalid = np.zeros(samples.shape[:1], dtype=bool) if bits is None else np.asarray(bits, dtype=bool)
        found.append((str(channel.name), str(signal.unit or ""), samples, invalid))
    return time_s, found
