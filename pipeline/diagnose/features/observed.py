"""What the samples of a recording say of what its metadata state: amplitudes, frequencies, flat tops, channels that stand still.

Belongs here: numbers read off the channels alone. What follows from them is concluded in `pipeline.diagnose.faults`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from pipeline.diagnose.features.records import split_runs
from pipeline.transform.channels import drive
from pipeline.transform.quality import flat_tops
from schemas.arrays import Bool, Float, Int
from schemas.metadata import RecordingMetadata
from schemas.protocols import ELECTRICAL, MECHANICAL
from schemas.recording import Channel, Recording

STATED, SEEN = "stated_", "seen_"
"""Before the names of a pair in `RecordingFeatures.values`: what the metadata say, and what the samples show."""
AMPLITUDE, FREQUENCY, VOLTAGE = "pp_mm", "hz", "kv"
SIZES = (
    "film_thickness_mm",
    "film_width_mm",
    "active_width_mm",
    "film_length_mm",
    "total_length_mm",
    "stretch_1",
    "relative_permittivity",
)
"""Keys of the metadata whose values are kept under `STATED`."""
FORCE_SWING = "force_pp"
"""How far the force goes from its least to its largest, N."""
FLAT, FLAT_INPUT, HELD = "flat_share", "flat_share_input", "held_share_"
"""Share of the force's samples on a flat top, and of the input's; share of the record in which a channel holds one value, by quantity."""
_CROSSINGS = 10
"""Neighbouring half turns of a sweep that one frequency is read of."""
_FEWEST_CROSSINGS = 24
"""Fewest half turns of a sweep whose highest frequency is read."""
_HYSTERESIS = 0.1
"""Share of the amplitude beyond which a sine has crossed its level."""
_TURNS = 0.2
"""Share of the swing before from which a signal has turned: amplitudes of sweeps fall, or grow, by decades as they go."""
_FLOOR, _CLEAR = 10.0, 2.0
"""Swings that may be noise, in its standard deviations; and how far above them those at the highest frequency must be."""
_FADED = 0.2
"""Share of the largest swing near by below which a sweep is being faded."""
_WINDOWS = 40
"""Parts of a record of which the quietest tells its noise."""
_FEWEST_HELD = 25
"""Fewest samples in a row of one value in which a channel stands still."""
_NOISY_RUN = 10
"""Most samples in a row of one value where noise spans the converter's steps."""
_ZERO = 0.01
"""Share of the largest value up to which a level is none."""
_MOVED = 0.3
"""Share of the input's whole travel that it makes meanwhile."""
_STILL = 0.02
"""Share of the input's travel beyond which it is no longer at rest."""
_LONGER = 5.0
"""Times the next longest run of one value of which an input that moves all the time has stopped."""
_COARSE = 8000
"""Samples to which a record is thinned before it is looked through for a period."""
_OTHER_SHAPE, _SAME_SHAPE = 0.5, 0.03
"""Mean square difference of a signal from itself later, over that of independent signals, from which it is another and up to which it is
the same."""
_UNMOVED = 0.1
"""Share of the amplitude stated below which an input may not have moved."""
_NOISE = 0.5
"""Mean square of the steps of a signal over its variance from which it is nothing but noise: 2 where that is white, far less of what
is driven."""


def observe_channels(recording: Recording) -> dict[str, float]:
    """Numbers by name that are compared with the metadata and with other recordings; those that cannot be read are absent."""
    metadata = recording.metadata
    if metadata.loading not in (MECHANICAL, ELECTRICAL):
        return {}
    source = drive(recording)
    given, found = source.input.values, source.output.values
    values = _find_held(given, found, (source.input.quantity, source.output.quantity))
    for name, share in find_lost(source.input, source.output).items():
        values[name] = max(share, values.get(name, 0.0))
    stopped = find_stopped(given, source.input.quantity, found) if metadata.protocol in _MOVING else {}
    values |= stopped
    values |= {STATED + key: value for key in SIZES if (value := getattr(metadata, key)) is not None}
    if not np.isfinite(given).any() or not np.isfinite(found).any():
        return values
    clipped = find_clipped(source.input, source.output, metadata)
    read = _FREQUENCIES.get(metadata.protocol)
    if read is not None and not stopped:  # what is lost for a while has no frequency
        time = (source.input.time_ns - source.input.time_ns[0]) * 1e-9
        # A flat top shows no noise and turns nowhere.
        turning = np.where(clipped[0], np.nan, given) if clipped[0].any() else given
        stated, seen = read.stated(metadata), read.seen(time, turning)
        if (
            metadata.protocol == "sphs"
            and stated
            and repeats_after(given, round((time.size - 1) / (stated * time[-1])))
        ):
            seen = stated  # what repeats after that repeats after several of it as well
        values |= _pair(FREQUENCY, stated, seen)
    values[FORCE_SWING] = float(np.nanmax(found) - np.nanmin(found))
    if metadata.loading == ELECTRICAL:
        values |= _pair(VOLTAGE, metadata.drive_kv, float(np.nanmax(np.abs(given))))
        return values | find_unmoved(values, VOLTAGE, given, source.input.quantity)
    if clipped[0].size:
        values[FLAT_INPUT], values[FLAT] = (float(flat.mean()) for flat in clipped)
    values |= _pair(AMPLITUDE, metadata.driven_travel_mm, float(np.nanmax(given) - np.nanmin(given)))
    return values | find_unmoved(values, AMPLITUDE, given, source.input.quantity)


def find_clipped(given: Channel, found: Channel, metadata: RecordingMetadata) -> tuple[Bool, Bool]:
    """Samples of a mechanical test's input and output that its sensor clipped; of no length where that is not asked.

    A film rests on one level before a step and after it: there only a rest without noise was clipped, beside one that has some.
    """
    if metadata.loading == MECHANICAL and metadata.protocol in ("chirp", "cyclic"):
        return flat_tops(given.values, given.resolution), flat_tops(found.values, found.resolution)
    if metadata.loading == MECHANICAL and metadata.protocol == "step":
        return np.zeros(given.values.shape, dtype=bool), find_still_rest(found.values)
    return np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)


def find_still_rest(values: Float) -> Bool:
    """Samples (n,) at the largest or the least value, many in a row, of a record that shows noise of its converter's steps everywhere else.

    Zeros are what a recorder writes before it is triggered, or a slack film.
    """
    still = np.zeros(values.shape, dtype=bool)
    bounds = split_runs(values)
    lengths, held = np.diff(bounds), values[bounds[:-1]]
    high, low = float(np.fmax.reduce(values)), float(np.fmin.reduce(values))
    for extreme in (high, low):
        at = held == extreme
        if abs(extreme) <= _ZERO * max(abs(high), abs(low)):
            continue
        if lengths[at].max(initial=0) >= _FEWEST_HELD and lengths[~at].max(initial=0) <= _NOISY_RUN:
            still |= values == extreme
    return still


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
        if found[first] in (np.fmax.reduce(found), np.fmin.reduce(found)) and not _has_one_stop(
            np.diff(split_runs(found))
        ):
            stop = first  # a flat top among others
        travel = float(np.ptp(given[np.isfinite(given)])) if np.isfinite(given).any() else 0.0
        during = given[first:stop][np.isfinite(given[first:stop])]
        if stop - first >= _FEWEST_HELD and during.size and travel > 0 and np.ptp(during) > _MOVED * travel:
            share[HELD + names[1]] = (stop - first) / found.size
    for values, name in zip((given, found), names, strict=True):
        first, stop = _longest_run(values)
        if stop - first == values.size:
            share[HELD + name] = 1.0
    return share


def find_lost(given: Channel, found: Channel) -> dict[str, float]:
    """Share of the record in which input or output has no samples while the other one goes on: the longest of such times of each.

    What is lost of both at once was lost by what records them, and is no channel's. Two loggers need not be started and stopped
    together: before a channel's first sample and after its last, the other must move, not only be there.
    """
    parts = [
        (c.quantity, c.time_ns[sound], c.values[sound]) for c in (given, found) for sound in [np.isfinite(c.values)]
    ]
    if any(time.size < _FEWEST_HELD for _, time, _ in parts):
        return {}
    begin, end = min(int(time[0]) for _, time, _ in parts), max(int(time[-1]) for _, time, _ in parts)
    share = {}
    for (name, time, _), (_, other, values) in (parts, parts[::-1]):
        # Of two clocks the slower one has no samples between its own.
        fewest = _FEWEST_HELD * float(np.median(np.diff(time)))
        edges = np.concatenate([[begin], time, [end]])
        gaps = np.diff(edges)
        wide = np.flatnonzero(gaps > fewest)
        for place in wide[np.argsort(-gaps[wide])]:
            meanwhile = values[
                np.searchsorted(other, edges[place], side="right") : np.searchsorted(other, edges[place + 1])
            ]
            inside = 0 < place < gaps.size - 1
            if meanwhile.size >= _FEWEST_HELD and (inside or np.ptp(meanwhile) > _MOVED * np.ptp(values)):
                share[HELD + name] = float(gaps[place] / (end - begin))
                break
    return share


def find_stopped(given: Float, name: str, found: Float | None = None) -> dict[str, float]:
    """Share of the record in which an input that moves all the time holds one value without having stopped, between its motions.

    It may rest where it begins, in the middle of its motion, and where it ends: there its channel was lost only where the output
    `found` goes on, or where its own rest shows noise.
    """
    sound = given[np.isfinite(given)]
    if not sound.size:
        return {}
    travel, rest = float(np.ptp(sound)), float(np.median(sound[:_FEWEST_HELD]))
    bounds = split_runs(given)
    lengths, held = np.diff(bounds), given[bounds[:-1]]
    lost = np.abs(held - rest) > _STILL * travel
    lost &= np.abs(held - float(np.median(sound))) > _STILL * travel
    # A channel that rests with noise where it begins does not rest without any later.
    rests_with_noise = lengths[0] < _FEWEST_HELD and float(np.ptp(sound[:_FEWEST_HELD])) < _STILL * travel
    lost |= rests_with_noise & (lengths >= _FEWEST_HELD)
    lost[[0, -1]] = False
    if found is not None:
        own = np.interp(np.arange(given.size), np.linspace(0, given.size - 1, found.size), found)
        for run in np.flatnonzero(~lost[1:-1] & (lengths[1:-1] >= _FEWEST_HELD)) + 1:
            lost[run] = _goes_on(own, int(bounds[run]), int(bounds[run + 1]))
    lengths = lengths[lost]
    if not lengths.size:
        return {}
    return {HELD + name: float(lengths.max()) / given.size} if _has_one_stop(lengths) else {}


def _goes_on(found: Float, first: int, stop: int) -> bool:
    """Whether an output still swings, and not as noise does, in the second half of a part of the record; it may ring on in the first."""
    part = found[(first + stop) // 2 : stop]
    left, beside = _take_line_off(part), _take_line_off(np.delete(found, slice(first, stop)))
    is_driven = np.mean(np.diff(part) ** 2) < _NOISE * np.mean(left**2)
    return bool(is_driven and np.std(left) > _MOVED * np.std(beside))


def _take_line_off(values: Float) -> Float:
    """What is left of values (N,) beside a straight line."""
    place = np.linspace(-1.0, 1.0, values.size)
    return np.asarray(
        values - np.polynomial.polynomial.polyval(place, np.polynomial.polynomial.polyfit(place, values, 1))
    )


def find_unmoved(values: Mapping[str, float], pair: str, given: Float, name: str) -> dict[str, float]:
    """That an input stands still through all of the record, where next to nothing is seen of what is stated, and that is noise."""
    if STATED + pair not in values or values[SEEN + pair] > _UNMOVED * values[STATED + pair]:
        return {}
    sound = given[np.isfinite(given)]
    left = _take_line_off(sound)
    return {HELD + name: 1.0} if np.mean(np.diff(sound) ** 2) > _NOISE * np.mean(left**2) else {}


def _longest_run(values: Float) -> tuple[int, int]:
    """First sample and stop of the longest run of one value."""
    bounds = split_runs(values)
    longest = int(np.argmax(np.diff(bounds)))
    return int(bounds[longest]), int(bounds[longest + 1])


@dataclass(frozen=True)
class _Swings:
    """A signal from turn to turn.

    Parameters
    ----------
    crossed_s : (n,) times at which it passes the middle of the turns near by
    size : (n,) how far these are apart
    floor : swings below may be noise
    """

    crossed_s: Float
    size: Float
    floor: float


def _estimate_floor(values: Float) -> float:
    """The swing below which all may be noise or steps of the converter: second differences of the quietest part of the record."""
    bent = np.abs(np.diff(_take_stop_out(values), 2))
    parts = np.array_split(bent, min(_WINDOWS, max(bent.size // _FEWEST_HELD, 1)))
    noise = min(float(np.median(part)) for part in parts) / (0.6745 * np.sqrt(6))
    steps = np.abs(np.diff(values))
    least = float(steps[steps > 0].min()) if (steps > 0).any() else 0.0
    return float(max(_FLOOR * noise, 2 * least))


def _take_stop_out(values: Float) -> Float:
    """A channel (n,) without the one stretch in which it was lost and holds one value: that shows no noise."""
    bounds = split_runs(values)
    lengths = np.diff(bounds)
    if bounds.size <= 2 or not _has_one_stop(lengths):
        return values
    run = int(np.argmax(lengths))
    return np.delete(values, slice(int(bounds[run]), int(bounds[run + 1])))


def _has_one_stop(lengths: Int) -> bool:
    """Whether one of the runs of one value, of so many samples each, is far longer than every other."""
    longest, second = np.sort(np.append(lengths, 0))[-1:-3:-1]
    return bool(longest >= max(_FEWEST_HELD, _LONGER * second))


def _find_swings(time_s: Float, values: Float) -> _Swings:
    """All swings of a signal, each judged by the one before: those near the largest are seen as well as those a hundred times smaller."""
    sound = np.isfinite(values)
    t, x = time_s[sound], values[sound]
    floor = _estimate_floor(x) if x.size > 2 else np.inf
    slope = np.sign(np.diff(x))
    moving = np.flatnonzero(slope)
    turning = moving[1:][slope[moving[1:]] != slope[moving[:-1]]]
    extremes = np.concatenate([[0], turning, [x.size - 1]]).astype(np.int64) if x.size else np.zeros(0, dtype=np.int64)
    turns = _drop_small_turns(x[extremes], floor)
    places = extremes[turns]
    if places.size < 2:
        return _Swings(np.zeros(0), np.zeros(0), floor)
    middle = (x[places[1:]] + x[places[:-1]]) / 2
    near = np.convolve(
        np.pad(middle, _CROSSINGS // 2, mode="edge"), np.full(_CROSSINGS + 1, 1 / (_CROSSINGS + 1)), "valid"
    )
    crossed = [
        _pass(t, x, a, b, level)
        for a, b, level in zip(places[:-1].tolist(), places[1:].tolist(), near.tolist(), strict=True)
    ]
    return _Swings(np.array(crossed), np.abs(np.diff(x[places])), floor)


def _drop_small_turns(extremes: Float, floor: float) -> list[int]:
    """Numbers of those extremes (n,) between which a signal swings, smaller ones on the way left out."""
    if extremes.size == 0:
        return []
    turns, last, swing = [0], 0, 0.0
    for number, value in enumerate(extremes.tolist()):
        if number == 0:
            continue
        back = value - extremes[last]
        on = extremes[last] - extremes[turns[-1]]
        if last == turns[-1] or back * on > 0:
            if last == turns[-1] or abs(value - extremes[turns[-1]]) > abs(on):
                last = number
        elif abs(back) > max(floor, _TURNS * max(swing, abs(on))):
            swing = abs(on)
            turns.append(last)
            last = number
    return turns


def _pass(time_s: Float, values: Float, first: int, last: int, level: float) -> float:
    """When a signal passes a level between two of its turns."""
    part = values[first : last + 1] - np.clip(level, *sorted((values[first], values[last])))
    at = first + int(np.argmax(np.sign(part[1:]) != np.sign(part[0])))
    step = values[at + 1] - values[at]
    return float(time_s[at] - part[at - first] / step * (time_s[at + 1] - time_s[at])) if step else float(time_s[at])


def _find_crossings(time_s: Float, values: Float) -> Float:
    """Times (n,) at which a sine crosses its level, noise left out."""
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
    """The highest frequency of a sweep; None where it may go on below the noise."""
    swings = _find_swings(time_s, values)
    crossed = swings.crossed_s
    if crossed.size < _FEWEST_CROSSINGS:
        return None
    spans = crossed[_CROSSINGS:] - crossed[:-_CROSSINGS]
    # Where a sweep is faded in or out, and in the rest, swings are clearly smaller than those near by.
    largest = maximum_filter1d(swings.size, 2 * _CROSSINGS + 1)
    full = minimum_filter1d(swings.size / largest, _CROSSINGS + 1, origin=-(_CROSSINGS // 2))[: spans.size] > _FADED
    if not full.any():
        return None
    fastest = int(np.argmin(np.where(full, spans, np.inf)))
    return float(_CROSSINGS / 2 / spans[fastest]) if swings.size[fastest] > _CLEAR * swings.floor else None


def read_period(values: Float) -> int | None:
    """Samples after which a signal repeats while it moves, to the sample; None where it does not."""
    moved = _cut_moving(values)
    if moved is None:
        return None
    step = max(1, moved.size // _COARSE)
    coarse = moved[: moved.size // step * step].reshape(-1, step).mean(axis=1)
    apart = _measure_repetition(coarse - coarse.mean())
    far = np.flatnonzero(apart > _OTHER_SHAPE)
    if not far.size or not (apart[far[0] :] < _SAME_SHAPE).any():
        return None
    later = apart[far[0] :]
    first = int(np.flatnonzero(later <= later.min() + _SAME_SHAPE)[0])
    while first + 1 < later.size and later[first + 1] < later[first]:
        first += 1
    lag = (int(far[0]) + first) * step
    near = range(max(lag - 2 * step, 1), min(lag + 2 * step + 1, moved.size - 1))
    return min(near, key=lambda lag: float(np.mean((moved[lag:] - moved[:-lag]) ** 2)))


def _cut_moving(values: Float) -> Float | None:
    """A signal from where it begins to move to where it ends; None where it hardly does."""
    sound = np.nan_to_num(values)
    moving = np.flatnonzero(np.abs(sound) > _STILL * np.abs(sound).max())
    return sound[moving[0] : moving[-1] + 1] if moving.size >= _FEWEST_HELD else None


def repeats_after(values: Float, lag: int) -> bool:
    """Whether a signal, while it moves, is so many samples later more like itself than another."""
    moved = _cut_moving(values)
    if moved is None or not 0 < lag < moved.size - 1:
        return False
    return bool(np.mean((moved[lag:] - moved[:-lag]) ** 2) < 2 * _OTHER_SHAPE * np.var(moved))


def _measure_repetition(x: Float) -> Float:
    """Mean square of what a signal (n,) differs from itself later by, over twice its own mean square, for lags up to 3/4 of it."""
    n = x.size
    spectrum = np.fft.rfft(x, 2 * n)
    products = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[:n]
    energy = np.concatenate([[0.0], np.cumsum(x**2)])
    lags = np.arange(3 * n // 4)
    both = energy[n - lags] + energy[n] - energy[lags]
    return np.asarray(1 - 2 * products[lags] / np.maximum(both, np.finfo(float).tiny))


def _see_period(time_s: Float, values: Float) -> float | None:
    """Periods of a multisine per second."""
    period = read_period(values)
    return None if period is None else float((time_s.size - 1) / (period * time_s[-1]))


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
    "sphs": _Reading(lambda metadata: None if metadata.period_s is None else 1 / metadata.period_s, _see_period),
}
_MOVING = frozenset(_FREQUENCIES)
"""Protocols whose input moves all the time but before and after the test."""
