"""Amplitude-dependent films under a sinusoid: describing functions at the film's own strain, solved with the rig.

The fundamental of the tension scales k exactly within the response; the amplitude of the strain x0 − x′ follows from that
response, so that both are found together. Mean and harmonics of the tension move the clamp, and with it the film (harmonic
balance with four terms).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.diagnose.simulation.effects import Course, Scale
from pipeline.physics.rig import Rig
from schemas.arrays import Complex, Float, Int

PHASES = 32
"""Phases of a period."""
_ITERATIONS = 12
"""Rounds in which the strain of the film is found, at most."""
_SETTLED = 1e-4
"""Relative change of it that is none."""
_LOOPS = 2
"""Rounds in which a waveform is found with its harmonics."""
SLOPES = 0.05, 1.5
"""Least and largest slope of a tension over the linear one by which its waveform is corrected."""
_GRID = np.array([
    0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.68, 0.75, 0.81, 0.86, 0.9, 0.93, 0.96, 0.98, 1.0, 1.02, 1.05, 1.1, 1.2, 1.35, 1.6, 2.2, 3.2,
])  # fmt: skip
"""Amplitudes of the grid over the largest that the linear film has at a frequency, dense where a weak onset lies; whole hundredths."""
_CELLS = 100
"""Cells of a look-up in the grid, per unit of the amplitude."""
_ROW = np.clip(np.searchsorted(_GRID, (np.arange(int(_GRID[-1] * _CELLS) + 1) + 0.5) / _CELLS) - 1, 0, _GRID.size - 2)
"""Number of the grid's amplitude below each hundredth."""
_GAP = np.diff(_GRID)
_ANGLE = 2 * np.pi * np.arange(PHASES) / PHASES
"""The phases, rad."""
_WAVES = (
    np.exp(1j * np.outer(np.arange(4), _ANGLE))
    .conj()
    .view(np.float64)
    .reshape(4, PHASES, 2)
    .transpose(0, 2, 1)
    .reshape(8, PHASES)
)
"""Re and Im of c_m, one below the other, make Σ Re c_m e^{jmθ} of this: real products cost a quarter of complex ones."""
_TURNS = np.exp(-1j * np.outer(_ANGLE, np.arange(4))) * 2 / PHASES
"""Takes harmonics 0 to 3 of a period."""
_TURNS[:, 0] /= 2


@dataclass(frozen=True)
class Described:
    """(S, J) each: `factor` of k, mean tension N, second and third harmonic of the tension N (phase: strain is a cosine),
    strain amplitude, and `turn` = strain over x0 (complex, times the length)."""

    factor: Complex
    mean: Float
    second: Complex
    third: Complex
    strain: Float
    turn: Complex


@dataclass(frozen=True)
class Loads:
    """Largest rise and fall of the tension, N, and largest force reading of a session, N."""

    tension_n: float
    fall_n: float
    reading_n: float


def harmonics(wave: Float) -> Complex:
    """(..., 4) mean and harmonics 1 … 3 of a wave (..., PHASES): Σ Re c_m e^{jmθ}."""
    return _flat(np.asarray(wave, dtype=np.float64), _TURNS.view(np.float64)).view(np.complex128)


@dataclass(frozen=True)
class Loop:
    """What closes the loop about the elements at harmonics 0 … 3 of the drive: film and rig, linear.

    frequency_hz (S, J) of the drive, `cycles` (S, J) each as in `Course`; k (4, S, J) N/mm of the linear film (at 0 the main
    spring), `dynamic` (4, S, J) = 1 + (−Mω² + jωcL)/kL of the clamp, `rig` (1, 1).
    """

    frequency_hz: Float
    k: Complex
    dynamic: Complex
    rig: Rig
    cycles: tuple[Float, Float] | None = None

    def mean(self) -> Loop:
        """One for all states."""
        k, dynamic = self.k.mean(axis=1, keepdims=True), self.dynamic.mean(axis=1, keepdims=True)
        return Loop(self.frequency_hz[:1], k, dynamic, self.rig)


def describe(
    elements: Sequence[Callable[[Course], Float]],
    loop: Loop,
    strain: Float,
    mean_strain: Float,
    rest_force_n: Float,
    loads: Loads,
    scale: Scale,
) -> Described:
    """Describing functions of `elements` for a driven end of strain amplitude `strain` (S, J).

    The mean tension that the elements find beyond what the scaled k0 carries is `mean`.
    """
    k, dynamic = loop.k[1], loop.dynamic[1]
    turn = loop.rig.extension(k, dynamic)
    amplitude = strain * np.abs(turn)
    factor: Complex = np.ones(k.shape, dtype=complex)
    found: Complex = np.zeros((*k.shape, 4), dtype=complex)
    own: Complex | None = None
    for i in range(_ITERATIONS):
        factor, found, own = _one_amplitude(elements, loop, amplitude, mean_strain, rest_force_n, loads, scale, own)
        turn = loop.rig.extension(factor * k, dynamic)
        amplitude, change = _next(amplitude, strain, turn, i)
        if change < _SETTLED:
            break
    return Described(factor, found[..., 0].real, found[..., 2], found[..., 3], amplitude, turn)


@dataclass(frozen=True)
class Places:
    """Places (..., T) among the frequencies of a table: the two columns about each, and how far it is to the second."""

    column: Int
    beside: Int
    share: Float

    @classmethod
    def among(cls, known: Float, wanted: Float) -> Places:
        """Where log frequencies (..., T) lie among those of a table (C,)."""
        along = np.interp(wanted, known, np.arange(known.size, dtype=float))
        column = np.minimum(along.astype(np.int64), max(known.size - 2, 0))
        return cls(column, np.minimum(column + 1, known.size - 1), along - column)

    def rows(self, number: Int) -> Places:
        """Those of some rows."""
        return Places(self.column[number], self.beside[number], self.share[number])

    def interpolated(self, values: Float) -> Float:
        """(..., T) of values (C,) at the frequencies of a table."""
        low = values[self.column]
        return np.asarray(low + self.share * (values[self.beside] - low))


@dataclass(frozen=True)
class SweepTable:
    """What elements make of waves of any amplitude at C frequencies.

    `top` (C,) strain amplitude that the grid is relative to; `values` (grid, C, 5): factor of k, then mean and harmonics 1 … 3 of
    the tension that the elements add, N per unit of strain amplitude. `stiffness` (C,) |k| of the film N/mm.
    """

    top: Float
    values: Complex
    stiffness: Float

    def stiff(self, at: Places) -> Float:
        """(..., T) |k| of the film, N/mm."""
        return at.interpolated(self.stiffness)

    @cached_property
    def _lines(self) -> tuple[tuple[Complex, Complex], tuple[Complex, Complex]]:
        """What factors (grid C,) and waves (grid C, 4), grid by grid, are from each amplitude u of the grid to the next: a + b u."""
        slope = np.diff(self.values, axis=0) / _GAP[:, None, None]
        start = self.values[:-1] - _GRID[:-1, None, None] * slope
        lines = [v.reshape(-1, v.shape[-1]) for v in (start, slope)]
        factors, waves = (tuple(np.ascontiguousarray(v[:, own]) for v in lines) for own in (0, slice(1, None)))
        return (factors[0], factors[1]), (waves[0], waves[1])

    def factor(self, strain: Float, at: Places) -> Complex:
        """(..., T) factor of k at strain amplitudes (..., T)."""
        return self._at(*self._lines[0], strain, at, at.share)

    def waves(self, strain: Float, at: Places) -> Complex:
        """(..., T, 4) mean and harmonics of the tension that the elements add, N, the strain being a cosine."""
        return self._at(*self._lines[1], strain, at, at.share[..., None]) * strain[..., None]

    def _at(self, start: Complex, slope: Complex, strain: Float, at: Places, share: Float) -> Complex:
        # Both columns are asked at the same strain: between them lies a resonance, and what begins at a load is a bend.
        low, high = (self._of_column(start, slope, strain, column) for column in (at.column, at.beside))
        high -= low
        high *= share
        high += low
        return high

    def _of_column(self, start: Complex, slope: Complex, strain: Float, column: Int) -> Complex:
        """(..., T, …) values of columns (..., T) at strain amplitudes (..., T)."""
        up = strain * self._per_top.take(column)
        np.minimum(np.maximum(up, _GRID[0], out=up), _GRID[-1], out=up)
        place = _ROW.take((up * _CELLS).astype(np.int64)) * self.top.size + column
        value: Complex = slope.take(place, axis=0)
        value *= up.reshape(up.shape + (1,) * (start.ndim - 1))
        value += start.take(place, axis=0)
        return value

    @cached_property
    def _per_top(self) -> Float:
        return 1 / self.top


def sweep_table(
    elements: Sequence[Callable[[Course], Float]],
    mean: Loop,
    top: Float,
    rest_force_n: float,
    loads: Loads,
    scale: Scale,
) -> SweepTable:
    """Elements asked on a grid of amplitudes up to and beyond `top` (C,), with `mean` the mean of the states' films and rigs.

    States of sweeps, which have no mean strain, differ in amplitude and little else.
    """
    top = np.maximum(top, 1e-15)
    grid: Float = _GRID[:, None] * top
    rest = np.full(grid.shape, rest_force_n)
    own: Complex | None = None
    for _ in range(_LOOPS):
        factor, waves, own = _one_amplitude(elements, mean, grid, np.zeros(grid.shape), rest, loads, scale, own)
    # A complex division costs more than all the rest of it.
    values = np.concatenate([factor[..., None], waves * (1 / grid)[..., None]], axis=-1)
    return SweepTable(top, values, np.abs(mean.k[1, 0]))


def _next(amplitude: Float, strain: Float, turn: Complex, i: int) -> tuple[Float, float]:
    """The next amplitude, half the way once the first step is made: a lightly damped resonance would overshoot."""
    wanted = strain * np.abs(turn)
    new = 0.5 * (amplitude + wanted) if i else wanted
    return new, float(np.max(np.abs(new - amplitude) / np.maximum(strain, 1e-30), initial=0.0))


def _one_amplitude(
    elements: Sequence[Callable[[Course], Float]],
    loop: Loop,
    amplitude: Float,
    mean_strain: Float,
    rest_force_n: Float,
    loads: Loads,
    scale: Scale,
    own: Complex | None,
) -> tuple[Complex, Complex, Complex]:
    """Factor of k, what the elements add to mean and harmonics 1 … 3 of the tension, at given strain amplitudes.

    `own` (..., 4) is the film's strain as found so far (None: the driven end's mean and the fundamental alone), returned with
    what the clamp does to its mean and overtones: it gives way to the harmonics, and the elements see that.
    """
    k = np.moveaxis(loop.k, 0, -1)
    dynamic = np.moveaxis(loop.dynamic, 0, -1)
    give = np.asarray(loop.rig.compliance)[..., None]
    e = np.zeros((*amplitude.shape, 4), dtype=complex) if own is None else own.copy()
    if own is None:
        e[..., 0] = mean_strain
    e[..., 1] = amplitude
    linear = k * e * scale.length_mm
    course = Course(
        strain=compose_wave(e),
        tension=compose_wave(linear),
        periodic=True,
        rest_force_n=rest_force_n[..., None],
        largest_tension_n=loads.tension_n,
        largest_fall_n=loads.fall_n,
        stiffness=np.broadcast_to(k[..., 1:2], (*amplitude.shape, 1)),
        static=float(loop.k[0].flat[0].real),
        interval_s=np.broadcast_to(1 / (PHASES * loop.frequency_hz[..., None]), (*amplitude.shape, 1)),
        scale=scale,
        cycles=loop.cycles,
        carry=lambda strain: compose_wave(k * harmonics(strain) * scale.length_mm),
    )
    found = harmonics(along(elements, course))
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(np.abs(linear[..., 1]) > 0, 1 + found[..., 1] / linear[..., 1], 1.0)
    # The mean slope of the elements is what the clamp feels at its overtones; the rest of the tension drives it.
    slope = np.clip(factor.real, *SLOPES)[..., None]
    driving = found + (1 - slope) * linear
    driving[..., 0] += (slope[..., 0] - 1) * (k * scale.length_mm)[..., 0] * mean_strain
    moved = -driving * give / (dynamic + slope * k * give) / scale.length_mm
    moved[..., 0] = moved[..., 0].real + mean_strain
    moved[..., 1] = amplitude
    found[..., 0] -= (factor.real - 1) * (k * scale.length_mm)[..., 0].real * mean_strain
    return factor, found, moved


def compose_wave(coefficients: Complex) -> Float:
    """(..., PHASES) wave of mean and harmonics 1 … 3 (..., 4)."""
    return _flat(np.ascontiguousarray(coefficients).view(np.float64), _WAVES)


def _flat(values: Float, matrix: Float) -> Float:
    """(..., m) product of values (..., n) with a matrix (n, m), all rows at once."""
    return (values.reshape(-1, values.shape[-1]) @ matrix).reshape(*values.shape[:-1], matrix.shape[1])


def along(elements: Sequence[Callable[[Course], Float]], course: Course) -> Float:
    """Tension that the elements make of a course, less the linear one, (..., P)."""
    wave = course.tension
    for element in elements:
        wave = element(course if wave is course.tension else replace(course, tension=wave))
    return np.asarray(wave - course.tension)
