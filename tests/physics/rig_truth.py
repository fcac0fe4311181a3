"""Independent truths for responses: closed forms and ordinary differential equations, none of it from the pipeline."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

START_NS = 1_772_000_000_000_000_000
POLYACRYLATE = (1.0, (1.5, 2.0, 30.0), (0.05, 0.02, 0.02))
"""Table 4.3, third order: k0, springs, dampers."""
SILICONE = (0.29, (0.30,), (1.4e-4,))


@dataclass(frozen=True)
class Truth:
    """Film (k0, ki, ci) on clamp (tonne) and load cell; N, mm, s."""

    film: tuple[float, tuple[float, ...], tuple[float, ...]] = POLYACRYLATE
    load_cell: float = 5.34
    clamp_alone_hz: float = 52.0
    damping_ratio: float = 0.005

    @property
    def mass(self) -> float:
        return self.load_cell / (2 * np.pi * self.clamp_alone_hz) ** 2

    @property
    def damping(self) -> float:
        return 2 * self.damping_ratio * np.sqrt(self.load_cell * self.mass)

    def stiffness(self, frequency_hz: Float) -> Complex:
        s = 2j * np.pi * np.asarray(frequency_hz)
        k0, springs, dampers = self.film
        return k0 + sum(k * c * s / (k + c * s) for k, c in zip(springs, dampers, strict=True))

    def measured(self, frequency_hz: Float) -> Complex:
        """F/x0."""
        return self.stiffness(frequency_hz) * self.ratio(frequency_hz)

    def ratio(self, frequency_hz: Float) -> Complex:
        """-F/F_A."""
        w = 2 * np.pi * np.asarray(frequency_hz)
        return self.load_cell / (
            self.stiffness(frequency_hz) + self.load_cell - self.mass * w**2 + 1j * w * self.damping
        )

    def constants(self, **changed: Any) -> RigConstants:
        values = {
            "clamp_mass_kg": self.mass * 1e3,
            "load_cell_stiffness_n_per_mm": self.load_cell,
            "load_cell_damping_n_s_per_mm": self.damping,
        }
        return RigConstants(**{**values, **changed})

    def force(self, time_s: Float, sweep: Sweep, moves: tuple[float, float]) -> Float:
        """Force by integration of the equations of motion (explicit Runge-Kutta of order 8) with the analytic input.

        The input only moves between `moves`; the integrator is told so, or it would step over the whole sweep.
        """
        k0, springs, dampers = self.film
        arms = [(k, k / c) for k, c in zip(springs, dampers, strict=True)]
        n = len(arms)
        mass, load_cell, damping = self.mass, self.load_cell, self.damping

        def rates(t: float, y: Float) -> list[float]:
            # Plain numbers: numpy's overhead on five of them would take most of the time.
            values = y.tolist()
            position, velocity = sweep.motion(t)
            x, v = values[n], values[n + 1]
            tension, out = k0 * (position - x), []
            for (k, rate), f in zip(arms, values[:n], strict=True):
                tension += f
                out.append(k * (velocity - v) - f * rate)
            return [*out, v, (tension - load_cell * x - damping * v) / mass]

        out = np.zeros(time_s.size)
        state = np.zeros(n + 2)
        inside = (time_s >= moves[0]) & (time_s <= moves[1])
        after = time_s > moves[1]
        options: dict[str, Any] = {"method": "DOP853", "rtol": 1e-7, "atol": 1e-9, "max_step": 2e-3}
        wanted = np.union1d(time_s[inside], moves[1])
        first = solve_ivp(rates, moves, state, t_eval=wanted, **options)
        out[inside] = self.load_cell * first.y[n, : inside.sum()]
        if after.any():
            times = time_s[after]
            rest = solve_ivp(rates, (moves[1], times[-1]), first.y[:, -1], t_eval=times, **options)
            out[after] = self.load_cell * rest.y[n]
        return out


@dataclass(frozen=True)
class Sweep:
    """Analytic sweep with smooth ends, in mm; zero outside [0, duration]."""

    start_hz: float
    stop_hz: float
    duration_s: float
    amplitude: float
    logarithmic: bool = True
    taper_s: float = 0.1

    def __call__(self, time_s: Float) -> Float:
        t = np.clip(time_s, 0.0, self.duration_s)
        if self.logarithmic:
            rate = np.log(self.stop_hz / self.start_hz) / self.duration_s
            phase = 2 * np.pi * self.start_hz * np.expm1(rate * t) / rate
        else:
            slope = (self.stop_hz - self.start_hz) / self.duration_s
            phase = 2 * np.pi * (self.start_hz + slope * t / 2) * t
        up, down = np.clip(t / self.taper_s, 0, 1), np.clip((self.duration_s - t) / self.taper_s, 0, 1)
        envelope = (0.5 - 0.5 * np.cos(np.pi * up)) * (0.5 - 0.5 * np.cos(np.pi * down))
        return self.amplitude * envelope * np.sin(phase)

    def motion(self, t: float) -> tuple[float, float]:
        """Displacement and velocity at one instant, in plain numbers."""
        if not 0 < t < self.duration_s:
            return 0.0, 0.0
        if self.logarithmic:
            rate = math.log(self.stop_hz / self.start_hz) / self.duration_s
            frequency = self.start_hz * math.exp(rate * t)
            phase = 2 * math.pi * (frequency - self.start_hz) / rate
        else:
            slope = (self.stop_hz - self.start_hz) / self.duration_s
            frequency = self.start_hz + slope * t
            phase = 2 * math.pi * (self.start_hz + slope * t / 2) * t
        envelope, change = self.amplitude, 0.0
        for since, sign in ((t, 1.0), (self.duration_s - t, -1.0)):
            if since < self.taper_s:
                angle = math.pi * since / self.taper_s
                change = sign * self.amplitude * 0.5 * math.sin(angle) * math.pi / self.taper_s
                envelope *= 0.5 - 0.5 * math.cos(angle)
        sine = math.sin(phase)
        return envelope * sine, change * sine + envelope * 2 * math.pi * frequency * math.cos(phase)


def filtered(values: Float, interval_s: float, response: Any, *, padding: int = 3) -> Float:
    """Output of a linear system of known response for an input at rest before and after: transform with zero padding."""
    n = values.size
    size = 1 << int(np.ceil(np.log2((1 + padding) * n)))
    spectrum = np.fft.rfft(values - values[0], size)
    frequency = np.fft.rfftfreq(size, interval_s)
    return np.fft.irfft(spectrum * response(frequency), size)[:n]


def recording(
    channels: dict[str, Float],
    rate_hz: float,
    *,
    rig: RigConstants | None = None,
    protocol: str = "chirp",
    loading: str = "mechanical",
    details: dict[str, dict[str, Any]] | None = None,
    **metadata: Any,
) -> Recording:
    """Recording of channels that share a clock; `details` adds fields or other times to single channels."""
    parsed = RecordingMetadata.parse(
        {
            "recording_id": "run-1",
            "protocol": protocol,
            "loading": loading,
            "specimen_id": "film-1",
            "started_at": "2026-03-01T10:00:00Z",
            **metadata,
        }
    )
    made = {}
    for quantity, values in channels.items():
        more = dict((details or {}).get(quantity, {}))
        time = more.pop("time_ns", START_NS + np.rint(np.arange(values.size) * 1e9 / rate_hz).astype(np.int64))
        made[quantity] = Channel(quantity, time, values, **more)
    return Recording(parsed, rig or RigConstants(), made)


def schroeder(lines: NDArray[np.int64], samples: int) -> Float:
    """One period of Σ cos(2πlt + φ_k), φ_k = −πk(k−1)/N, largest |value| 1; summed term by term."""
    t = np.arange(samples) / samples
    u = np.zeros(samples)
    for k, line in enumerate(lines, start=1):
        u += np.cos(2 * np.pi * line * t - np.pi * k * (k - 1) / lines.size)
    return u / np.abs(u).max()
