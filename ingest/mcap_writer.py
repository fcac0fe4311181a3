"""Writing recordings in the native format, for the scripts that run a rig and for the simulator.

Does not belong here: reading, the analysis, anything that a rig's computer should not have to install for writing
beyond numpy, mcap, protobuf and a compressor.
"""

from __future__ import annotations

import functools
import math
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ingest.atomic import flush
from ingest.mcap_blocks import SCHEMA_NAME
from schemas.arrays import Float
from schemas.errors import UsageError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.quantities import quantity as known_quantity
from schemas.units import conversion

PART = ".part"
"""Added to the name of a recording that is still being written."""

_CHUNK = 1 << 20
_FLUSH_S = 30.0
"""Recorded time after which what was recorded is given to the operating system at the latest."""

_BLOCK = struct.Struct("<BqBdB")


class RecordingWriter:
    """Writes one recording as an MCAP file, block by block, while the test runs.

    ::

        with RecordingWriter("chirp_017.mcap", {
            "recording_id": "chirp_017", "protocol": "chirp", "loading": "mechanical",
            "specimen_id": "acrylic_3", "started_at": "2026-03-01T14:05:00+01:00",
            "film_length_mm": "10", "film_width_mm": "100", "film_thickness_mm": "1", "stretch_1": "3",
        }) as recording:
            recording.add_channel("force", "N", resolution=0.0005, filter_hz=2000, sensor="HBM S2M")
            recording.add_channel("displacement", "mm", resolution=0.0005)
            for start_ns, force, displacement in rig.blocks():
                recording.append("force", start_ns, 1e-4, force)
                recording.append("displacement", start_ns, 1e-4, displacement)

    While it is open the recording is called `chirp_017.mcap.part`, which the nightly run leaves alone; `close` gives it
    its name in one step, and only then is it a recording. An exception inside the `with` ends the recording properly:
    what was recorded so far is kept, with a note of the reason. After a crash the `.part` file stays and holds
    everything but the last 30 s or the last megabyte; rename it to end in `.mcap` and the nightly run takes what is
    whole and marks it `damaged`. Nothing is ever overwritten.

    Blocks of `block_size` samples are made from whatever lengths are appended. Appended stretches that follow each other
    to within 1 ns at the same interval become one; anything else begins a new block, so gaps stay gaps.

    Parameters
    ----------
    path : name of the file, ending in `.mcap`
    metadata : keys of the recording, all checked before the test begins
    rig : constants of the rig, optional
    compression : `zstd`, `lz4` or `none`
    block_size : samples of a block

    Raises `RefusedError` for metadata, quantities and units that a recording cannot have, `UsageError` for the rest.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        metadata: Mapping[str, Any] | RecordingMetadata,
        rig: Mapping[str, Any] | RigConstants | None = None,
        compression: str = "zstd",
        block_size: int = 1000,
    ) -> None:
        self.path = Path(path)
        if self.path.suffix != ".mcap":
            raise UsageError(f'the name "{self.path.name}" does not end in .mcap', where=str(self.path))
        if compression not in ("zstd", "lz4", "none"):
            raise UsageError(f'compression is "{compression}"', where=self.path.name, expected="zstd, lz4 or none")
        if not 1 <= block_size <= 1_000_000:
            raise UsageError(f"block_size is {block_size}", where=self.path.name, expected="1 to 1 000 000 samples")
        if not isinstance(metadata, RecordingMetadata):
            metadata = RecordingMetadata.parse(metadata, where=self.path.name)
        if rig is not None and not isinstance(rig, RigConstants):
            rig = RigConstants.parse(rig, where=self.path.name)
        self._metadata = metadata.to_text()
        self._rig = None if rig is None else rig.to_text()
        self._compression = compression
        self._block_size = block_size
        self._streams: dict[str, _Stream] = {}
        self._file: Any = None
        self._writer: Any = None
        self._closed = False
        self._schema_id = 0
        self._flushed_ns: int | None = None

    @property
    def part(self) -> Path:
        """The file while it is being written."""
        return self.path.with_name(self.path.name + PART)

    def open(self) -> Self:
        """Creates the file. `UsageError` when it, or an unfinished one of its name, is there already."""
        from mcap.writer import CompressionType, Writer

        if self._file is not None or self._closed:
            raise UsageError("the recording has been opened before", where=self.path.name)
        self._check_free()
        try:
            self._file = self.part.open("xb")
        except FileExistsError:
            raise UsageError(
                f"an unfinished recording {self.part.name} is in the way",
                where=str(self.path.parent),
                remedy="Rename it to end in .mcap to keep what it holds, or remove it",
            ) from None
        kinds = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
        self._writer = Writer(
            self._file, chunk_size=_CHUNK, compression=kinds[self._compression], enable_data_crcs=True
        )
        self._writer.start(profile="", library="dealab")
        self._writer.add_metadata("recording", self._metadata)
        if self._rig is not None:
            self._writer.add_metadata("rig", self._rig)
        self._schema_id = self._writer.register_schema(SCHEMA_NAME, "protobuf", sample_block_schema())
        return self

    def add_channel(
        self,
        quantity: str,
        unit: str,
        *,
        resolution: float | None = None,
        filter_hz: float | None = None,
        delay_s: float | None = None,
        sensor: str | None = None,
    ) -> None:
        """Announces a channel before its first samples.

        `resolution` (one step of the converter) is in `unit`, `filter_hz` the corner of the anti-alias filter,
        `delay_s` the known latency of the sensor.
        """
        self._check_open()
        where = f"{self.path.name}: {quantity}"
        conversion(unit, known_quantity(quantity, where=self.path.name).unit, where=where)
        if quantity in self._streams:
            raise UsageError("the channel has been added before", where=where)
        keys = {"unit": unit}
        numbers = (("resolution", resolution), ("filter_hz", filter_hz), ("delay_s", delay_s))
        for name, value in numbers:
            if value is None:
                continue
            if not math.isfinite(value) or (value <= 0 and name != "delay_s"):
                raise UsageError(f"{name} is {value}", where=where, expected="a finite number above 0")
            keys[name] = repr(float(value))
        if sensor is not None:
            keys["sensor"] = sensor
        channel_id = self._writer.register_channel(f"/{quantity}", "protobuf", self._schema_id, keys)
        self._streams[quantity] = _Stream(channel_id)

    def append(self, quantity: str, start_time_ns: int, sample_interval_s: float, values: ArrayLike) -> None:
        """Adds samples of one channel: `values` (n,) in its unit, the first at Unix time `start_time_ns`.

        NaN stands for a lost sample. Raises `UsageError` for a channel that was not added, for values that are not
        one row of numbers, and for a time that is not after the channel's last sample.
        """
        self._check_open()
        where = f"{self.path.name}: {quantity}"
        stream = self._streams.get(quantity)
        if stream is None:
            raise UsageError(
                f'the channel "{quantity}" has not been added', where=self.path.name, remedy="Call add_channel first"
            )
        samples = _row_of_numbers(values, where)
        start = int(start_time_ns)
        interval = float(sample_interval_s)
        if not (math.isfinite(interval) and interval >= 1e-9):
            raise UsageError(f"sample_interval_s is {interval}", where=where, expected="at least 1e-9 s")
        last = start + round((samples.size - 1) * interval * 1e9) if samples.size * interval < 1e9 else 2**63
        if not 0 <= start <= last < 2**63:
            raise UsageError(f"samples from {start} ns on", where=where, expected="times from 1970 to 2262")
        if start <= stream.last_ns:
            raise UsageError(
                f"time goes back: the samples begin at {start} ns, the last one before was at {stream.last_ns} ns",
                where=where,
                expected="each stretch to begin after the one before",
            )
        if interval != stream.interval or abs(start - stream.next_ns()) > 1:
            self._emit(stream, everything=True)
            stream.start_run(start, interval)
        stream.waiting.append(samples)
        stream.waiting_count += samples.size
        stream.last_ns = last
        self._emit(stream)
        self._flush_sometimes(last)

    def close(self) -> None:
        """Writes what is waiting and the file's end, and gives the file its name. Closing twice does nothing."""
        if self._file is None:
            return
        for stream in self._streams.values():
            self._emit(stream, everything=True)
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self._file = self._writer = None
        self._closed = True
        self._check_free()
        self.part.replace(self.path)
        flush(self.path.parent)

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is not None and self._writer is not None:
            self._writer.add_metadata("writer", {"aborted": f"{kind.__name__}: {error}"[:1000]})
        self.close()

    def _check_free(self) -> None:
        if self.path.exists():
            raise UsageError(
                f"the file {self.path.name} exists",
                where=str(self.path.parent),
                remedy="Give the recording another name; recordings are never overwritten",
            )

    def _check_open(self) -> None:
        if self._writer is None:
            state = "closed" if self._closed else "not open"
            raise UsageError(f"the recording is {state}", where=self.path.name, remedy='Use it in a "with" statement')

    def _emit(self, stream: _Stream, *, everything: bool = False) -> None:
        """Writes whole blocks of what is waiting, and the rest too when `everything` is asked for."""
        if stream.waiting_count < (1 if everything else self._block_size):
            return
        samples = stream.waiting[0] if len(stream.waiting) == 1 else np.concatenate(stream.waiting)
        at = 0
        while samples.size - at >= (1 if everything else self._block_size):
            block = samples[at : at + self._block_size]
            start = stream.run_start + round(stream.run_written * stream.interval * 1e9)
            self._writer.add_message(
                channel_id=stream.channel_id,
                log_time=start,
                publish_time=start,
                sequence=stream.sequence & 0xFFFF_FFFF,
                data=sample_block(start, stream.interval, block),
            )
            stream.sequence += 1
            stream.run_written += block.size
            at += block.size
        # a copy, for a view would keep all the appended samples in memory
        stream.waiting = [samples[at:].copy()] if at < samples.size else []
        stream.waiting_count = samples.size - at

    def _flush_sometimes(self, now_ns: int) -> None:
        if self._flushed_ns is None:
            self._flushed_ns = now_ns
        elif now_ns - self._flushed_ns >= _FLUSH_S * 1e9:
            for stream in self._streams.values():
                self._emit(stream, everything=True)
            self._writer.flush()
            self._flushed_ns = now_ns


@dataclass
class _Stream:
    """State of one channel. A run is a stretch of samples at one interval without a gap."""

    channel_id: int
    sequence: int = 0
    run_start: int = 0
    run_written: int = 0
    interval: float = 0.0
    last_ns: int = -1
    waiting: list[Float] = field(default_factory=list)
    waiting_count: int = 0

    def start_run(self, start: int, interval: float) -> None:
        self.run_start, self.interval, self.run_written = start, interval, 0

    def next_ns(self) -> int:
        """Where the next sample of the run belongs."""
        return self.run_start + round((self.run_written + self.waiting_count) * self.interval * 1e9)


def sample_block(start_time_ns: int, sample_interval_s: float, values: Float) -> bytes:
    """A serialised `dealab.SampleBlock`; `values` (n,) in the channel's unit."""
    packed = values.astype("<f8", copy=False).tobytes()
    length, remaining = b"", len(packed)
    while remaining > 0x7F:
        length += bytes([remaining & 0x7F | 0x80])
        remaining >>= 7
    return _BLOCK.pack(0x09, start_time_ns, 0x11, sample_interval_s, 0x1A) + length + bytes([remaining]) + packed


@functools.cache
def sample_block_schema() -> bytes:
    """The serialised FileDescriptorSet of `dealab.SampleBlock`."""
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

    files = FileDescriptorSet()
    file = files.file.add(name="dealab/sample_block.proto", package="dealab", syntax="proto3")
    message = file.message_type.add(name="SampleBlock")
    one, many = FieldDescriptorProto.LABEL_OPTIONAL, FieldDescriptorProto.LABEL_REPEATED
    for number, (name, kind, label) in enumerate(
        (
            ("start_time_ns", FieldDescriptorProto.TYPE_SFIXED64, one),
            ("sample_interval_s", FieldDescriptorProto.TYPE_DOUBLE, one),
            ("values", FieldDescriptorProto.TYPE_DOUBLE, many),
        ),
        start=1,
    ):
        message.field.add(name=name, number=number, type=kind, label=label)
    return bytes(files.SerializeToString(deterministic=True))


def _row_of_numbers(values: ArrayLike, where: str) -> Float:
    samples = np.asarray(values)
    if samples.ndim != 1 or samples.size == 0 or samples.dtype.kind not in "iuf":
        shape = " × ".join(map(str, samples.shape)) or "a single value"
        raise UsageError(
            f"values are {shape} of {samples.dtype}", where=where, expected="one row of at least one real number"
        )
    return np.array(samples, dtype=np.float64)
