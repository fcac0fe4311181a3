"""Capacitance of a sensing region under cyclic strain, cycle by cycle: its wave distorts when the electrode migrates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.transform.harmonics import HARMONICS
from pipeline.transform.sampling import seconds
from schemas.arrays import Complex, Float, Int
from schemas.recording import Recording

FEWEST_CYCLES = 20
"""Cycles from which a change of the wave is looked for."""
_SETTLING_CYCLES = 2


@dataclass(frozen=True)
class CapacitanceCycles:
    """The capacitance of n whole cycles.

    cycle : (n,) number of the cycle, from 1
    mean_pf, amplitude_pf : (n,) mean and amplitude of the fundamental
    harmonics : (n, m) complex, harmonics 2 … m + 1 over the fundamental, phases counted from the fundamental's
    """

    recording_id: str
    specimen_id: str
    frequency_hz: float
    cycle: Int
    mean_pf: Float
    amplitude_pf: Float
    harmonics: Complex

    @property
    def distortion(self) -> Float:
        """(n,) root sum of squares of the harmonics over the fundamental."""
        return np.asarray(np.sqrt(np.sum(np.abs(self.harmonics) ** 2, axis=1)))


def capacitance_cycles(recording: Recording, frequency_hz: float) -> CapacitanceCycles | None:
    """Each cycle of the capacitance; None without that channel, for fewer than 20 cycles or 14 samples to a cycle.

    The cycles begin where the driven end first moves; the first two, in which the film starts, and the last,
    in which it stops, are left out.
    """
    channel = recording.channels.get("capacitance")
    if channel is None:
        return None
    time, values = seconds(channel, recording.start_ns)
    driven = recording.channels.get("displacement") or recording.channels.get("stretch")
    if driven is None or time.size < 16:
        return None
    moved_at, moved = seconds(driven, recording.start_ns)
    moving = np.flatnonzero(np.abs(moved - moved[0]) > 0.02 * float(np.ptp(moved)))
    if not moving.size:
        return None
    begin = float(moved_at[moving[0]])
    seen = (min(float(time[-1]), float(moved_at[moving[-1]])) - begin) * frequency_hz
    # A cycle that begins and ends at its lowest point is hardly seen to move there.
    whole = int(seen + 0.15)
    begin -= max(whole - seen, 0.0) / 2 / frequency_hz
    if whole < FEWEST_CYCLES:
        return None
    rows = [
        row
        for cycle in range(_SETTLING_CYCLES, whole - 1)
        if (row := _cycle(cycle + 1, time, values, frequency_hz, begin + cycle / frequency_hz)) is not None
    ]
    if len(rows) < FEWEST_CYCLES:
        return None
    amplitude = np.array([row.amplitude for row in rows])
    size, turn = np.abs(amplitude[:, :1]), np.exp(-1j * np.angle(amplitude[:, :1]))
    return CapacitanceCycles(
        recording.metadata.recording_id,
        recording.metadata.specimen_id,
        frequency_hz,
        np.array([row.number for row in rows], dtype=np.int64),
        np.array([row.mean for row in rows]),
        size[:, 0],
        amplitude[:, 1:] / size * turn ** np.arange(2, HARMONICS + 1),
    )


@dataclass(frozen=True)
class _Cycle:
    """Harmonics 1 … 5 of one cycle, phasors e^{+jωt} at the record's beginning."""

    number: int
    mean: float
    amplitude: Complex


def _cycle(number: int, time: Float, values: Float, frequency: float, first: float) -> _Cycle | None:
    """Least squares on level, slope and five harmonics; None with too few samples or no fundamental."""
    low, high = np.searchsorted(time, [first, first + 1 / frequency])
    t, v = time[low:high], values[low:high]
    if t.size < 2 * HARMONICS + 4:
        return None
    wave = np.exp(2j * np.pi * frequency * t)[:, None] ** np.arange(1, HARMONICS + 1)
    design = np.column_stack([np.ones_like(t), (t - t.mean()) * frequency, wave.real, wave.imag])
    solution, *_ = np.linalg.lstsq(design, v, rcond=None)
    amplitude = solution[2 : 2 + HARMONICS] - 1j * solution[2 + HARMONICS :]
    if abs(amplitude[0]) == 0:
        return None
    return _Cycle(number, float(solution[0]), amplitude)
