"""Self-sensing actuators written out in time: nothing here is shared with the virtual rig or with the analysis.

Transients are stretched exponentials, drifts are powers and stretched exponentials of time, wrinkling is a soft minimum
with a dead time, migrating electrodes cut notches into a wave: other forms than those that are fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

Float = NDArray[np.float64]
START_NS = 1_767_225_600_000_000_000
VACUUM = 8.8541878e-6


def metadata(**keys: Any) -> RecordingMetadata:
    """Metadata of an electrical step recording."""
    given: dict[str, Any] = {
        "recording_id": "truth-1",
        "protocol": "step",
        "loading": "electrical",
        "specimen_id": "T-1",
        "started_at": datetime(2026, 1, 1, tzinfo=UTC),
    }
    return RecordingMetadata(**(given | keys))


def recording(about: RecordingMetadata, time_s: Float, **values: Float) -> Recording:
    """A recording of channels on one clock."""
    ns = START_NS + np.round(time_s * 1e9).astype(np.int64)
    return Recording(about, RigConstants(), {name: Channel(name, ns, v) for name, v in values.items()})


def coloured(rng: np.random.Generator, n: int, sd: float, memory: float) -> Float:
    """Noise of the given standard deviation, correlated from sample to sample by `memory`."""
    white = rng.standard_normal(n)
    if memory:
        for i in range(1, n):
            white[i] = memory * white[i - 1] + np.sqrt(1 - memory**2) * white[i]
    return sd * white


def stretched(since: Float, instant: float, tau: float, beta: float) -> Float:
    """0 before, `instant` at once, 1 in the end: 1 − (1 − instant) e^{−(t/τ)^β}."""
    t = np.maximum(since, 0.0)
    return np.where(since >= 0, 1 - (1 - instant) * np.exp(-((t / tau) ** beta)), 0.0)


def slow(rng: np.random.Generator, time_s: Float) -> Float:
    """A slow fall from 0 to about −1 over the record: a power, a stretched exponential or a straight line."""
    share = time_s / time_s[-1]
    kind = rng.integers(3)
    if kind == 0:
        return -(((time_s + 5) ** 0.3 - 5**0.3) / ((time_s[-1] + 5) ** 0.3 - 5**0.3))
    if kind == 1:
        return -(1 - np.exp(-((2.5 * share) ** 0.8))) / (1 - np.exp(-(2.5**0.8)))
    return -share


@dataclass(frozen=True)
class Sensing:
    """What is true of one self-sensing actuator, and its recording."""

    recording: Recording
    slope_n: float
    exponent: float
    sensitivity: float
    drift_pf_per_hour: float
    force_change_n: float
    capacitance_change_pf: float
    force_steps_n: Float
    capacitance_steps_pf: Float


def sensing(rng: np.random.Generator, *, exponent: float = 2.0) -> Sensing:
    """One actuator with a separate sensing region, nine to twelve steps of 10 s, drift, spikes and noise."""
    levels = np.array([3.0, 4, 5, 6, 7, 8, 9, 10, 11]) if rng.random() < 0.7 else rng.choice([5.0, 7, 9], 12)
    rate, on, off, lead = 100.0, 10.0, 10.0, 4.0
    t = np.arange(int(rate * (lead + levels.size * (on + off)))) / rate
    stretch, width, thickness = rng.uniform(1.3, 1.7), 50.0, 1.0
    total, active = 50.0 * stretch, rng.uniform(15, 25)
    modulus = rng.uniform(0.1, 0.3)
    slope = modulus * width * thickness / stretch
    geometric = active / (total - active)
    permittivity = 4.7 * (1 + 0.1 * rng.standard_normal())
    per_kv2 = VACUUM * permittivity * 30.0 * stretch * stretch**-0.5 / thickness
    scale = per_kv2 / 8.0 ** (exponent - 2)
    painted = 1 + rng.choice([0.0, 0.01]) * rng.standard_normal(levels.size)
    strain = geometric * scale * levels**exponent / (slope * (1 + geometric)) * painted
    drop = slope * strain * (1 + rng.choice([0.0, 0.004]) * rng.standard_normal(levels.size))
    c0 = rng.uniform(20, 40)
    per_hour = rng.choice([0.0, rng.uniform(-4, 4)])
    own_force, own_relation = rng.choice([0.0, 0.015]) * slow(rng, t), rng.choice([0.0, 1.0])
    pulled, sensed = np.zeros(t.size), np.zeros(t.size)
    # The relation itself carries a fall of tension into the capacitance; what comes on top is drift at given force.
    slow_c = c0 * own_relation * own_force / slope + per_hour * t / 3600
    drift = per_hour + (0 if own_relation else np.nan if own_force.any() else 0)
    voltage = np.zeros(t.size)
    shape_f = rng.uniform(0.85, 0.95), rng.uniform(0.3, 0.8), rng.uniform(0.7, 1.0)
    shape_c = rng.uniform(0.4, 0.6), rng.uniform(0.3, 0.8), rng.uniform(0.7, 1.0)
    for i, kv in enumerate(levels):
        begin = lead + i * (on + off)
        voltage[(t >= begin) & (t < begin + on)] = kv
        pulled += drop[i] * (stretched(t - begin, *shape_f) - stretched(t - begin - on, *shape_f))
        sensed -= c0 * strain[i] * (stretched(t - begin, *shape_c) - stretched(t - begin - on, *shape_c))
    starts = lead + np.arange(levels.size) * (on + off)
    force_steps, capacitance_steps = (_changes(t, x, starts, on) for x in (pulled, sensed))
    force, capacitance = 0.5 + own_force - pulled, c0 + slow_c + sensed
    for edge in np.concatenate([starts, starts + on]):
        capacitance[np.searchsorted(t, edge) : np.searchsorted(t, edge) + 2] += rng.choice([0.0, 2.0])
    memory = rng.choice([0.0, 0.3])
    made = recording(
        metadata(
            film_length_mm=50.0,
            film_width_mm=width,
            film_thickness_mm=thickness,
            stretch_1=stretch,
            total_length_mm=total,
            active_length_mm=active,
            active_width_mm=30.0,
            active_drawn="stretched",
            sensing_length_mm=15.0,
            sensing_width_mm=30.0,
            relative_permittivity=4.7,
        ),
        t,
        voltage=voltage + 0.003 * rng.standard_normal(t.size),
        force=force + coloured(rng, t.size, 0.001, memory),
        capacitance=capacitance + coloured(rng, t.size, 0.002, memory),
    )
    first, last = lead - 0.25, t[-1] - 0.25
    force_change, capacitance_change = (float(np.diff(np.interp([first, last], t, x))[0]) for x in (own_force, slow_c))
    return Sensing(
        made,
        slope,
        exponent,
        -geometric,
        drift,
        force_change,
        capacitance_change,
        force_steps,
        capacitance_steps,
    )


def _changes(t: Float, x: Float, starts: Float, on: float) -> Float:
    """Change of x from the half second before each start to the half second before each end."""
    return np.array([x[(t >= s + on - 0.5) & (t < s + on)].mean() - x[(t >= s - 0.5) & (t < s)].mean() for s in starts])


@dataclass(frozen=True)
class Wrinkles:
    """Steps of a film that wrinkles above `onset_kv`; None where it does not."""

    recording: Recording
    onset_kv: float | None


def wrinkles(rng: np.random.Generator, *, wrinkled: bool) -> Wrinkles:
    """Levels in steps of 0.5 or 1 kV, 2 s on; two levels at or beyond the onset at least where there is one.

    A film without wrinkles may have what resembles one: a permittivity that falls with the field, a supply that sags at
    the top, an exponent that is not 2.
    """
    spacing = rng.choice([0.5, 1.0])
    levels = np.arange(2.0, 8.01, spacing)
    onset = None
    if wrinkled:
        free = rng.uniform(4.0, levels[-2])
        onset = float(rng.choice([free, levels[np.argmin(np.abs(levels - free))]]))
    rate, on, off, lead = 100.0, 2.0, rng.choice([3.0, 5.0]), 1.0
    t = np.arange(int(rate * (lead + levels.size * (on + off)))) / rate
    c0, top = rng.uniform(15, 30), rng.uniform(0.8, 2.0)
    size = top * (levels / 8.0) ** rng.uniform(1.9, 2.1)
    size = size * (1 - rng.uniform(0, 0.15) * (levels / 8.0) ** 2)
    if rng.random() < 0.3:
        size[-1] *= rng.uniform(0.9, 1.0)
    if onset is not None:
        sharp = rng.uniform(8, 20)
        limit = np.interp(onset, levels, size)
        size = (size**-sharp + limit**-sharp) ** (-1 / sharp)
    tau, beta = rng.uniform(0.1, 0.3), rng.uniform(0.7, 1.0)
    late = rng.uniform(1.0, 2.5)
    voltage, capacitance, force = np.zeros(t.size), np.full(t.size, c0), np.full(t.size, 0.4)
    for i, kv in enumerate(levels):
        begin = lead + i * (on + off)
        voltage[(t >= begin) & (t < begin + on)] = kv
        beyond = 0.0 if onset is None else max(kv / onset - 1, 0.0)
        dead, slower = 0.6 * late * beyond, 1 + 4 * late * beyond
        back = stretched(t - begin - on - dead, 0.3 / slower, tau * slower, beta)
        capacitance = capacitance - size[i] * (stretched(t - begin, 0.5, tau, beta) - back)
        force = force - 0.05 * size[i] * (
            stretched(t - begin, 0.8, tau, beta) - stretched(t - begin - on, 0.8, tau, beta)
        )
    noise = rng.uniform(0.001, 0.004)
    return Wrinkles(
        recording(
            metadata(),
            t,
            voltage=voltage + 0.003 * rng.standard_normal(t.size),
            force=force + 0.001 * rng.standard_normal(t.size),
            capacitance=capacitance + noise * rng.standard_normal(t.size),
        ),
        onset,
    )


@dataclass(frozen=True)
class Waves:
    """A sensing region under cyclic strain whose electrode migrates from `onset_cycle` on; None where it does not."""

    recording: Recording
    onset_cycle: float | None
    frequency_hz: float


def waves(rng: np.random.Generator, *, migrating: bool) -> Waves:
    """250 to 800 cycles; notches in the wave grow straight, to saturation, by a root or spot after spot."""
    cycles, frequency, rate = int(rng.integers(250, 800)), 1.0, float(rng.choice([25.0, 40.0]))
    t = np.arange(int(rate * (cycles / frequency + 2))) / rate
    since = np.clip((t - 1.0) * frequency, 0, cycles)
    stroke = 0.5 - 0.5 * np.cos(2 * np.pi * since)
    amplitude, c0 = rng.uniform(0.5, 1.5), rng.uniform(25, 60)
    wave = c0 + amplitude * (2 * stroke + rng.uniform(0, 0.03) * stroke**2)
    onset = None
    if migrating:
        onset = float(rng.uniform(0.15, 0.75) * cycles)
        past = np.maximum(since - onset, 0.0) / cycles
        kind = rng.integers(4)
        grown = (past, -np.expm1(-past / 0.1), np.sqrt(past), past + np.maximum(past - 0.15, 0) * 2)[kind]
        share, width = rng.uniform(0.2, 0.8), rng.uniform(0.08, 0.2)
        notch = np.exp(-(((stroke - share) / width) ** 2)) if rng.random() < 0.7 else np.maximum(stroke - share, 0)
        wave = wave - rng.uniform(0.3, 1.0) * amplitude * grown * notch
    wave = wave - rng.uniform(0, 0.3) * since / cycles
    about = metadata(protocol="cyclic", loading="mechanical", frequency_hz=frequency, cycles=cycles)
    return Waves(
        recording(
            about,
            t,
            displacement=2 * stroke,
            force=0.1 * stroke,
            capacitance=wave + 0.002 * rng.standard_normal(t.size),
        ),
        onset,
        frequency,
    )
