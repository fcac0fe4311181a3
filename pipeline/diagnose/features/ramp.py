"""Features of steps of displacement and of large cycles: means of the force in windows, against the rest before.

Windows after a ramp are equally wide in log time, those of a cycle equally long while it loads and unloads. The measured
displacement, ramps and all, is the input of the operators.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from pipeline.diagnose.features.blocks import Signals, add_rounding, add_unit_noise, block, log_windows, window_means
from pipeline.diagnose.features.functionals import Component, lines_spectrum
from pipeline.diagnose.features.kinds import CYCLE_FORCE, RELAXATION_FORCE, REST_INPUT, FeatureBlock, NoiseSample
from pipeline.diagnose.features.records import (
    Record,
    clamp_hz,
    record,
    rest_samples,
    ringing_s,
    strain_length_mm,
    white_sd,
)
from pipeline.diagnose.rules import RULES
from pipeline.transform.channels import drive
from pipeline.transform.sampling import runs
from pipeline.transform.staircase import find_levels
from schemas.arrays import Complex, Float
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording

_PER_DECADE = 8
"""Windows of a hold per decade of time."""
_PER_BRANCH = 16
"""Windows of the loading and of the unloading of a cycle."""
_MOVING = 0.02
"""Share of the step by which the displacement may miss its level and still count as held."""
_SMOOTH = 5
"""Degree of the polynomial that follows the second half of a relaxation: in log time that is a tenth of three decades."""
_RINGING_TURNS = 3.0
"""Turns of the clamp after a step in which it rings, and which are no feature."""
_HIGHEST_HZ = 200.0
"""Highest frequency of interest in a hold, Hz."""
_LONGEST = 60_000
"""Samples to which a long record is thinned."""


def relaxation_blocks(
    recording: Recording, nodes: Float
) -> tuple[list[FeatureBlock], list[NoiseSample], dict[str, float], list[str]]:
    """Blocks, noise, values, warnings of a mechanical `step`. Raises `NotIdentifiableError` where nothing can be read."""
    found, x, y, names, rest = _prepared(recording)
    holds = _holds(x, rest)
    of_force, quiet = _read_noise(found, names[1], y, rest, holds)
    noise = [found.noise(names[0], x[:rest]), of_force]
    rounding = found.rounding(names[1], quiet)
    settling = max(_RINGING_TURNS / clamp_hz(recording.rig), ringing_s(recording.rig, found.interval_s))
    x = _held(x, rest, holds)
    windows: list[tuple[int, int]] = []
    ramps: list[int] = []
    for begin, start, stop in holds:
        # What the noise of the displacement within the ramp rings in the clamp is no part of the noise measured at rest.
        first = start - begin + max(2, int(settling / found.interval_s))
        made = [(begin + a, begin + b) for a, b in log_windows(first, stop - begin, _PER_DECADE, 2)]
        windows += [w for w in made if _is_recorded(found, *w)]
        ramps += [begin] * (len(windows) - len(ramps))
    if len(windows) < RULES.features.ramp_windows:
        raise NotIdentifiableError(
            f"{len(windows)} windows while the step is held",
            where=recording.metadata.recording_id,
            expected=f"at least {RULES.features.ramp_windows}",
        )
    return _finished(recording, found, x, y, names, rest, windows, ramps, nodes, RELAXATION_FORCE, noise, rounding)


def _read_noise(
    found: Record, quantity: str, values: Float, rest: int, holds: list[tuple[int, int, int]]
) -> tuple[NoiseSample | None, Float]:
    """The noise of an output (n,) and the samples that show it: the rest, or, where that is too short or stands still, the second half of the
    longest hold, about a smooth relaxation."""
    at_rest = values[:rest]
    noise = found.noise(quantity, at_rest)
    if noise is None and holds:
        _, start, stop = max(holds, key=lambda hold: hold[2] - hold[1])
        second = values[(start + stop) // 2 : stop]
        if not found.lost[(start + stop) // 2 : stop].any():
            return found.noise(quantity, second, degree=_SMOOTH), second
    return noise, at_rest


def _is_recorded(found: Record, a: int, b: int) -> bool:
    """Whether a window of a hold has samples: all of them, or those of a recording that slowed down by then."""
    lost = found.lost[a:b]
    return not lost.any() or (found.slowed and not lost.all())


def _held(x: Float, rest: int, holds: list[tuple[int, int, int]]) -> Float:
    """The displacement with straight lines where it rests or holds and misses them by noise alone.

    The noise of the displacement is then in its ramps only; what the film does not feel must not be predicted.
    """
    calm = x.copy()
    for a, b in [(0, rest), *((start, stop) for _, start, stop in holds)]:
        if b - a < 32:
            continue
        s = np.linspace(-1, 1, b - a)
        line = np.polynomial.polynomial.polyval(s, np.polynomial.polynomial.polyfit(s, x[a:b], 1))
        error = x[a:b] - line
        blocks = error[: error.size // 16 * 16].reshape(16, -1).mean(axis=1)
        if float(np.mean(blocks**2)) < 3 * float(np.mean(error**2)) * 16 / error.size:
            calm[a:b] = line
    return calm


def cycle_blocks(
    recording: Recording, nodes: Float
) -> tuple[list[FeatureBlock], list[NoiseSample], dict[str, float], list[str]]:
    """Blocks, noise, values, warnings of a `cycle`. Raises `NotIdentifiableError` where nothing can be read."""
    found, x, y, names, rest = _prepared(recording)
    noise = [found.noise(q, v[:rest]) for q, v in zip(names, (x, y), strict=True)]
    top = int(np.argmax(np.abs(x)))
    moving = np.flatnonzero(np.abs(x - x[-1]) > 3e-3 * np.abs(x[top]))
    last = int(moving[-1]) + 1 if moving.size and abs(x[-1]) < 0.5 * abs(x[top]) else x.size
    windows = []
    for a, b in ((rest, top), (top, last)):
        edges = np.unique(np.rint(np.linspace(a, b, _PER_BRANCH + 1)).astype(int))
        windows += [(int(p), int(q)) for p, q in itertools.pairwise(edges) if not found.lost[p:q].any()]
    if len(windows) < RULES.features.ramp_windows:
        raise NotIdentifiableError("no cycle above the noise", where=recording.metadata.recording_id)
    lines = _lines(x, found.interval_s, (rest, top, last))
    return _finished(
        recording, found, x, y, names, rest, windows, [rest] * len(windows), nodes, CYCLE_FORCE, noise,
        found.rounding(names[1], y[:rest]), lines,
    )  # fmt: skip


def _lines(x: Float, interval_s: float, corners: tuple[int, int, int]) -> Callable[[Float], Complex] | None:
    """Spectrum of the two straight branches of a triangle, None where the displacement is none or does not come back."""
    start, top, end = corners
    fits = []
    for a, b in ((start, top), (top, end)):
        inner = np.arange(a + (b - a) // 20, b - (b - a) // 20)
        if inner.size < 8:
            return None
        slope, level = np.polyfit(inner * interval_s, x[inner], 1)
        if np.abs(x[inner] - slope * inner * interval_s - level).max() > 5e-3 * np.abs(x).max():
            return None
        fits.append((float(slope), float(level)))
    (up, rise), (down, fall) = fits
    if np.abs(x[end:]).mean() > 5e-3 * np.abs(x).max() if end < x.size else True:
        return None
    at = (fall - rise) / (up - down)
    return lines_spectrum(np.array([-rise / up, at, -fall / down]), np.array([0.0, up * at + rise, 0.0]), interval_s)


def _prepared(recording: Recording) -> tuple[Record, Float, Float, tuple[str, str], int]:
    source = drive(recording)
    names = source.input.quantity, source.output.quantity
    rate = _LONGEST / max(recording.duration_s, 1e-9)
    channels = {names[0]: source.input, names[1]: source.output}
    found = record(channels, recording, highest_hz=min(_HIGHEST_HZ, rate / 10), may_slow_down=True)
    given = found.values[names[0]]
    rest = rest_samples(given)
    if rest < RULES.features.ramp_rest:
        # A machine that starts with the record: its first sample is the rest.
        rest = 1
    x, y = (found.values[q] - found.values[q][:rest].mean() for q in names)
    return found, x, y, names, rest


def _holds(x: Float, rest: int) -> list[tuple[int, int, int]]:
    """(start of the ramp, first held sample, end of the hold) of each step up or down."""
    reach = float(np.abs(x).max())
    noise = float(x[:rest].std()) if rest > 1 else 0.0
    width = max(2, x.size // 2000)
    moved = np.abs(x[width:] - x[:-width]) > max(_MOVING * reach, 6 * noise)
    ramps = runs(moved)
    merged: list[list[int]] = []
    for a, b in ramps:
        if merged and a - merged[-1][1] < 4 * width:
            merged[-1][1] = b + width
        else:
            merged.append([a, b + width])
    # The half-cosine or linear ends of a ramp move less than the threshold: a tenth of the ramp on both sides.
    padded = [(max(a + width // 2 - (b - a) // 10, rest), min(b + (b - a) // 10, x.size)) for a, b in merged]
    ends = [*(a for a, _ in padded[1:]), x.size][: len(padded)]
    return [(a, b, e) for (a, b), e in zip(padded, ends, strict=True) if e - b > 8] or _slow_holds(x, rest)


def _slow_holds(x: Float, rest: int) -> list[tuple[int, int, int]]:
    """The same of ramps so slow that no two neighbours are clearly apart: the levels at which the displacement stands."""
    levels = [hold for hold in find_levels(np.arange(x.size, dtype=float), x) if hold.start_s >= rest]
    ends = [rest, *(int(hold.end_s) for hold in levels)]
    found = [(begin, int(hold.start_s), int(hold.end_s) + 1) for begin, hold in zip(ends, levels, strict=False)]
    return [(a, b, e) for a, b, e in found if a < b and e - b > 8]


def _finished(
    recording: Recording,
    found: Record,
    x: Float,
    y: Float,
    names: tuple[str, str],
    rest: int,
    windows: list[tuple[int, int]],
    ramps: list[int],
    nodes: Float,
    kind: str,
    noise: list[NoiseSample | None],
    rounding: float,
    spectrum: Callable[[Float], Complex] | None = None,
) -> tuple[list[FeatureBlock], list[NoiseSample], dict[str, float], list[str]]:
    kernels = window_means(windows, 0, found.count, found.lost)
    kernels[:, :rest] -= 1 / rest
    height = float(np.abs(x).max())
    force = names[1]
    components = tuple(Component(force, exponent) for exponent in (0, 1, 2)) + found.mains
    factor = found.channel_factor(names[1], names[0])
    signals = Signals(
        x,
        y,
        found.interval_s,
        nodes,
        components,
        factor,
        slow=True,
        spectrum=spectrum,
        noise_sd=float(y[:rest].std()),
        largest_response=float(np.abs(y).max()) / height,
    )
    length = strain_length_mm(recording)
    at = np.array([(a + b) / 2 for a, b in windows])
    strain = np.array([float(np.abs(x[a:b]).mean()) for a, b in windows]) / length
    made = block(
        kind,
        "windows",
        signals,
        kernels,
        0,
        is_complex=False,
        amplitude=strain,
        cycle=1.0,
        time=at * found.interval_s,
        support={"since_s": (at - np.array(ramps)) * found.interval_s, "strain": _strains(x, windows, length)},
        drifts=True,
    )
    # The level at which the displacement rests is known from so many samples only, and all that is held is off by its error.
    level_error = made.value / height * white_sd(x, ()) / np.sqrt(rest)
    made = add_unit_noise(add_rounding(made, rounding), np.outer(level_error, level_error))
    values = {
        "largest_strain": height / length,
        "rest_force_n": float(found.values[force][:rest].mean()),
        REST_INPUT: float(found.values[names[0]][:rest].mean()),
    }
    return [made], [n for n in noise if n is not None], values, []


def _strains(x: Float, windows: list[tuple[int, int]], length: float) -> Float:
    """Signed mean strain of each window."""
    return np.array([float(x[a:b].mean()) for a, b in windows]) / length
