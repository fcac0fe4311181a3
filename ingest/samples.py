"""The samples Parquet of a lab: one file per recording, written whole or not at all.

Does not belong here: reading raw formats, computing anything from samples beyond the preview's envelope, the database.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ingest.atomic import written_whole
from schemas.arrays import Bool, Float, Int
from schemas.errors import LabError
from schemas.quantities import quantity
from schemas.recording import Channel, Recording
from schemas.units import ANY
from schemas.version import software_version

if TYPE_CHECKING:
    import pyarrow as pa

SCHEMA_VERSION = 1
ROW_GROUP = 1 << 18
"""Rows of a row group: enough for a dictionary of all 65 536 steps of a converter to pay."""

_SAMPLE = 1 << 14
_COARSE_BITS = 16
_REPEATING = 0.9
_SPLIT = "BYTE_STREAM_SPLIT"

SAMPLES_AGAIN = "Remove it and run the nightly over the raw files again"
"""What to do with a samples file that cannot be read: a night makes what is lost, and leaves what is there."""

PREVIEW_POINTS = 2000
TIME = "time_ns"


def samples_path(recording: Recording) -> str:
    """Path of a recording's samples relative to the lab. The month is that of `started_at` in UTC."""
    about = recording.metadata
    month = about.started_at.astimezone(UTC).strftime("%Y-%m")
    return f"samples/protocol={about.protocol}/month={month}/{about.recording_id}.parquet"


def write_samples(recording: Recording, lab: Path, *, staged: Path | None = None) -> str:
    """Writes the samples of a recording and returns the path relative to the lab.

    `staged` is written instead where given: somebody moves it to its place later.
    Rows are the instants at which any channel has a sample, ascending; a channel without a sample there, or with a lost
    one (NaN), is NULL. The file appears under its name complete and on the disk, or not at all.
    """
    relative = samples_path(recording)
    write_table(samples_table(recording), staged or lab / relative)
    return relative


def samples_table(recording: Recording) -> pa.Table:
    """The samples as one table: `time_ns`, then one column per quantity in its canonical unit."""
    import pyarrow as pa

    channels = list(recording.channels.values())
    times = _union([channel.time_ns for channel in channels])
    columns = [_array(times, pa.int64())]
    fields = [pa.field(TIME, pa.int64(), nullable=False, metadata={"unit": "ns", "meaning": "Unix time, UTC"})]
    for channel in channels:
        columns.append(_column(channel, times))
        fields.append(pa.field(channel.quantity, pa.float64(), metadata=_field_metadata(channel)))
    return pa.Table.from_arrays(columns, schema=pa.schema(fields, metadata=_file_metadata(recording)))


def write_table(table: pa.Table, path: Path) -> None:
    """Writes a samples table so that measured samples become small, under a name of its own until it is complete.

    Each column is coded as fits its values, see `_encoding`; equal steps of time shrink to next to nothing. Every page
    has its checksum: without one, most flipped bits would be read as other values.
    """
    import pyarrow.parquet as pq

    values = [name for name in table.column_names if name != TIME]
    encodings = {name: _encoding(_values(table.column(name))) for name in values}
    with written_whole(path) as temporary, temporary.open("wb") as file:  # a name such as s3:x would be an address
        pq.write_table(
            table,
            file,
            row_group_size=ROW_GROUP,
            compression="zstd",
            write_page_checksum=True,
            use_dictionary=[name for name in values if encodings[name] is None],
            column_encoding={TIME: "DELTA_BINARY_PACKED"} | {n: e for n, e in encodings.items() if e is not None},
        )


def _encoding(values: Float) -> str | None:
    """Parquet encoding for (n,) values, NaN where one is lost; None for a dictionary.

    A converter gives at most 65 536 values. Where its step is a short binary fraction the low bytes of all doubles are
    zero, and the bytes put next to each other by their place compress best. Where it is not (0.0005 N), all eight bytes
    of a double look random but there are few different doubles: a dictionary. Numbers that do not repeat, such as those
    of a machine that has filtered them, are split by bytes again.
    """
    bits = int(np.bitwise_or.reduce(values.view(np.int64))) if values.size else 0
    if bits & ((1 << _COARSE_BITS) - 1) == 0:
        return _SPLIT
    sample = values[:: max(1, values.size // _SAMPLE)]
    return None if np.unique(sample).size < _REPEATING * sample.size else _SPLIT


def read_samples(path: Path) -> dict[str, Channel]:
    """The channels of a samples file by quantity, each without the rows where it has no sample.

    Channels that have a sample in every row share one `time_ns` array. Raises `LabError` when the file is missing or
    is not a samples file.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        # opened as it is named: the folders' names (protocol=…) are not to become columns
        with path.open("rb") as file:
            table = pq.ParquetFile(file, page_checksum_verification=True).read()
        times = table.column(TIME).to_numpy()
    except (OSError, KeyError, pa.ArrowException) as error:
        reason = "is missing" if isinstance(error, FileNotFoundError) else f"cannot be read: {error}"
        raise LabError(f"the samples file {reason}", where=str(path), remedy=SAMPLES_AGAIN) from None
    channels = {}
    for field in table.schema:
        if field.name == TIME:
            continue
        column = table.column(field.name)
        values = column.to_numpy()
        if column.null_count:
            present = np.asarray(column.is_valid())
            channels[field.name] = _channel(field, times[present], values[present])
        else:
            channels[field.name] = _channel(field, times, values)
    return channels


def preview(channel: Channel, points: int = PREVIEW_POINTS) -> tuple[Float, Float, Float]:
    """Envelope of a channel for the pages: time from the channel's first sample in s, lowest and highest value.

    Three arrays of the same length, at most `points`: consecutive samples are taken together in equal numbers, lost
    ones (NaN) left out, and each stands at its first sample's time. A stretch with nothing but lost samples is NaN.
    """
    size = channel.values.size
    if size == 0 or points < 1:
        return np.empty(0), np.empty(0), np.empty(0)
    edges = np.unique(np.linspace(0, size, min(size, points) + 1).astype(np.int64))[:-1]
    low = np.fmin.reduceat(channel.values, edges)
    high = np.fmax.reduceat(channel.values, edges)
    time = (channel.time_ns[edges] - channel.time_ns[0]) * 1e-9
    return time, low, high


def _union(times: Sequence[Int]) -> Int:
    """All instants, ascending, each once; the array itself where all channels have the same."""
    if not times:
        return np.empty(0, dtype=np.int64)
    first = times[0]
    others = [t for t in times[1:] if t is not first and not np.array_equal(t, first)]
    return first if not others else np.unique(np.concatenate([first, *others]))


def _column(channel: Channel, times: Int) -> pa.Array:
    import pyarrow as pa

    values = channel.values
    if times.size != channel.time_ns.size:
        values = np.full(times.size, np.nan)
        values[np.searchsorted(times, channel.time_ns)] = channel.values
    lost = np.isnan(values)
    return _array(values, pa.float64(), ~lost if lost.any() else None)


def _array(values: NDArray[Any], kind: pa.DataType, valid: Bool | None = None) -> pa.Array:
    """An arrow array over the same memory; values that are not `valid` are NULL.

    By its buffers: `pyarrow.array` imports pandas to look at what it is given, which takes longer than a small recording.
    """
    import pyarrow as pa

    known = None if valid is None else pa.py_buffer(np.packbits(valid, bitorder="little"))
    return pa.Array.from_buffers(kind, values.size, [known, pa.py_buffer(np.ascontiguousarray(values))])


def _values(column: pa.ChunkedArray) -> Float:
    """The values of a column of doubles, NULLs as whatever stands there."""
    parts = [np.frombuffer(c.buffers()[1], np.float64, len(c), 8 * c.offset) for c in column.chunks]
    return parts[0] if len(parts) == 1 else np.concatenate([np.empty(0), *parts])


def _field_metadata(channel: Channel) -> dict[str, str]:
    canonical = quantity(channel.quantity).unit
    known: Mapping[str, Any] = {
        "unit": channel.unit if canonical == ANY else canonical,
        "resolution": channel.resolution,
        "filter_hz": channel.filter_hz,
        "delay_s": channel.delay_s,
        "sensor": channel.sensor,
    }
    return {name: str(value) for name, value in known.items() if value is not None}


def _file_metadata(recording: Recording) -> dict[str, str]:
    about = {
        "dealab.schema_version": str(SCHEMA_VERSION),
        "dealab.software_version": software_version(),
        "dealab.recording_id": recording.metadata.recording_id,
        "dealab.status": recording.status,
    }
    if recording.source is not None:
        about["dealab.source_sha256"] = recording.source.sha256
    return about


def _channel(field: pa.Field, times: Int, values: Float) -> Channel:
    known = {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}
    number = {key: float(known[key]) for key in ("resolution", "filter_hz", "delay_s") if key in known}
    unit = known.get("unit") if quantity(field.name).unit == ANY else None
    return Channel(field.name, times, values, sensor=known.get("sensor"), unit=unit, **number)
