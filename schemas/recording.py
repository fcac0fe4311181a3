"""A recording in memory: what every reader yields, what the simulator yields, and what every analysis takes.

`RawRecording` is what a reader found, in the file's own units and names. `Recording` is the same thing checked and in
canonical units. Only `ingest.canonical` makes the second from the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from schemas.arrays import Float, Int
from schemas.assumptions import Assumption
from schemas.metadata import RecordingMetadata, RigConstants


@dataclass(frozen=True)
class RawChannel:
    """One channel as a file has it. `time_ns` (n,) Unix time, `values` (n,) in `unit`; order and NaN as found."""

    quantity: str
    unit: str
    time_ns: Int
    values: Float
    metadata: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RawRecording:
    """What a reader found in a file.

    `problems` says what is lost or wrong (the recording is then `damaged`); `notes` what is merely worth knowing;
    `assumptions` what the reader had to take for granted.
    """

    metadata: Mapping[str, Any]
    rig: Mapping[str, Any]
    channels: tuple[RawChannel, ...]
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    assumptions: tuple[Assumption, ...] = ()


@dataclass(frozen=True)
class Channel:
    """One quantity in its canonical unit.

    `time_ns` (n,) strictly ascending Unix time in UTC, `values` (n,), NaN where a sample was lost. `resolution` is one
    step of the converter in the canonical unit, `filter_hz` the corner of the anti-alias filter, `delay_s` the known
    latency of the channel (a positive delay means that the sample shows what happened that much earlier).
    """

    quantity: str
    time_ns: Int
    values: Float
    resolution: float | None = None
    filter_hz: float | None = None
    delay_s: float | None = None
    sensor: str | None = None
    unit: str | None = None
    """The unit of `values` where the quantity keeps any unit (`input`, `output`); None means canonical."""


@dataclass(frozen=True)
class Source:
    """Where a recording came from."""

    path: str
    sha256: str
    size: int


@dataclass(frozen=True)
class Recording:
    """A checked recording in canonical units."""

    metadata: RecordingMetadata
    rig: RigConstants
    channels: Mapping[str, Channel]
    source: Source | None = None
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    assumptions: tuple[Assumption, ...] = ()

    @property
    def status(self) -> str:
        """`ok`, or `damaged` when something is lost or wrong but the required channels have usable data."""
        return "damaged" if self.problems else "ok"

    @property
    def start_ns(self) -> int:
        """Time of the earliest sample of any channel."""
        return min(int(c.time_ns[0]) for c in self.channels.values() if c.time_ns.size)

    @property
    def end_ns(self) -> int:
        """Time of the latest sample of any channel."""
        return max(int(c.time_ns[-1]) for c in self.channels.values() if c.time_ns.size)

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) * 1e-9

    @property
    def sample_count(self) -> int:
        return sum(c.values.size for c in self.channels.values())
