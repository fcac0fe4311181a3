"""What the samples of a recording say of what its metadata state: amplitudes, frequencies, flat tops, channels that stand still.

Belongs here: numbers read off the channels alone. What follows from them is concluded in `pipeline.diagnose.faults`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.features.records import strain_length_mm
from pipeline.transform.channels import drive
from pipeline.transform.quality import flat_tops
from schemas.arrays import Float
from schemas.metadata import RecordingMetadata
from schemas.protocols import ELECTRICAL, MECHANICAL
from schemas.recording import Recording

STATED, SEEN = "stated_", "seen_"
"""Before the names of a pair in `RecordingFeatures.values`: what the metadata say, and what the samples show."""
AMPLITUDE, FREQUENCY, VOLTAGE = "pp_mm", "hz", "kv"
SIZES = (
    "film_thickness_mm",
    "film_width_mm",
    "active_width_mm",
    "film_length_mm",
    "total_length_mm",
    "relative_permittivity",
)
"""Keys of the metadata whose values are kept under `STATED`."""
FLAT, HELD = "flat_share", "held_share_"
"""Share of the force's samples on a flat top; share of the record in which a channel holds one value, by quantity."""
_CROSSINGS = 10
"""Neighbouring half turns of a sweep that one frequency is read of."""
_FEWEST_CROSSINGS = 24
"""Fewest half turns of a sweep whose highest frequency is read."""
_HYSTERESIS = 0.1
"""Share of the amplitude beyond which a signal has crossed its level."""
_FEWEST_HELD = 25
"""Fewest samples in a row of one value in which a channel stands still."""
_MOVED = 0.3
"""Share of the input's whole travel that it makes meanwhile."""
_STILL = 0.02
"""Share of the input's travel beyond which it is no longer at rest."""


def observe_channels(recording: Recording) -> dict[str, float]:
    """Numbers by name that are compared with the metadata and with other recordings; those that cannot be read are absent."""
    metadata = recording.metadata
    if metadata.loading not in (MECHANICAL, ELECTRICAL):
        return {}
    source = drive(recording)
    given, found = source.input.values, source.output.values
    values = _find_held(given, found, (source.input.quantity, source.output.quantity))
    values |= {STATED + key: value for key in SIZES if (value := getattr(metadata, key)) is not None}
    if not np.isfinite(given).any() or not np.isfinite(found).any():
        return values
    if metadata.loading == ELECTRICAL:
        return values | _pair(VOLTAGE, metadata.drive_kv, float(np.nanmax(np.abs(given))))
    if metadata.protocol in ("chirp", "cyclic"):
        values[FLAT] = float(flat_tops(found, source.output.resolution).mean())
    travel = None if metadata.strain_pp is None else metadata.strain_pp * strain_length_mm(recording)
    values |= _pair(AMPLITUDE, travel, float(np.nanmax(given) - np.nanmin(given)))
    values["force_pp"] = float(np.nanmax(found) - np.nanmin(found))
    read = _FREQUENCIES.get(metadata.protocol)
    if read is not None:
        time = (source.input.time_ns - source.input.time_ns[0]) * 1e-9
        values |= _pair(FREQUENCY, read.stated(metadata), read.seen(time, given))
    return values


def find_dead(observed: Mapping[str, float]) -> list[str]:
    """Quantities whose channel holds one value through all of the record."""
    return [name.removeprefix(HELD) for name, share in observed.items() if name.startswith(HELD) and share == 1.0]


def _pair(name: str, stated: float | None, seen: float | None) -> dict[str, float]:
    if stated is None or seen is None or not stated > 0:
        return {}
    return {STATED + name: stated, SEEN + name: seen}


def _find_held(given: Float, found: Float, names: tuple[str, str]) -> dict[str, float]:
    """Shares of the record in which input or output hold one value while the input moves, or for as long as the record lasts."""
    share = {}
    if found.size == given.size:
        first, stop = _longest_run(found)
        travel = float(np.ptp(given[np.isfinite(given)])) if np.isfinite(given).any() else 0.0
        during = given[first:stop][np.isfinite(given[first:stop])]
        if stop - first >= _FEWEST_HELD and during.size and travel > 0 and np.ptp(during) > _MOVED * travel:
            share[HELD + names[1]] = (stop - first) / found.size
    for values, name in zip((given, found), names, strict=True):
        first, stop = _longest_run(values)
        if stop - first == values.size:
            share[HELD + name] = 1.0
    return share


def _longest_run(values: Float) -> tuple[int, int]:
    """First sample and stop of the longest run of one value."""
    edges = np.flatnonzero(np.diff(values) != 0) + 1
    bounds = np.concatenate([[0], edges, [values.size]])
    longest = int(np.argmax(np.diff(bounds)))
    return int(bounds[longest]), int(bounds[longest + 1])


def _find_crossings(time_s: Float, values: Float) -> Float:
    """Times (n,) at which a signal crosses its level, noise left out."""
    x = np.nan_to_num(values - (np.nanmax(values) + np.nanmin(values)) / 2)
    clear = np.flatnonzero(np.abs(x) > _HYSTERESIS * np.abs(x).max())
    turns = np.flatnonzero(np.sign(x[clear[1:]]) != np.sign(x[clear[:-1]]))
    a, b = clear[turns], clear[turns + 1]
    return np.asarray(time_s[a] - x[a] * (time_s[b] - time_s[a]) / (x[b] - x[a]))


def _see_sine(time_s: Float, values: Float) -> float | None:
    crossings = _find_crossings(time_s, values)
    if crossings.size < 3:
        return None
    return float((crossings.size - 1) / 2 / (crossings[-1] - crossings[0]))


def _see_highest(time_s: Float, values: Float) -> float | None:
    crossings = _find_crossings(time_s, values)
    if crossings.size < _FEWEST_CROSSINGS:
        return None
    spans = crossings[_CROSSINGS:] - crossings[:-_CROSSINGS]
    return float(_CROSSINGS / 2 / spans.min())


@dataclass(frozen=True)
class _Reading:
    """Where the metadata of a protocol state a frequency, and how it is seen in the input."""

    stated: Callable[[RecordingMetadata], float | None]
    seen: Callable[[Float, Float], float | None]


def _state_highest(metadata: RecordingMetadata) -> float | None:
    ends = metadata.frequency_start_hz, metadata.frequency_stop_hz
    return None if ends[0] is None or ends[1] is None else max(ends[0], ends[1])


_FREQUENCIES = {
    "cyclic": _Reading(lambda metadata: metadata.frequency_hz, _see_sine),
    "chirp": _Reading(_state_highest, _see_highest),
}
