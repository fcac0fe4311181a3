"""What mechanisms may change in a simulation, stage by stage, and how changes compose.

An `Effect` holds functions for the stages; two effects are one with both functions, in the order of composition. Belongs
here: the stages' inputs and outputs. The equations stand with the mechanisms, the simulation in `predict`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from pipeline.physics.rig import Rig
from schemas.arrays import Complex, Float, Int


@dataclass(frozen=True)
class Scale:
    """What the whole session has: largest strain amplitude, largest voltage kV, exposure kV² s, duration s, length mm, mechanical
    cycles, and their sum with the strain amplitude of each; largest rate of the force of a driven sinusoid N/s, 0 without any."""

    strain: float
    voltage_kv: float
    exposure_kv2_s: float
    duration_s: float
    length_mm: float
    cycles: float = 0.0
    path: float = 0.0
    force_rate_n_per_s: float = 0.0

    @property
    def largest_strain(self) -> float:
        """What strains are compared to; without bound where nothing moves the film, so that none is large."""
        return self.strain if self.strain > 0 else float("inf")


@dataclass(frozen=True, eq=False)
class View:
    """States (a sweep, a group of cycles, ...) by frequencies; arrays broadcast to (S, J).

    Parameters
    ----------
    frequency_hz : (1 or S, J)
    strain : amplitude of the driven end over the length at that frequency
    largest_strain, strain_before : largest strain amplitude up to and with this recording, and before it
    cycle : number of the cycle, sweep or period within the recording, from 1; `elapsed`: mechanical cycles since its start
    recording_s, session_s : time since the start of the recording and of the session
    voltage_kv : largest voltage of the state; `exposure_kv2_s`: ∫V²dt until then, over the session;
        `exposure_start_kv2_s`: until the recording began
    temperature_k : measured temperature less that of the first recording with one, NaN where not recorded;
        `first_temperature_s`: session's time when that began, NaN where none has one
    rest_force_n : tension before the recording, NaN where not known
    cycles_before, path_before : mechanical cycles of the recordings before this one, and their sum with the strain amplitude of each
    k0 : N/mm, main spring of the plain film, (B, 1, 1) of several at once
    shifted : stiffness of the plain film with all relaxation times multiplied by e^x over that without, (1 or S, J); x broadcasts to that
    test : `sweep`, `cyclic`, `ramp`, `step` (of voltage) or `multisine`
    few : whether the frequencies are few nodes, which carry a resonance about as wide as one that is known and no narrower one
    """

    frequency_hz: Float
    strain: Float
    largest_strain: Float
    strain_before: Float
    cycle: Float
    elapsed: Float
    recording_s: Float
    session_s: Float
    voltage_kv: Float
    exposure_kv2_s: Float
    exposure_start_kv2_s: Float
    temperature_k: Float
    first_temperature_s: Float
    rest_force_n: Float
    scale: Scale
    test: str
    cycles_before: float | Float = 0.0
    path_before: float | Float = 0.0
    k0: float | Float = 1.0
    shifted: Callable[[Float], Complex] | None = None
    few: bool = False

    def overtones(self) -> tuple[View, View, View]:
        """The view, and that at the multiples 2 and 3 of its frequencies, where harmonics are."""
        second, third = (replace(self, frequency_hz=self.frequency_hz * order) for order in (2, 3))
        return self, second, third

    def power_of_jw(self, exponent: float, *, tau: float = 1.0, lowest_hz: float) -> Complex:
        """(jωτ)^exponent, (1 or S, J), at `lowest_hz` below that: its angle is the same at all frequencies."""
        size = (2 * np.pi * tau * np.maximum(self.frequency_hz, lowest_hz)) ** exponent
        return np.asarray(size * np.exp(0.5j * np.pi * exponent))

    def at(self, index: Int) -> View:
        """The view at some frequencies (places on the last axis)."""
        return replace(
            self,
            frequency_hz=self.frequency_hz[:, index],
            strain=self.strain[:, index] if self.strain.shape[1] > 1 else self.strain,
            elapsed=self.elapsed[:, index] if self.elapsed.shape[1] > 1 else self.elapsed,
        )


Factor = Callable[[View], Complex | Float | float]
"""What an effect multiplies a channel's spectrum with, broadcasts to (S, J)."""


Edge = Callable[[View, float], Complex | Float | float]
"""The same after edges of voltage steps: side 1 after the voltage was put on, −1 after it was taken off."""


@dataclass(frozen=True)
class Cracks:
    """Cracks of an electrode that open as a power of the strain; `share` of the capacitance is lost at the session's largest one."""

    share: Factor
    power: float


@dataclass(frozen=True)
class Film:
    """Dynamic stiffness k N/mm and the share of the actuation force that reaches the ends, both (1 or S, J)."""

    k: Complex
    share: Complex | float = 1.0


@dataclass(frozen=True)
class Wave:
    """Voltage over time, (S, W): `film_kv`, and what acts on the film in place of its square, `squared`.

    One period with samples `interval_s` apart, or levels that last (plateaus of steps), where that is None.
    """

    film_kv: Float
    squared: Float
    interval_s: float | None
    scale: Scale


@dataclass(frozen=True)
class Course:
    """Strain and tension over time, (..., P); along one period where `periodic`, else a course from rest.

    `strain` of the film (positive: longer) and `tension` N as the linear film has it, both against rest. `rest_force_n` is the
    tension at rest (NaN unknown); `largest_tension_n` and `largest_fall_n` are the largest rise and the largest fall of the
    tension in the session as the linear film has it. `stiffness` k N/mm at the frequency (real: secant of a course), broadcasts against the waves;
    `static` k0. `interval_s` is the time from one point to the next, (..., 1) or (..., P). A period is the mean of those from
    `cycles[0]` to `cycles[1]` since the film was at rest, (...) each; where that is None, of a later one. `carry`: see `carried`.
    """

    strain: Float
    tension: Float
    periodic: bool
    rest_force_n: Float
    largest_tension_n: float
    largest_fall_n: float
    stiffness: Complex
    static: float
    interval_s: Float
    scale: Scale
    cycles: tuple[Float, Float] | None = None
    carry: Callable[[Float], Float] | None = None

    def carried(self, strain: Float) -> Float:
        """Tension N of the linear film under a change of its strain along the course: as it relaxes where that is known."""
        if self.carry is not None:
            return self.carry(strain)
        return np.asarray(strain * self.scale.length_mm * np.abs(self.stiffness))


@dataclass(frozen=True)
class Reading:
    """Force of the load cell over time, (..., P), total; `rest_n`: before the test, of any shape that broadcasts to that; `largest_n`: the
    largest of the session without mechanisms."""

    force: Float
    rest_n: float | Float
    largest_n: float


@dataclass(frozen=True)
class BySize:
    """An element that begins at a tension: of a wave that is no sinusoid, as of a film that rings on, the size of the tension counts
    and not that of the strain."""

    element: Callable[[Course], Float]

    def __call__(self, course: Course) -> Float:
        return self.element(course)


@dataclass(frozen=True)
class Effect:
    """Functions that a mechanism adds to the stages, in the order of the stages.

    film_voltage : voltage on the film from the voltage measured (waveforms and levels); film_edges: the same for the square of
        the voltage after the edges of steps
    monitor, monitor_wave, monitor_edges : voltage measured from the voltage asked for: as a factor (steps), of waveforms, after
        edges
    squared : what acts in place of the square of the voltage
    actuation, electrode : factors of the actuation force; those of the electrode act on the capacitance as well
    opening : what is lost of the capacitance where cracks of the electrode open with the strain
    film : stiffness and the share of the actuation force that reaches the ends
    tension : tension of the film over time, of a sinusoid or along a course
    rig, clamp : constants, and the clamp's dynamic stiffness over kL, given the film's stiffness on it
    clamp_third : third harmonic that a force on the clamp makes in the load cell, N, (S, J) with phases against the driven end, given
        the film's stiffness at the frequency and at three times that
    force, displacement, voltage, capacitance : factors of the channels
    reading : force of the load cell over time
    picked_up : force N, (S, W) as the wave, that its channel picks up from the voltage, past film and rig
    drift : force added at times since the start of recording and session (q,) s, given the rest force
    hum_n : lines of the mains: frequency Hz and amplitude N
    """

    film_voltage: tuple[Callable[[Wave], Wave], ...] = ()
    film_edges: tuple[Edge, ...] = ()
    monitor: tuple[Factor, ...] = ()
    monitor_wave: tuple[Callable[[Wave], Wave], ...] = ()
    monitor_edges: tuple[Edge, ...] = ()
    squared: tuple[Callable[[Wave], Wave], ...] = ()
    actuation: tuple[Factor, ...] = ()
    film: tuple[Callable[[Film, View], Film], ...] = ()
    tension: tuple[Callable[[Course], Float], ...] = ()
    rig: tuple[Callable[[Rig], Rig], ...] = ()
    clamp: tuple[Callable[[Complex, Rig, View, Complex], Complex], ...] = ()
    clamp_third: tuple[Callable[[Rig, View, Complex, Complex], Complex], ...] = ()
    force: tuple[Factor, ...] = ()
    displacement: tuple[Factor, ...] = ()
    voltage: tuple[Factor, ...] = ()
    capacitance: tuple[Factor, ...] = ()
    electrode: tuple[Factor, ...] = ()
    opening: tuple[Cracks, ...] = ()
    reading: tuple[Callable[[Reading], Float], ...] = ()
    picked_up: tuple[Callable[[Wave], Float], ...] = ()
    drift: tuple[Callable[[Float, Float, float], Float], ...] = ()
    hum_n: tuple[tuple[float, float], ...] = ()

    @property
    def of_spectra(self) -> bool:
        """Whether it acts on spectra, or on the voltage, alone: several films and rigs can be simulated at once under it."""
        return not (self.tension or self.reading or self.opening or self.monitor_wave)

    def __or__(self, other: Effect) -> Effect:
        return Effect(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(Effect)})


NONE = Effect()


def bent(
    wave: Float, rest_n: float | Float, largest_n: float, readings: tuple[Callable[[Reading], Float], ...]
) -> Float:
    """What readings add to a force over time (..., P), total, N; `rest_n` before the test."""
    seen = wave
    for reading in readings:
        seen = reading(Reading(seen, rest_n, largest_n))
    return np.asarray(seen - wave)
