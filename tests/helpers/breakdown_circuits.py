"""Lifetime records as pieces of exponential charge and discharge: nothing that the detector's weights were fitted on.

A supply and a film with known instants: switch-on ramps, self-healing discharges, dips and slow sags of the supply, lost
samples, noise, and one ending: breakdown, end of test, switch-off by the operator, end of the record, a gap, a raised
voltage. Each record can be judged with its command and, as a second record, without it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

Float = NDArray[np.float64]
EPOCH_NS = 1_772_000_000_000_000_000
ENDINGS = {
    "breakdown": 0.4,
    "end of test": 0.15,
    "operator": 0.15,
    "record ends": 0.1,
    "gap": 0.1,
    "raised": 0.1,
}


@dataclass
class Circuit:
    """Voltage as pieces v∞ + (v0 − v∞) e^{−(t − t0)/τ} (or straight lines), built from left to right."""

    pieces: list[tuple[float, float, float, float]] = field(default_factory=list)
    """(t0, v0, v∞ or slope, τ; τ = 0 marks a straight line)."""

    def at(self, t: float) -> float:
        return float(self.sample(np.array([t]))[0])

    def relax(self, t: float, towards: float, tau: float) -> None:
        self.pieces.append((t, self.at(t) if self.pieces else 0.0, towards, tau))

    def ramp(self, t: float, to: float, seconds: float) -> None:
        start = self.at(t) if self.pieces else 0.0
        self.pieces.append((t, start, (to - start) / seconds, 0.0))
        self.pieces.append((t + seconds, to, to, 1.0))

    def sample(self, t: Float) -> Float:
        v = np.zeros_like(t)
        for t0, v0, goal, tau in self.pieces:
            now = t >= t0
            s = t[now] - t0
            v[now] = v0 + goal * s if tau == 0 else goal + (v0 - goal) * np.exp(-s / tau)
        return v


@dataclass(frozen=True)
class Truth:
    """What really happened, times in s since the first sample."""

    ending: str
    failed: bool
    start_s: float
    end_s: float
    glitches: int
    interval: float
    slow_start: bool


@dataclass(frozen=True)
class Case:
    recording: Recording
    truth: Truth


def simulate(rng: np.random.Generator, number: int) -> Case:
    """One record with all its channels, the command among them."""
    rate = float(rng.choice([100.0, 250.0, 500.0, 1000.0, 2000.0]))
    dt, kv = 1 / rate, float(np.round(rng.uniform(3, 9), 1))
    circuit, command, leaks = Circuit(), [(0.0, 0.0)], []
    applied = float(rng.uniform(0.3, 2.0))
    duration = float(np.round(rng.uniform(8, 25), 1))
    command.append((applied, kv / 1.5))
    slow_start = bool(rng.random() < 0.4)
    if slow_start:
        seconds = float(rng.uniform(0.1, 3.0))
        circuit.ramp(applied, kv, seconds)
        start, settled = applied + 0.95 * seconds, applied + seconds
    else:
        tau = float(rng.uniform(2e-3, 40e-3))
        circuit.relax(applied, kv, tau)
        start, settled = applied - tau * np.log(0.05), applied + 8 * tau
    ending = str(rng.choice(list(ENDINGS), p=list(ENDINGS.values())))
    planned = start + duration
    free_end = float(rng.uniform(settled + 2.0, planned - 1.0))
    end = planned if ending in ("end of test", "raised") else free_end
    glitches, level = _life(rng, circuit, leaks, settled + 0.6, end - 1.2, kv)
    circuit_end, failed, stop, cut = _ending(rng, ending, circuit, command, leaks, end, level)
    if failed and ending == "breakdown":
        end = circuit_end
    t = np.arange(0.0, stop, dt)
    if ending == "gap":
        t = t[(t <= cut) | (t > cut + rng.uniform(0.6, 3.0))]
    clean = circuit.sample(t)
    values = clean + rng.normal(0, kv * rng.uniform(5e-4, 1e-2), t.size)
    values = np.round(values / (15 / 2**15)) * (15 / 2**15)
    _lose_samples(rng, t, values, clean, kv, end, settled)
    channels = {"voltage": _channel("voltage", t, values)}
    commanded = np.zeros_like(t)
    for begin, volts in command:
        commanded[t >= begin] = volts
    channels["command"] = _channel("command", t, commanded)
    if rng.random() < 0.3:
        current = 0.2 + rng.normal(0, 0.02, t.size)
        for begin, seconds in leaks:
            current[(t >= begin) & (t < begin + seconds)] += 20.0
        channels["leakage_current"] = _channel("leakage_current", t, current)
    if rng.random() < 0.5:
        force = 1.0 - 0.005 * clean**2 + rng.normal(0, 2e-3, t.size)
        channels["force"] = _channel("force", t, force)
    site = str(rng.choice(["rod", "lead"])) if failed else "none"
    site = site if rng.random() < 0.4 else "unknown"
    metadata = RecordingMetadata(
        recording_id=f"study-{number}",
        protocol="lifetime",
        loading="electrical",
        specimen_id=f"S{number}",
        started_at=datetime(2026, 3, 1, tzinfo=UTC),
        voltage_setpoint_kv=kv,
        test_duration_s=duration,
        failure_site=site,
    )
    if ending == "gap":
        end = float(t[t <= cut][-1])
    elif ending == "record ends":
        end = float(t[-1])
    truth = Truth(ending, failed and ending == "breakdown", start, end, glitches, dt, slow_start)
    return Case(Recording(metadata, RigConstants(), channels), truth)


def _life(
    rng: np.random.Generator, circuit: Circuit, leaks: list[tuple[float, float]], begin: float, end: float, kv: float
) -> tuple[int, float]:
    """Events between switch-on and the ending; number of glitches and the level at the end."""
    t, glitches, level = begin, 0, kv
    while True:
        t += float(rng.exponential(3.0))
        if t > end - 3.5:
            return glitches, level
        event = rng.choice(["glitch", "dip", "deep dip", "sag", "nothing"], p=[0.35, 0.2, 0.15, 0.15, 0.15])
        if event == "glitch":  # a discharge that heals: fast to nearly nothing, back with the supply's time constant
            held, recharge = float(rng.uniform(0.01, 0.2)), float(rng.uniform(5e-3, 60e-3))
            circuit.relax(t, level * float(rng.uniform(0.0, 0.3)), float(rng.uniform(5e-5, 1e-3)))
            circuit.relax(t + held, level, recharge)
            leaks.append((t, held))
            glitches += 1
            t += held + 8 * recharge + 0.2
        elif event == "dip":  # the supply sags and recovers, never below half
            held = float(rng.uniform(0.05, 2.0))
            circuit.relax(t, level * float(rng.uniform(0.56, 0.85)), float(rng.uniform(2e-3, 0.1)))
            circuit.relax(t + held, level, float(rng.uniform(5e-3, 0.1)))
            t += held + 1.0
        elif event == "deep dip":  # below half, but slowly: the supply's capacitor, no spark
            held = float(rng.uniform(0.3, 1.5))
            circuit.relax(t, level * float(rng.uniform(0.1, 0.4)), float(rng.uniform(0.12, 0.4)))
            circuit.relax(t + held, level, float(rng.uniform(10e-3, 60e-3)))
            t += held + 1.0
        elif event == "sag":
            lower = level * float(rng.uniform(0.93, 0.98))
            seconds = float(rng.uniform(1.0, 2.5))
            circuit.ramp(t, lower, seconds)
            if rng.random() < 0.5:
                circuit.relax(t + seconds, level, 0.05)
            else:
                level = lower
            t += seconds + 0.5


def _ending(
    rng: np.random.Generator,
    ending: str,
    circuit: Circuit,
    command: list[tuple[float, float]],
    leaks: list[tuple[float, float]],
    end: float,
    level: float,
) -> tuple[float, bool, float, float]:
    """(instant, breakdown, last time recorded, last time before a gap)."""
    if ending in ("end of test", "operator"):
        command.append((end, 0.0))
        circuit.relax(end, 0.0, float(rng.uniform(1.6e-3, 33e-3)))
        return end, False, end + float(rng.uniform(0.0, 3.0)), end
    if ending == "record ends":
        return end, False, end, end
    if ending == "raised":
        seconds = float(rng.uniform(2.0, 8.0))
        command.append((end, 1.3 * level / 1.5))
        circuit.ramp(end, 1.3 * level, seconds)
        end += seconds * float(rng.uniform(0.7, 1.0))
    if ending == "gap" and rng.random() < 0.5:
        return end, False, end + 6.0, end  # the test goes on after the gap
    begin = end if ending != "gap" else end + 2.0
    residual = level * float(rng.choice([0.0, rng.uniform(0.03, 0.3)]))
    circuit.relax(begin, residual, float(10 ** rng.uniform(-4.3, -2.7)))
    stop = begin + float(rng.uniform(0.4, 3.0))
    if rng.random() < 0.3:  # the supply tries again and again
        for retry in np.arange(begin + 0.15, stop, 0.25):
            circuit.relax(float(retry), 0.7 * level, 8e-3)
            circuit.relax(float(retry) + 0.01, residual, 1e-3)
    leaks.append((begin, stop - begin + 1))
    if rng.random() < 0.6:  # the interlock, or the operator
        command.append((begin + float(rng.uniform(0.06, 2.0)), 0.0))
    return begin, True, stop, end


def _lose_samples(
    rng: np.random.Generator, t: Float, values: Float, clean: Float, kv: float, end: float, settled: float
) -> None:
    """Single samples of the monitor that are not there, or read zero, while the voltage is up."""
    steady = (clean > 0.92 * kv) & (t > settled + 0.5) & (t < end - 0.5)
    steady[1:-1] &= steady[:-2] & steady[2:]
    rows = np.flatnonzero(steady)
    for row in rng.choice(rows, size=min(rng.poisson(1.0), rows.size), replace=False) if rows.size else ():
        if np.all(np.isfinite(values[row - 2 : row + 3])) and np.all(values[row - 2 : row + 3] > 0.9 * kv):
            values[row] = rng.choice([np.nan, 0.0])


def _channel(quantity: str, t: Float, values: Float) -> Channel:
    return Channel(quantity, EPOCH_NS + np.round(t * 1e9).astype(np.int64), values)


def without_command(case: Case) -> Case:
    channels = {name: channel for name, channel in case.recording.channels.items() if name != "command"}
    return replace(case, recording=replace(case.recording, channels=channels))
