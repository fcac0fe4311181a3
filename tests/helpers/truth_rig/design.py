"""Designs of recordings and the excitation they ask for, on the fine grid of the integrator.

A design is a small dict: `protocol`, `loading` where the protocol has several, and the keys of the tables below (the
package's docstring describes them). Does not belong here: the rig's answer to the excitation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

COMMON: Mapping[str, Any] = {
    "rest_before_s": 60.0,
    "extra_clamp_mass_kg": 0.0,
    "pre_extension_mm": 0.0,
    "sample_rate_hz": None,
    "temperature": False,
    "warmer_k": None,
}
TESTS: Mapping[str, Mapping[str, Any]] = {
    "chirp": {
        "strain_pp": 0.02, "frequency_start_hz": 1.0, "frequency_stop_hz": 100.0, "sweep": "log", "sweep_s": 6.0,
        "rest_s": 2.0, "repeats": 2, "knee_hz": 30.0,
    },
    "sphs": {
        "drive_kv": 7.0, "frequency_start_hz": 0.5, "frequency_stop_hz": 100.0, "period_s": 2.0, "periods": 7,
        "lines": "odd", "rest_s": 0.5, "polarity": 1, "lines_seed": 0, "leakage_current": False,
    },
    "cyclic": {"strain_pp": 0.04, "frequency_hz": 1.0, "cycles": 10, "rest_s": 1.0},
    "step": {
        "drive_kv": 7.0, "on_s": 5.0, "off_s": 5.0, "cycles": 3, "rest_s": 1.0, "edge_s": 0.02, "polarity": 1,
        "leakage_current": False,
    },
    "relaxation": {"strain_pp": 0.05, "ramp_s": 0.2, "hold_s": 40.0, "rest_s": 8.0, "after_s": 6.0},
    "cycle": {"strain_pp": 0.1, "rate_per_s": 0.05, "rest_s": 1.0},
    "tap": {"taps": 3, "tap_n": 1.0, "tap_every_s": 3.0},
    "weight": {"masses_kg": (0.02, 0.05, 0.1), "plateau_s": 5.0},
}  # fmt: skip
"""Keys of each test with their defaults; `relaxation` is the protocol `step` with loading `mechanical`."""
LOADING = {
    "chirp": "mechanical", "sphs": "electrical", "cyclic": "mechanical", "step": "electrical",
    "relaxation": "mechanical", "cycle": "mechanical", "tap": "calibration", "weight": "calibration",
}  # fmt: skip
_RATE_HZ = {
    "chirp": 1000.0, "sphs": 1000.0, "cyclic": 250.0, "step": 500.0, "relaxation": 250.0, "cycle": 250.0,
    "tap": 2000.0, "weight": 100.0,
}  # fmt: skip
_FINEST_S = {"chirp": 1.25e-4, "sphs": 1.25e-4, "step": 2.5e-4, "tap": 1.25e-4}
_COARSE_S = 5e-4
_DEPTH = 0.95
"""Depth of the SPHS: the squared voltage swings by this share around its mean, so that the voltage never meets 0."""


@dataclass(frozen=True)
class Plan:
    """A design made whole. `displacement` mm and `command` kV asked for, at half steps of `step_s`, (2 N + 1,).

    Sample i is fine step i × `substeps`.
    """

    test: str
    protocol: str
    loading: str
    design: Mapping[str, Any]
    metadata: Mapping[str, Any]
    step_s: float
    substeps: int
    displacement: Float
    command: Float

    @property
    def samples(self) -> int:
        return (self.displacement.size - 1) // (2 * self.substeps) + 1

    @property
    def sample_interval_s(self) -> float:
        return self.step_s * self.substeps

    @property
    def duration_s(self) -> float:
        return self.step_s * (self.displacement.size - 1) / 2


def completed(design: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """The test of a design and all its keys with defaults. `ValueError` for unknown protocols and keys."""
    given = {key: value for key, value in design.items() if value is not None}
    protocol, loading = given.pop("protocol", None), given.pop("loading", None)
    test = "relaxation" if (protocol, loading) == ("step", "mechanical") else protocol
    if protocol == "relaxation" or test not in TESTS or loading not in (None, LOADING[test]):
        raise ValueError(f"the truth rig has no test {protocol!r} with loading {loading!r}")
    known = {**COMMON, **TESTS[test]}
    if unknown := set(given) - set(known):
        raise ValueError(f"a {test} has no {sorted(unknown)}; it has {sorted(known)}")
    return test, {**known, **given}


def plan(design: Mapping[str, Any], *, length_mm: float, fastest_s: float) -> Plan:
    """The excitation of a design for a film of that stretched length and fastest relaxation time."""
    test, keys = completed(design)
    rate = float(keys["sample_rate_hz"] or _RATE_HZ[test])
    substeps = math.ceil(1 / (rate * min(_FINEST_S.get(test, _COARSE_S), 0.6 * fastest_s)) - 1e-9)
    step = 1 / (rate * substeps)
    duration, make = _MAKERS[test](keys, length_mm)
    samples = round(duration * rate) + 1
    t = np.arange(2 * (samples - 1) * substeps + 1) * (step / 2)
    displacement, command, metadata = make(t)
    return Plan(
        test=test,
        protocol="step" if test == "relaxation" else test,
        loading=LOADING[test],
        design=keys,
        metadata=metadata,
        step_s=step,
        substeps=substeps,
        displacement=displacement,
        command=command,
    )


def _half_cosine(progress: Float) -> Float:
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(progress, 0.0, 1.0)))


def _chirp(keys: Mapping[str, Any], length_mm: float) -> tuple[float, Any]:
    start, stop, sweep = keys["frequency_start_hz"], keys["frequency_stop_hz"], keys["sweep_s"]
    period = sweep + keys["rest_s"]
    amplitude = keys["strain_pp"] * length_mm / 2

    def make(t: Float) -> tuple[Float, Float, dict[str, Any]]:
        since = t - keys["rest_s"]
        u = np.where(since < 0, -1.0, np.mod(since, period))
        inside = (u > 0) & (u < sweep)
        u = u[inside]
        if keys["sweep"] == "log":
            growth = math.log(stop / start) / sweep
            f = start * np.exp(growth * u)
            phase = 2 * np.pi * (f - start) / growth
        else:
            f = start + (stop - start) / sweep * u
            phase = np.pi * (start + f) * u
        envelope = amplitude / np.hypot(1.0, f / keys["knee_hz"])
        envelope *= _half_cosine(u * 2 * start) * _half_cosine((sweep - u) * stop / 5)
        x = np.zeros(t.size)
        x[inside] = envelope * np.sin(phase)
        metadata = {key: keys[key] for key in ("frequency_start_hz", "frequency_stop_hz", "sweep", "repeats")}
        return x, np.zeros(t.size), metadata | {"period_s": period, "strain_pp": keys["strain_pp"]}

    return keys["rest_s"] + keys["repeats"] * period, make


def _lines(kind: str, first: int, last: int, seed: int) -> NDArray[np.int64]:
    if kind == "full":
        return np.arange(first, last + 1)
    odd = np.arange(first | 1, last + 1, 2)
    if kind == "odd":
        return odd
    if kind != "random_odd":
        raise ValueError(f"lines {kind!r}")
    rng = np.random.default_rng([seed, 0x11])
    groups = odd[: odd.size // 4 * 4].reshape(-1, 4)
    left_out = groups[np.arange(len(groups)), rng.integers(4, size=len(groups))]
    return odd[~np.isin(odd, left_out)]


def _sphs(keys: Mapping[str, Any], length_mm: float) -> tuple[float, Any]:
    period, peak = keys["period_s"], keys["drive_kv"] * keys["polarity"]
    lead_in_s = 0.02

    def make(t: Float) -> tuple[Float, Float, dict[str, Any]]:
        points = round(period / (t[1] - t[0]))
        first, last = math.ceil(keys["frequency_start_hz"] * period - 1e-9), round(keys["frequency_stop_hz"] * period)
        lines = _lines(keys["lines"], max(first, 1), last, keys["lines_seed"])
        k = np.arange(1, lines.size + 1)
        spectrum = np.zeros(points // 2 + 1, dtype=complex)
        spectrum[lines] = np.exp(-1j * np.pi * k * (k - 1) / lines.size)
        wave = np.fft.irfft(spectrum, n=points)
        wave *= _DEPTH / np.abs(wave).max()
        one = peak * np.sqrt((1 + wave) / (1 + _DEPTH))
        before = round(keys["rest_s"] / (t[1] - t[0]))
        volts = np.where(np.arange(t.size) < before, 0.0, one[(np.arange(t.size) - before) % points])
        rise = (t > keys["rest_s"] - lead_in_s) & (t < keys["rest_s"])
        volts[rise] = one[0] * _half_cosine((t[rise] - keys["rest_s"] + lead_in_s) / lead_in_s)
        metadata = {key: keys[key] for key in ("frequency_stop_hz", "period_s", "periods", "lines", "drive_kv")}
        return np.zeros(t.size), volts, metadata | {"frequency_start_hz": lines[0] / period}

    # The last sample is the last one of the last period, not the first of a next.
    rate = float(keys["sample_rate_hz"] or _RATE_HZ["sphs"])
    return keys["rest_s"] + keys["periods"] * period - 1 / rate, make


def _cyclic(keys: Mapping[str, Any], length_mm: float) -> tuple[float, Any]:
    f, cycles = keys["frequency_hz"], keys["cycles"]

    def make(t: Float) -> tuple[Float, Float, dict[str, Any]]:
        u = np.clip(t - keys["rest_s"], 0, cycles / f)
        x = keys["strain_pp"] * length_mm / 2 * (1 - np.cos(2 * np.pi * f * u))
        return x, np.zeros(t.size), {key: keys[key] for key in ("frequency_hz", "cycles", "strain_pp")}

    return 2 * keys["rest_s"] + cycles / f, make


def _step(keys: Mapping[str, Any], length_mm: float) -> tuple[float, Any]:
    on, off, edge = keys["on_s"], keys["off_s"], keys["edge_s"]

    def make(t: Float) -> tuple[Float, Float, dict[str, Any]]:
        since = t - keys["rest_s"]
        u = np.where(since < 0, -1.0, np.mod(since, on + off))
        # The last sample lies on the start of a cycle that is not there.
        u = np.where(since >= keys["cycles"] * (on + off) - 1e-9, on + off, u)
        volts = keys["drive_kv"] * keys["polarity"] * (_half_cosine(u / edge) - _half_cosine((u - on) / edge))
        metadata = {key: keys[key] for key in ("drive_kv", "on_s", "off_s", "cycles")}
        return np.zeros(t.size), volts, metadata | {"controller": "open"}

    return keys["rest_s"] + keys["cycles"] * (on + off), make


def _relaxation(keys: Mapping[str, Any], length_mm: float) -> tuple[float, Any]:
    rest, ramp, hold = keys["rest_s"], keys["ramp_s"], keys["hold_s"]

    def make(t: Float) -> tuple[Float, Float, dict[str, Any]]:
        rise, fall = _half_cosine((t - rest) / ramp), _half_cosine((t - rest - ramp - hold) / ramp)
        return keys["strain_pp"] * length_mm * (rise - fall), np.zeros(t.size), {"strain_pp": keys["strain_pp"]}

    return rest + 2 * ramp + hold + keys["after_s"], make


def _cycle(keys: Mapping[str, Any], length_mm: float) -> tuple[float, Any]:
    rest, rate = keys["rest_s"], keys["rate_per_s"]
    top_s = keys["strain_pp"] / rate

    def make(t: Float) -> tuple[Float, Float, dict[str, Any]]:
        x = length_mm * np.clip(keys["strain_pp"] - rate * np.abs(t - rest - top_s), 0.0, None)
        return x, np.zeros(t.size), {"strain_pp": keys["strain_pp"], "cycles": 1}

    return 2 * rest + 2 * top_s, make


def _tap(keys: Mapping[str, Any], length_mm: float) -> tuple[float, Any]:
    def make(t: Float) -> tuple[Float, Float, dict[str, Any]]:
        return np.zeros(t.size), np.zeros(t.size), {}

    return keys["taps"] * keys["tap_every_s"], make


def _weight(keys: Mapping[str, Any], length_mm: float) -> tuple[float, Any]:
    def make(t: Float) -> tuple[Float, Float, dict[str, Any]]:
        return np.zeros(t.size), np.zeros(t.size), {"masses_kg": tuple(keys["masses_kg"])}

    return (len(keys["masses_kg"]) + 2) * keys["plateau_s"], make


_MAKERS = {
    "chirp": _chirp,
    "sphs": _sphs,
    "cyclic": _cyclic,
    "step": _step,
    "relaxation": _relaxation,
    "cycle": _cycle,
    "tap": _tap,
    "weight": _weight,
}
