"""What a course of the voltage does to the force: of one period, line by line, with the effects that act on the voltage over time.

    H = g a/(1 + (−Mω² + jωcL)/kL + k/kL),      ΔC/V² = −κ (k0/k)^e (1 + (−Mω² + jωcL)/kL) H

The sensing part in series carries the film's tension, so that its strain is tension over k, with e = 1 where it is of the same material
and electrodes do not hinder it; κ is pF/N at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.diagnose.simulation.describing import SLOPES, Loads, along
from pipeline.diagnose.simulation.effects import Course, Effect, View, Wave, bent
from pipeline.diagnose.simulation.families import channel, dynamic, film_at, rig_of
from pipeline.diagnose.simulation.parameters import STRAIN, STRESS, Physical, Several
from pipeline.physics.rig import Rig
from schemas.arrays import Complex, Float

ROUNDS, SETTLED = 8, 1e-3
"""Rounds in which tension and clamp come into balance, at most; relative change of the tension that is none."""
FORCE, CAPACITANCE, VOLTAGE = "force", "capacitance", "voltage"


def electrical_response(
    physical: Physical | Several, effect: Effect, rig_number: int, view: View, output: str
) -> Complex:
    """H, ΔC/V² or V/command at the frequencies of a view, (1 or S, J); the square of the voltage is that measured. Of several at once
    (B, 1 or S, J)."""
    if output == VOLTAGE:
        gain = physical.amplifier[rig_number] * np.ones((1, view.frequency_hz.shape[1]), dtype=complex)
        return np.asarray(gain * channel(effect.monitor, view) * channel(effect.voltage, view))
    rig = rig_of(physical, rig_number, effect)
    film = film_at(physical, effect, view)
    own = dynamic(rig, view, effect, film.k)
    drive = physical.actuation * film.share * channel(effect.actuation, view) / channel(effect.voltage, view) ** 2
    drive = drive * channel(effect.electrode, view)
    response = drive / rig.loaded(film.k, own)
    if output == FORCE:
        return np.asarray(rig.gain * response * channel(effect.force, view))
    sensed = -physical.pf_per_n * follow_voltage(physical, film.k, own * response, np.asarray(drive, dtype=complex))
    return np.asarray(sensed * channel(effect.capacitance, view) * channel(effect.electrode, view))


def follow_voltage(physical: Physical | Several, k: Complex, tension: Complex, stress: Complex | float) -> Complex:
    """What the sensing region follows, as the tension at rest would be: N/kV², shape of the film's stiffness `k` N/mm.

    Parameters
    ----------
    tension, stress : of the film and of the voltage, over the square of the voltage, N/kV²
    """
    if physical.sensing == STRESS:
        return np.asarray(stress * np.ones_like(k))
    return np.asarray(tension * physical.k0 / k if physical.sensing == STRAIN else tension)


def squared(effect: Effect, wave: Wave) -> Float:
    """What acts on the film in place of the square of the measured voltage, (S, W)."""
    for change in effect.film_voltage:
        wave = change(wave)
    wave = replace(wave, squared=wave.film_kv**2)
    for change in effect.squared:
        wave = change(wave)
    return wave.squared


def pick_up(effect: Effect, wave: Wave) -> Float:
    """Force N that the channel picks up from the measured voltage, (S, W)."""
    return np.asarray(sum((add(wave) for add in effect.picked_up), np.zeros_like(wave.film_kv)))


@dataclass(frozen=True, eq=False)
class VoltageWaves:
    """Periods of the voltage (S, W) in kV, as they were measured, at one rig.

    Parameters
    ----------
    kv : (S, W)
    interval_s : from one sample to the next, s
    rig : number of the rig
    view : of the states (S,), at the frequencies of all lines 0 … W/2 − 1
    """

    kv: Float
    interval_s: float
    rig: int
    view: View

    @classmethod
    def of_period(cls, kv: Float, period_s: float, rig: int, view: View) -> VoltageWaves:
        """From a view at any frequencies: what it says of the states."""
        every = np.arange(kv.shape[1] // 2) / period_s
        return cls(kv, period_s / kv.shape[1], rig, replace(view, frequency_hz=every[None, :]))

    @cached_property
    def measured(self) -> Complex:
        """(S, L) lines of the square of the voltage."""
        return find_lines(self.kv**2)

    def find_acting(self, effect: Effect) -> Complex:
        """(S, L) lines of what acts on the film in place of the square of the measured voltage."""
        return find_lines(squared(effect, self._wave)) if acts_on_voltage(effect) else self.measured

    def pick_up(self, effect: Effect) -> Complex | None:
        """(S, L) lines of what the force's channel picks up from the voltage, as it adds to −F; None: nothing."""
        return -find_lines(pick_up(effect, self._wave)) if effect.picked_up else None

    @property
    def _wave(self) -> Wave:
        return Wave(self.kv, self.kv**2, self.interval_s, self.view.scale)

    def bend(self, physical: Physical, effect: Effect, loads: Loads, acting: Complex) -> Complex:
        """What elements and readings add to −F, at all lines (S, L), with the clamp in balance with them."""
        count, view = acting.shape[1], self.view
        rig = rig_of(physical, self.rig, effect)
        film = film_at(physical, effect, view)
        own = dynamic(rig, view, effect, film.k)
        pulled = physical.actuation * film.share * channel(effect.actuation, view) * acting
        passed = rig.electrical(film.k, own)
        force = -passed * pulled
        rest = np.nan_to_num(self.view.rest_force_n)
        total = np.zeros((len(self.kv), count), dtype=complex)
        if effect.tension:
            total = total - passed * self._balance(physical, effect, loads, rig, film.k, own, pulled)
        if effect.reading:
            plain = rest + make_wave(force - total, self.kv.shape[1])
            total = total - find_lines(bent(plain, rest, loads.reading_n, effect.reading))
        return total

    def _balance(
        self,
        physical: Physical,
        effect: Effect,
        loads: Loads,
        rig: Rig,
        k: Complex,
        own: Complex,
        pulled: Complex,
    ) -> Complex:
        """(S, L) lines of what elements add to the tension T that the film has once the clamp has given way to all of it.

            T = −F_A − k x,   x = (T + d(T))/(kL own)

        Rounds of substitution with the mean slope s of T + d(T) taken out of d, which leaves of it what is less than the slope:
        they converge at a clamp's resonance as well.
        """
        give, samples = k * rig.compliance, self.kv.shape[1]
        tension = -own * pulled / (own + give)
        added = np.zeros_like(tension)
        for _ in range(ROUNDS):
            moved = (pulled - added) / (own + give) * rig.compliance / self.view.scale.length_mm
            course = Course(
                make_wave(moved, samples),
                make_wave(tension, samples),
                True,
                self.view.rest_force_n,
                loads.tension_n,
                loads.fall_n,
                np.array([[physical.film.k0]], dtype=complex),
                physical.film.k0,
                np.array([[self.interval_s]]),
                self.view.scale,
            )
            extra = along(effect.tension, course)
            added = find_lines(extra)
            slope = measure_slope(course.tension, extra)
            new = (-own * pulled - give * (added - (slope - 1) * tension)) / (own + slope * give)
            change, size = np.abs(new - tension).max(), np.abs(tension).max()
            tension = new
            if not change > SETTLED * size:
                break
        return added


def measure_slope(tension: Float, extra: Float) -> Float:
    """(S, 1) slope of all tension over the linear one along waves (S, W)."""
    about = tension - tension.mean(axis=1, keepdims=True)
    power = np.sum(about**2, axis=1, keepdims=True)
    slope = 1 + np.sum(about * extra, axis=1, keepdims=True) / np.maximum(power, 1e-300)
    return np.asarray(np.clip(slope, *SLOPES))


def acts_on_voltage(effect: Effect) -> bool:
    """Whether another voltage, or not its square, acts on the film."""
    return bool(effect.film_voltage or effect.squared)


def find_lines(wave: Float) -> Complex:
    """Amplitudes of the lines 0 … W/2 − 1 of one period (S, W)."""
    spectrum = np.fft.rfft(wave, axis=1)[:, : wave.shape[1] // 2] * (2 / wave.shape[1])
    spectrum[:, 0] /= 2
    return np.asarray(spectrum)


def make_wave(lines: Complex, samples: int) -> Float:
    """One period (S, samples) of lines 0 … L − 1 (S, L)."""
    spectrum = lines * (samples / 2)
    spectrum[:, 0] *= 2
    return np.fft.irfft(spectrum, n=samples, axis=1)
