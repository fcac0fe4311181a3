"""What a night will make of a file, before it is run: a picture of its channels, and the results to expect."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ingest.faults import check
from ingest.mapping import FileMapping
from ingest.parts import count_left_out, list_parts, name_parts, part_of
from ingest.read import read_raw
from ingest.rigs import tell_absent
from ingest.tables import LifetimeTable, RelaxationTable
from pipeline.transform.loops import find_loops
from pipeline.transform.relaxation import relaxation_curve
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.protocols import find_lacking
from schemas.quantities import QUANTITIES
from schemas.recording import RawRecording, Recording

_WIDTH, _HEIGHT = 64, 6
"""Characters of a picture; each holds 2 × 4 dots."""
_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
_BRAILLE = 0x2800
_GIVES = {
    ("chirp", "mechanical"): "the frequency response of the sweep and relaxation models of order 1 to 3",
    ("chirp", "electrical"): "the response of the force to the voltage over the sweep",
    ("sphs", "electrical"): "the response of the force to the voltage, and its prediction from the film's model",
    ("cyclic", "mechanical"): "stiffness and damping at one frequency, cycle by cycle",
    ("step", "mechanical"): "a relaxation fit of order 1 to 3",
    ("step", "electrical"): "the force of each voltage step, and its drift",
    ("lifetime", "electrical"): "the life of this film, and a survival curve with others of its configuration",
    ("isotonic", "electrical"): "the stroke of each level of the voltage, at once and slowly, and its law",
    ("force_map", "electrical"): "static force in two directions at this pre-stretch",
    ("coverage", "electrical"): "capacitance over coats of electrode",
    ("cycle", "electrical"): "drop of the force over the squared voltage, its rest and drift",
    ("cycle", "mechanical"): "hysteresis and the stiffness of a large cycle",
    ("creep", "mechanical"): "compliance, retardation times of order 1 to 3, and the share that comes back",
    ("pull", "mechanical"): "stiffness, strength and stretch at break, and a hyperelastic law",
    ("tap", "calibration"): "frequency and damping of the clamp, used for recordings of this rig",
    ("weight", "calibration"): "gain and offset of the load cell, used for recordings of this rig",
}


def describe_preview(path: Path, mapping: FileMapping, rigs: Path | None = None) -> Iterator[str]:
    """Lines with what was read, drawn, and what a night will give, with rig files of `rigs` where given.

    Raises `DealabError` for a file that is refused.
    """
    labels: tuple[str, ...] = ()
    if names := name_parts(mapping.content):
        for name in names:
            part = part_of(mapping, name)
            yield f"  part       {name}: {part.recording.get('recording_id')}"
            yield from _describe_content(path, part, rigs, several=False)
        yield from _tell_left_out(path, mapping)
        return
    if mapping.parts_file:
        labels = list_parts(path, mapping)
        yield f"  parts      {len(labels)} recordings in one file: {', '.join(labels)}; the first of them:"
        yield from _tell_left_out(path, mapping)
        mapping = part_of(mapping, labels[0])
    yield from _describe_content(path, mapping, rigs, several=bool(labels))


def _tell_left_out(path: Path, mapping: FileMapping) -> Iterator[str]:
    lost, count = count_left_out(path, mapping)
    if lost:
        yield f"  note       {lost} of {count} rows belong to none of them: left out"


def _describe_content(path: Path, mapping: FileMapping, rigs: Path | None, *, several: bool) -> Iterator[str]:
    raw = read_raw(path, mapping)
    if isinstance(raw, RawRecording):
        recording = check(raw, path, rigs=rigs)
        yield from _describe_recording(recording)
        if absent := tell_absent(recording, path, rigs):
            yield f"  note       {absent}"
    elif isinstance(raw, LifetimeTable):
        failed = sum(row.failed for row in raw.rows)
        lives = [row.lifetime_s for row in raw.rows]
        span = f"{min(lives):g} to {max(lives):g} s"
        alive = len(raw.rows) - failed
        yield f"  read       {len(raw.rows)} lives from {span}: {failed} failed, {alive} still alive (censored)"
        yield "  will give  survival curves of each configuration, Weibull parameters where enough films failed"
    elif isinstance(raw, RelaxationTable):
        yield f"  read       {raw.time_s.size} rows from {raw.time_s.min():g} to {raw.time_s.max():g} s"
        yield f"  will give  {_master_of(several and raw.temperature_c is not None)}a relaxation fit of order 1 to 3"
    else:
        low, high = raw.frequency_hz.min(), raw.frequency_hz.max()
        yield f"  read       {raw.frequency_hz.size} rows from {low:g} to {high:g} Hz"
        joined = several and raw.temperature_c is not None
        of = "it" if joined else "this response"
        yield f"  will give  {_master_of(joined)}relaxation models of order 1 to 3 of {of}"
    for note in getattr(raw, "problems", ()):
        yield f"  problem    {note}"


def _master_of(joined: bool) -> str:
    """What a specimen gets first whose parts are temperatures."""
    return "a master curve of the temperatures with its shifts; " if joined else ""


def _describe_recording(recording: Recording) -> Iterator[str]:
    about = recording.metadata
    for name, channel in recording.channels.items():
        unit = QUANTITIES[name].unit
        values = channel.values[np.isfinite(channel.values)]
        seconds: Float = np.asarray((channel.time_ns - recording.start_ns) * 1e-9, dtype=np.float64)
        shown = f"{values.min():.4g} to {values.max():.4g} {unit if unit != 'any' else channel.unit or ''}"
        yield f"  {name}: {channel.values.size} samples, {shown}, {seconds[-1] - seconds[0]:.4g} s"
        yield from (f"    {line}" for line in draw(seconds, channel.values))
    gives = _GIVES.get((about.protocol, about.loading), "samples in the database")
    yield f"  will give  {gives}"
    given = about.to_text() | ({"rig_id": ""} if recording.rig.to_text() else {})
    for lack in find_lacking(given, recording.channels, about.protocol, about.loading):
        yield f"             {lack.told}"
    if (about.protocol, about.loading) == ("cycle", "mechanical"):
        yield from (f"  note       {remark}" for remark in _remark_cycles(recording))
    if (about.protocol, about.loading) == ("step", "mechanical"):
        yield from (f"  note       {remark}" for remark in _remark_relaxation(recording))
    for problem in dict.fromkeys(recording.problems):
        yield f"  problem    {problem}"


def _remark_cycles(recording: Recording) -> tuple[str, ...]:
    """How many cycles close, and those that do not; or why there is none."""
    channels = recording.channels
    driven, answer = (
        channels[a] if a in channels else channels[b] for a, b in (("displacement", "stretch"), ("force", "stress"))
    )
    good = np.isfinite(driven.values)
    time = np.asarray((driven.time_ns - recording.start_ns) * 1e-9)[good]
    force = np.interp(driven.time_ns[good], answer.time_ns, answer.values)
    try:
        found = find_loops(time, driven.values[good], force)
    except NotIdentifiableError as error:
        return (str(error),)
    opened = max(loop.unclosed for loop in found)
    text = f"{len(found)} closed cycles"
    return (f"{text}; {opened} end elsewhere than they began, and have no loss",) if opened else (text,)


def _remark_relaxation(recording: Recording) -> tuple[str, ...]:
    """What a relaxation takes for granted and leaves out of its record, or why there is none."""
    try:
        return relaxation_curve(recording)[1]
    except NotIdentifiableError as error:
        return (str(error),)


def draw(x: Float, y: Float) -> list[str]:
    """A curve as lines of Braille characters: in each column of dots from the least to the largest value there."""
    finite = np.isfinite(x) & np.isfinite(y)
    x, y = x[finite], y[finite]
    if x.size < 2 or np.ptp(x) <= 0:
        return []
    span = float(np.ptp(y)) or 1.0
    column = np.minimum((x - x.min()) / np.ptp(x) * 2 * _WIDTH, 2 * _WIDTH - 1).astype(int)
    row = np.rint((y.max() - y) / span * (4 * _HEIGHT - 1)).astype(int)
    cells = np.zeros((_HEIGHT, _WIDTH), dtype=np.int32)
    for place in np.unique(column):
        here = row[column == place]
        for dot in range(int(here.min()), int(here.max()) + 1):
            cells[dot // 4, place // 2] |= _DOTS[place % 2][dot % 4]
    return ["".join(chr(_BRAILLE + int(cell)) for cell in line).rstrip(chr(_BRAILLE)) for line in cells]
