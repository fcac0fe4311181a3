"""Prediction of the capacitance of sinusoids: the sensing region follows the film's own strain.

ΔC/x0 = κ (1 + (−Mω² + jωcL)/kL)/(1 + (−Mω² + jωcL)/kL + k/kL); beside a strip in series times k_P/(k + k_P)
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from pipeline.diagnose.simulation.describing import Loads
from pipeline.diagnose.simulation.effects import Cracks, Effect
from pipeline.diagnose.simulation.families import Family, channel, dynamic, film_at, rig_of
from pipeline.diagnose.simulation.nodes import POINTS, interpolation
from pipeline.diagnose.simulation.parameters import Physical, Several
from pipeline.diagnose.simulation.remembered import Inputs
from schemas.arrays import Complex, Float

_PHASE = 2 * np.pi * np.arange(64) / 64
"""Phases of a period."""
_SINUSOID = (1 + np.cos(_PHASE)) / 2
"""Strain over a period, from 0 to 1."""
_ORDERS = np.array([1, 2])
"""Harmonics of the capacitance that are features."""
_FIRST_AND_SECOND = 2 * np.cos(np.outer(_ORDERS, _PHASE)) / _PHASE.size
"""Takes these harmonics of a period."""


class CapacitanceFamily(Family):
    """First and second harmonic of the capacitance over the fundamental of the displacement, pF/mm.

    A film of one material strains evenly; a capacitance linear in the stretch has no second harmonic of its own.
    """

    inputs = Inputs.named("film rigs pf_per_mm", "film rig clamp displacement capacitance electrode opening")

    _of_nodes = (*Family._of_nodes, "_at_fundamental")

    @cached_property
    def _at_fundamental(self) -> dict[int, Float]:
        """Weights (J,) of the nodes in a response at the fundamental of each block, by its first place."""
        hz = np.array([p.block.frequency_hz[0] for p in self.places])
        weights = interpolation(self.frequency, hz, POINTS if self.view.few else 4).toarray()
        return {p.first: row for p, row in zip(self.places, weights, strict=True)}

    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family."""
        strained = self._strained(physical, effect)
        values = self._closed(physical, effect, strained)
        for cracks in effect.opening:
            self._opened(values, cracks, strained, physical.pf_per_mm)
        return values

    def of_spectra(self, physical: Physical | Several, effect: Effect) -> Float:
        """Features (rows,) without cracks that open; of several at once (B, rows)."""
        return self._closed(physical, effect, self._strained(physical, effect))

    def _strained(self, physical: Physical | Several, effect: Effect) -> Complex:
        """(..., 1 or S, J) extension of the film over the displacement."""
        rig, view = rig_of(physical, self.rig, effect), self.view
        film = film_at(physical, effect, view)
        own = dynamic(rig, view, effect, film.k)
        # Of what two films in series are strained by together, the active one has the share by which its force reaches the ends.
        return np.atleast_2d(rig.extension(film.k, own) * film.share)

    def _closed(self, physical: Physical | Several, effect: Effect, strained: Complex) -> Float:
        """Features (..., rows) where no cracks open."""
        view = self.view
        response = physical.pf_per_mm * strained * channel(effect.capacitance, view) * channel(effect.electrode, view)
        return self.apply(np.atleast_2d(response / channel(effect.displacement, view)))

    def _opened(self, values: Float, cracks: Cracks, strained: Complex, pf_per_mm: float) -> None:
        """Cracks that open as a power of the film's strain, above that of the rest: less capacitance towards the peak of each cycle.

        `strained` (1 or S, J) is the film's extension over the displacement.
        """
        open_wide = np.broadcast_to(np.asarray(np.real(cracks.share(self.view))), (self.states.size, 1))
        opened = _SINUSOID**cracks.power
        at = 0
        for p in self.places:
            rest = self.session.recordings[p.recording].values.get("capacitance_rest_pf", 0.0)
            amplitude = float(p.block.support["input_mm"][0])
            state = self.state_of[id(p)]
            film = self._at_fundamental[p.first] @ strained[min(state, len(strained) - 1)]
            peak = 2 * amplitude * abs(film)
            strain = peak / self.session.scale.length_mm / self.session.scale.largest_strain
            # Of the capacitance that the film has at that strain, a share is lost.
            grown = rest + pf_per_mm * peak * _SINUSOID
            lost = float(open_wide[state, 0]) * min(strain, 1.0) ** cracks.power * grown * opened / amplitude
            turned = (_FIRST_AND_SECOND @ lost) * np.exp(1j * np.angle(film) * _ORDERS)
            values[at : at + p.block.size] -= np.concatenate([turned.real, turned.imag])
            at += p.block.size
