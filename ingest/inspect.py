"""What is in a file, whether it fits the contract, and what is wrong with it. Writes nothing.

For a foreign file without a mapping it drafts a complete TOML (`ingest.draft`). Does not belong here: the
command line (pipeline.cli).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ingest.draft import draft_mapping
from ingest.faults import check, find_faults
from ingest.mapping import FileMapping, find_mapping, format_of, own_mapping
from ingest.parts import list_parts, part_of
from ingest.read import Content, read_raw
from ingest.rigs import tell_absent
from ingest.tables import LifetimeTable, RelaxationTable
from ingest.toml_files import load_toml
from schemas.errors import DealabError, RefusedError, UnmappedError
from schemas.quantities import QUANTITIES
from schemas.recording import RawRecording, Recording
from schemas.units import ANY
from schemas.visible import shown

FITS, DAMAGED, REFUSED, UNMAPPED = "fits the contract", "damaged, usable in part", "refused", "unmapped"


@dataclass(frozen=True)
class ChannelSummary:
    """One channel or column: `unit` of `low` and `high` (finite samples), `rate_hz` from the median interval."""

    name: str
    unit: str
    samples: int
    lost: int
    rate_hz: float | None
    start_s: float
    span_s: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Inspection:
    """The findings about one file. `error` is why it is refused, `others` what else is wrong with its mapping; `draft` is a
    mapping TOML for a file without one."""

    path: Path
    format: str | None
    size: int
    verdict: str
    kind: str = "recording"
    channels: tuple[ChannelSummary, ...] = ()
    metadata: tuple[tuple[str, str], ...] = ()
    rig: tuple[tuple[str, str], ...] = ()
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    error: DealabError | None = None
    others: tuple[DealabError, ...] = ()
    draft: str | None = None

    @property
    def fits(self) -> bool:
        """Usable, whole or in part."""
        return self.verdict in (FITS, DAMAGED)

    def as_text(self, *, with_draft: bool = True) -> str:
        """The findings for a terminal: control characters of the file's texts as escapes."""
        lines = [f"{shown(self.path)}: {self.verdict}"]
        lines += [f"  format    {self.format or 'unknown'}, {self.size:,} bytes, {self.kind}"]
        if self.error is not None:
            lines += [f"  {label:<9} {shown(text)}" for label, text in _parts(self.error) if text]
        lines += [f"  and       {shown(str(other))}" for other in self.others]
        lines += [f"  problem   {shown(p)}" for p in self.problems]
        lines += [f"  note      {shown(n)}" for n in self.notes]
        if self.channels:
            lines += ["  channels"]
            lines += [f"    {_line(c)}" for c in self.channels]
        for title, pairs in (("metadata", self.metadata), ("rig", self.rig)):
            if pairs:
                lines += [f"  {title}"] + [f"    {shown(k)} = {_short(shown(v))}" for k, v in pairs]
        if self.draft is not None and with_draft:
            lines += ["  draft of a mapping:", "", self.draft]
        return "\n".join(lines)


def inspect(path: Path, *, rigs: Path | None = None) -> Inspection:
    """What is in a file. Rig files are those of `rigs`, else those that a night over the folder around the file would find.

    Never raises for what is in the file: `error` holds the reason. Raises `RefusedError` only when the path is no file.
    """
    if not path.is_file():
        raise RefusedError("not a file", where=shown(path), expected="a recording or a table")
    size = path.stat().st_size
    found = format_of(path)
    try:
        mapping = find_mapping(path)
        found = format_of(path, mapping)
        if mapping is not None and mapping.parts_file:
            return _inspect_parts(path, mapping, size, rigs)
        return _inspect_content(path, found, size, read_raw(path, mapping), rigs)
    except UnmappedError as error:
        return _unmapped(path, found, size, error)
    except DealabError as error:
        return Inspection(path, found, size, REFUSED, error=error, others=_others(path, error, rigs))


def _inspect_parts(path: Path, mapping: FileMapping, size: int, rigs: Path | None) -> Inspection:
    """A file of several recordings: the first of them, or the first that does not fit, and which there are."""
    labels = list_parts(path, mapping)
    found = format_of(path, mapping)
    told = f"{len(labels)} recordings in one file: {', '.join(labels[:20])}{', …' if len(labels) > 20 else ''}"
    inspected = []
    for label in labels:
        try:
            one = _inspect_content(path, found, size, read_raw(path, part_of(mapping, label)), rigs)
        except DealabError as error:
            one = Inspection(path, found, size, REFUSED, error=error)
        inspected.append(replace(one, notes=(told, f"this is the part {label}", *one.notes)))
    return max(inspected, key=lambda one: (FITS, DAMAGED, REFUSED).index(one.verdict))


def _inspect_content(path: Path, found: str | None, size: int, raw: Content, rigs: Path | None) -> Inspection:
    if isinstance(raw, RawRecording):
        return _recording(path, found, size, raw, rigs)
    if isinstance(raw, LifetimeTable):
        kind, rows = "lifetimes", len(raw.rows)
        columns: tuple[ChannelSummary, ...] = (
            _summary("lifetime", "s", np.array([r.lifetime_s for r in raw.rows])),
            _summary("failed", "", np.array([float(r.failed) for r in raw.rows])),
        )
    elif isinstance(raw, RelaxationTable):
        kind, rows = "relaxation", raw.time_s.size
        columns = (_summary("time", "s", raw.time_s), _summary("relaxation", "N/mm", raw.value))
    else:
        kind, rows = "frequency_response", raw.frequency_hz.size
        columns = (
            _summary("frequency", "Hz", raw.frequency_hz),
            _summary("storage", "N/mm", raw.value.real),
            _summary("loss", "N/mm", raw.value.imag),
        )
    return Inspection(
        path,
        found,
        size,
        DAMAGED if raw.problems else FITS,
        kind=kind,
        channels=columns,
        metadata=tuple(raw.metadata.to_text().items()),
        problems=raw.problems,
        notes=(f"{rows} rows", *raw.notes),
    )


def _others(path: Path, first: DealabError, rigs: Path | None) -> tuple[DealabError, ...]:
    """What else is wrong with the file's own mapping, so that all can be put right in one go."""
    beside = own_mapping(path)
    if not beside.is_file():
        return ()
    try:
        faults = find_faults(path, load_toml(beside), source=beside.name, rigs=rigs)
    except DealabError:
        return ()
    return tuple(fault for fault in faults if fault.problem != first.problem)


def _recording(path: Path, found: str | None, size: int, raw: RawRecording, rigs: Path | None) -> Inspection:
    start = min((int(c.time_ns.min()) for c in raw.channels if c.time_ns.size), default=0)
    as_found = tuple(_summary(c.quantity, c.unit, c.values, c.time_ns, start) for c in raw.channels)
    texts = tuple((str(k), str(v)) for k, v in raw.metadata.items())
    constants = tuple((str(k), str(v)) for k, v in raw.rig.items())
    try:
        recording = check(raw, path, rigs=rigs)
    except DealabError as error:
        return Inspection(
            path,
            found,
            size,
            REFUSED,
            channels=as_found,
            metadata=texts,
            rig=constants,
            problems=raw.problems,
            notes=raw.notes,
            error=error,
            others=_others(path, error, rigs),
        )
    return Inspection(
        path,
        found,
        size,
        DAMAGED if recording.problems else FITS,
        channels=_canonical_channels(recording),
        metadata=tuple(recording.metadata.to_text().items()),
        rig=tuple(recording.rig.to_text().items()),
        problems=recording.problems,
        notes=(*recording.notes, *filter(None, [tell_absent(recording, path, rigs)])),
    )


def _canonical_channels(recording: Recording) -> tuple[ChannelSummary, ...]:
    channels = []
    for name, c in recording.channels.items():
        unit = QUANTITIES[name].unit
        channels.append(
            _summary(name, (c.unit or "") if unit == ANY else unit, c.values, c.time_ns, recording.start_ns)
        )
    return tuple(channels)


def _unmapped(path: Path, found: str | None, size: int, error: DealabError) -> Inspection:
    try:
        draft = draft_mapping(path)
    except DealabError as reason:
        notes = (f"no mapping can be drafted: {reason}",)
        return Inspection(path, found, size, UNMAPPED, error=error, notes=notes)
    return Inspection(path, found, size, UNMAPPED, error=error, draft=draft)


def _summary(
    name: str, unit: str, values: np.ndarray, time_ns: np.ndarray | None = None, start_ns: int = 0
) -> ChannelSummary:
    finite = values[np.isfinite(values)]
    rate, begin, span = None, 0.0, 0.0
    if time_ns is not None and time_ns.size:
        begin = (int(time_ns[0]) - start_ns) * 1e-9
        span = (int(time_ns[-1]) - int(time_ns[0])) * 1e-9
        step = float(np.median(np.diff(time_ns))) if time_ns.size > 1 else 0.0
        rate = 1e9 / step if step > 0 else None
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (None, None)
    return ChannelSummary(name, unit, values.size, values.size - finite.size, rate, begin, span, low, high)


def _parts(error: DealabError) -> tuple[tuple[str, str], ...]:
    problem = f"{error.where}: {error.problem}" if error.where else error.problem
    return ("because", problem), ("expected", error.expected), ("remedy", error.remedy)


def _line(c: ChannelSummary) -> str:
    text = f"{_short(shown(c.name), 30):<16} {c.samples:>9,} samples"
    if c.rate_hz is not None:
        text += f", {c.rate_hz:.6g} Hz, {c.span_s:.6g} s from {c.start_s:.6g} s"
    if c.low is not None:
        text += f", {c.low:.6g} to {c.high:.6g} {_short(shown(c.unit), 20)}"
    return text + (f", {c.lost} lost" if c.lost else "")


def _short(text: str, limit: int = 100) -> str:
    return text if len(text) <= limit else text[: limit - 1] + "…"
