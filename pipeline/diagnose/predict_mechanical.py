"""Prediction of sweeps, sinusoids, relaxation and large cycles: G = F/x0 through the operators, and what is not linear.

    G = g k/(1 + (−Mω² + jωcL)/kL + k/kL) × (force channel)/(displacement channel)

Harmonics m of the tension reach the load cell as g T_m/(1 + (−Mω² + jωcL)/kL + k/kL) at m f.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.diagnose.base import Physical
from pipeline.diagnose.describing import (
    COSINE,
    PHASES,
    Described,
    Loads,
    Loop,
    along,
    describe,
    describe_sweeps,
    harmonics,
)
from pipeline.diagnose.effects import NONE, Course, Effect, Reading, Rig, View
from pipeline.diagnose.families import Family, channel, dynamic, film_at, rig_of
from pipeline.diagnose.features import (
    CHIRP_HARMONIC,
    CHIRP_LEVEL,
    CHIRP_RESPONSE,
    CYCLIC_HARMONIC,
    CYCLIC_LEVEL,
    CYCLIC_RESPONSE,
)
from pipeline.diagnose.session import Place, Session

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]
Int = NDArray[np.int64]

SWEEP, CYCLIC, RAMP = "sweep", "cyclic", "ramp"
_COARSE = 24
"""Log-spaced and, beside them, evenly counted nodes of a sweep at which describing functions are computed."""


def _hann(count: int) -> Float:
    """Weights (count,) of the points within a Hann window, evenly spaced and without its ends; one point weighs all."""
    weight = np.sin(np.pi * np.arange(1, count + 1) / (count + 1)) ** 2
    return np.asarray(weight / weight.sum())


@dataclass(frozen=True)
class _Rows:
    """Harmonic features: place among the family's rows of real and imaginary part, state, order, frequencies (h, w)."""

    real: Int
    imaginary: Int
    state: Int
    order: Int
    frequency: Float


@dataclass(frozen=True)
class _Between:
    """Places between neighbours: the left one, and how far it is to the right one."""

    left: Int
    share: Float


@dataclass(frozen=True)
class _Nonlinear:
    """At the coarse frequencies (S, C): factors of k and of the force, harmonics 2 and 3 of the force N, its mean N."""

    stiffness: Complex
    force: Complex
    second: Complex
    third: Complex
    mean: Float


class MechanicalFamily(Family):
    """Blocks of sweeps, of sinusoids or of ramps."""

    def __init__(self, session: Session, places: Sequence[Place], nodes: Float, kind: str) -> None:
        super().__init__(session, places, nodes, kind)
        self.kind = kind
        starts = np.cumsum([0, *(p.block.size for p in self.places)])
        self._spans = {id(p): (int(a), int(b)) for p, a, b in zip(self.places, starts[:-1], starts[1:], strict=True)}
        self._coarse = self._coarse_view()
        self._harmonics = self._harmonic_rows()
        self._at_nodes = self._between(np.maximum(self.frequency, 1e-9))
        self._at_rows = None if self._harmonics is None else self._between(self._harmonics.frequency)
        self._mean_strain = self._mean_strains()
        self._groups = self._cyclic_groups() if kind == CYCLIC else []
        self._cycles = self._group_cycles() if kind == CYCLIC else None
        self._shifts = [(p, self._shift(p)) for p in self.places if "shift_hz" in p.block.support]

    def _coarse_view(self) -> View | None:
        if self.kind == RAMP:
            return None
        if self.kind == CYCLIC:
            f = np.full((self.states.size, 1), np.nan)
            strain = np.zeros((self.states.size, 1))
            for p in self.places:
                f[self.state_of[id(p)], 0] = p.block.frequency_hz[0]
                strain[self.state_of[id(p)], 0] = p.block.amplitude[0]
            return replace(self.view, frequency_hz=f, strain=strain)
        bands = [p.block.frequency_hz for p in self.places if p.block.kind == CHIRP_RESPONSE]
        low, high = min(float(b.min()) for b in bands), max(float(b.max()) for b in bands)
        inside = np.flatnonzero((self.frequency >= low) & (self.frequency <= high))
        spaced = np.searchsorted(self.frequency[inside], np.geomspace(low, high, _COARSE)).clip(0, inside.size - 1)
        counted = np.linspace(0, inside.size - 1, _COARSE).astype(int)
        return self.view.at(inside[np.unique(np.concatenate([spaced, counted]))])

    def _between(self, frequency: Float) -> _Between | None:
        """Where frequencies of any shape lie among the coarse ones; None where there is one of these only."""
        if self._coarse is None or self._coarse.frequency_hz.shape[1] < 2:
            return None
        x = np.log(self._coarse.frequency_hz[0])
        at = np.interp(np.log(frequency), x, np.arange(x.size, dtype=float)).clip(0, x.size - 1.0)
        left = np.minimum(at.astype(np.int64), x.size - 2)
        return _Between(left, at - left)

    def _cyclic_groups(self) -> list[tuple[Place, Place, Place]]:
        """Response, harmonics and level of each group of cycles."""
        found: dict[int, dict[str, Place]] = {}
        for p in self.places:
            found.setdefault(p.state, {})[p.block.kind] = p
        kinds = CYCLIC_RESPONSE, CYCLIC_HARMONIC, CYCLIC_LEVEL
        return [(g[kinds[0]], g[kinds[1]], g[kinds[2]]) for g in found.values() if all(kind in g for kind in kinds)]

    def _group_cycles(self) -> tuple[Float, Float]:
        """First and last cycle of each state, (S, 1) each: the groups of a recording follow each other from the first on."""
        middle = self.view.cycle[:, 0]
        recording = self.session.states.recording[self.states]
        last = np.zeros(middle.size)
        for r in np.unique(recording):
            end = 0.0
            for i in np.flatnonzero(recording == r)[np.argsort(middle[recording == r])]:
                end = max(2 * middle[i] - end - 1, middle[i])
                last[i] = end
        return (2 * middle - last)[:, None], last[:, None]

    def _shift(self, p: Place) -> Float:
        """(n, C) what a block of a sweep sees of mean forces at the coarse frequencies, which it takes for slow ones."""
        f = p.block.support["shift_hz"]
        weight = p.block.support["shift_weight"].reshape(p.block.size, f.size)
        at = self._between(f)
        if at is None or self._coarse is None:
            return np.asarray(weight.sum(axis=1, keepdims=True))
        spread = np.zeros((f.size, self._coarse.frequency_hz.shape[1]))
        rows = np.arange(f.size)
        spread[rows, at.left] = 1 - at.share
        spread[rows, at.left + 1] += at.share
        return np.asarray(weight @ spread)

    def _mean_strains(self) -> Float:
        mean = np.zeros((self.states.size, 1))
        for p in self.places:
            if "mean_strain" in p.block.support:
                mean[self.state_of[id(p)], 0] = float(p.block.support["mean_strain"][0])
        return mean

    def _harmonic_rows(self) -> _Rows | None:
        parts = []
        for p in self.places:
            if p.block.kind not in (CHIRP_HARMONIC, CYCLIC_HARMONIC):
                continue
            order = p.block.support["order"].astype(np.int64)
            first, n = self._spans[id(p)][0], order.size
            within = p.block.support.get("within_hz")
            f = p.block.frequency_hz[:n, None] if within is None else within.reshape(n, -1)
            at = first + np.arange(n)
            parts.append((at, at + n, np.full(n, self.state_of[id(p)]), order, f))
        if not parts:
            return None
        return _Rows(*(np.concatenate([part[i] for part in parts]) for i in range(5)))

    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family; `loads` where the effect has elements that depend on the amplitude."""
        view, rig = self.view, rig_of(physical, self.rig, effect)
        k = film_at(physical, effect, view).k
        own = dynamic(rig, view, effect, k)
        extra = None
        if loads is not None and self._coarse is not None and (effect.tension or effect.reading):
            extra = self._nonlinear(physical, effect, rig, loads)
            k = k * self._spread(extra.stiffness)
        response = rig.gain * k / (own + k * rig.compliance)
        response = response * (channel(effect.force, view) / channel(effect.displacement, view))
        if extra is not None:
            response = response * self._spread(extra.force)
        values = self.apply(np.atleast_2d(response))
        if extra is not None:
            self._add(values, extra)
            if effect.reading and self.kind == CYCLIC and loads is not None:
                self._read(values, effect, loads)
        elif loads is not None and self.kind == RAMP:
            self._along(values, physical, effect, rig, loads)
        return values

    def _spread(self, coarse: Complex) -> Complex:
        """Values at the coarse frequencies (S, C) at all nodes (S, J or 1)."""
        at = self._at_nodes
        if at is None:
            return coarse
        return np.asarray((1 - at.share) * coarse[:, at.left] + at.share * coarse[:, at.left + 1])

    def _nonlinear(self, physical: Physical, effect: Effect, rig: Rig, loads: Loads) -> _Nonlinear:
        """Describing functions of tension and reading at the coarse frequencies."""
        view = self._coarse
        if view is None:
            raise ValueError("ramps have no describing functions")
        shape = self.states.size, view.frequency_hz.shape[1]
        still = 1 + physical.film.k0 * rig.compliance
        orders = [replace(view, frequency_hz=view.frequency_hz * order) for order in (1, 2, 3)]
        films = [film_at(physical, effect, at).k for at in orders]
        rigs = [dynamic(rig, at, effect, k) for at, k in zip(orders, films, strict=True)]
        k, own = np.broadcast_to(films[0], shape), np.broadcast_to(rigs[0], shape)
        mean_strain = np.broadcast_to(self._mean_strain / still, shape)
        rest = np.broadcast_to(view.rest_force_n, shape)
        strain = np.broadcast_to(view.strain, shape)
        if effect.tension:
            loop = Loop(
                np.broadcast_to(view.frequency_hz, shape),
                np.array([np.broadcast_to(v, shape) for v in (np.array([[physical.film.k0]]), *films)], dtype=complex),
                np.array([np.broadcast_to(v, shape) for v in (np.ones((1, 1)), *rigs)], dtype=complex),
                rig.compliance,
                self._cycles,
            )
            if self.kind == SWEEP:
                found = describe_sweeps(effect.tension, loop, strain, rest, loads, view.scale)
            else:
                found = describe(effect.tension, loop, strain, mean_strain, rest, loads, view.scale)
        else:
            turn = own / (own + k * rig.compliance)
            nothing = np.zeros(shape, dtype=complex)
            found = Described(
                np.ones(shape, dtype=complex), np.zeros(shape), nothing, nothing, strain * np.abs(turn), turn
            )
        unit = found.turn / np.abs(found.turn)
        force = []
        for order, tension in ((2, found.second), (3, found.third)):
            passed = rig.gain / (rigs[order - 1] + films[order - 1] * rig.compliance)
            force.append(tension * unit**order * passed * channel(effect.force, orders[order - 1]))
        mean = found.mean / still
        first = np.ones(shape, dtype=complex)
        if effect.reading and self.kind == SWEEP:
            own_k = k * found.factor
            fundamental = rig.gain * own_k / (own + own_k * rig.compliance) * strain * view.scale.length_mm
            level = np.nan_to_num(rest) + mean
            size = np.abs(fundamental)
            wave = level[..., None] + size[..., None] * COSINE
            seen = wave
            for reading in effect.reading:
                seen = reading(Reading(seen, loads.reading_n))
            change = harmonics(seen - wave)
            first = np.where(size > 0, 1 + change[..., 1] / np.maximum(size, 1e-300), 1.0)
            turned = fundamental / np.maximum(size, 1e-300)
            force = [f + change[..., m] * turned**m for m, f in zip((2, 3), force, strict=True)]
            mean = mean + change[..., 0].real
        return _Nonlinear(found.factor, first, force[0], force[1], mean)

    def _add(self, values: Float, extra: _Nonlinear) -> None:
        """Harmonics and mean shifts into the features."""
        rows, view = self._harmonics, self._coarse
        if view is None:
            return
        if rows is not None:
            both = np.stack([extra.second, extra.third])
            order, state, at = rows.order - 2, rows.state, self._at_rows
            if at is None:
                found = both[order, state, 0]
            else:
                order, state = order[:, None], state[:, None]
                low, high = both[order, state, at.left], both[order, state, at.left + 1]
                found = ((1 - at.share) * low + at.share * high) @ _hann(at.share.shape[1])
            values[rows.real] += found.real
            values[rows.imaginary] += found.imag
        for p, weight in self._shifts:
            first, stop = self._spans[id(p)]
            values[first:stop] += weight @ extra.mean[self.state_of[id(p)]]
        for p in self.places:
            first, stop = self._spans[id(p)]
            state = self.state_of[id(p)]
            if p.block.kind == CYCLIC_LEVEL:
                values[first:stop] += extra.mean[state, 0]
            elif p.block.kind == CHIRP_LEVEL:
                # A logarithmic sweep spends equal times in equal steps of log frequency.
                x = np.log(view.frequency_hz[0])
                mean = float(np.trapezoid(extra.mean[state], x) / (x[-1] - x[0])) if x.size > 1 else 0.0
                values[first:stop] += np.where(p.block.amplitude > 0, mean, 0.0)

    def _read(self, values: Float, effect: Effect, loads: Loads) -> None:
        """Readings of sinusoids: of the waves that mean, fundamental and harmonics of each group make."""
        for group in self._groups:
            response, harmonic, level = (slice(*self._spans[id(p)]) for p in group)
            amplitude = float(group[0].block.amplitude[0]) * self.session.scale.length_mm
            rest = float(np.nan_to_num(self.session.states.rest_force_n[group[0].state]))
            orders = np.concatenate([[1], group[1].block.support["order"]]).astype(np.int64)
            parts = [np.array([complex(*values[response])]) * amplitude]
            both = values[harmonic]
            parts.append(both[: both.size // 2] + 1j * both[both.size // 2 :])
            turned = np.exp(2j * np.pi / PHASES * np.outer(orders, np.arange(PHASES)))
            wave = rest + values[level] + (np.concatenate(parts) @ turned).real
            seen, still = wave, np.array([rest])
            for reading in effect.reading:
                seen, still = reading(Reading(seen, loads.reading_n)), reading(Reading(still, loads.reading_n))
            change = harmonics(seen - wave)
            values[level] += change[0].real - (still[0] - rest)
            values[response] += np.array([change[1].real, change[1].imag]) / amplitude
            values[harmonic] += np.concatenate([change[orders[1:]].real, change[orders[1:]].imag])

    def _along(self, values: Float, physical: Physical, effect: Effect, rig: Rig, loads: Loads) -> None:
        """Elements and readings along the windows of relaxation and cycles, in time order."""
        still = 1 + physical.film.k0 * float(rig.compliance[0, 0])
        for p in self.places:
            first, stop = self._spans[id(p)]
            order = np.argsort(p.block.time_s)
            part = values[first:stop][order]
            rest = float(self.session.states.rest_force_n[p.state])
            if effect.tension:
                strain = p.block.support["strain"][order]
                size = np.abs(part) / np.maximum(np.abs(strain) * self.session.scale.length_mm, 1e-300)
                course = Course(
                    strain[None],
                    part[None],
                    False,
                    np.array([[rest]]),
                    loads.tension_n,
                    loads.fall_n,
                    size[None],
                    physical.film.k0,
                    np.diff(p.block.time_s[order], prepend=0.0)[None],
                    self.session.scale,
                )
                part = part + along(effect.tension, course)[0] / still
            seen = np.nan_to_num(rest) + part
            for reading in effect.reading:
                seen = reading(Reading(seen, loads.reading_n))
            values[first + order] = seen - np.nan_to_num(rest)

    def loads(self, physical: Physical) -> Loads:
        """Largest loads of the family as the plain film has them."""
        rig = physical.rigs[self.rig]
        rest = np.nan_to_num(self.view.rest_force_n)
        if self._coarse is None:
            values = self.predict(physical, NONE, None)
            rise, fall = float(values.max(initial=0.0)), float(-values.min(initial=0.0))
            return Loads(rise, fall, float(rest.max(initial=0.0)) + rise)
        view = self._coarse
        k = film_at(physical, NONE, view).k
        own = dynamic(rig, view, NONE, k)
        swing = np.abs(k * own / (own + k * rig.compliance)) * view.strain * view.scale.length_mm
        reading = np.abs(rig.gain * k / (own + k * rig.compliance)) * view.strain * view.scale.length_mm
        level = physical.film.k0 / (1 + physical.film.k0 * rig.compliance) * self._mean_strain * view.scale.length_mm
        fall = float(np.maximum(swing - level, 0).max())
        return Loads(float((swing + level).max()), fall, float((rest + level + reading).max()))
