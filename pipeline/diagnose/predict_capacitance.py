"""Prediction of the capacitance of sinusoids: the sensing region follows the film's own strain.

ΔC/x0 = κ (1 + (−Mω² + jωcL)/kL)/(1 + (−Mω² + jωcL)/kL + k/kL)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.diagnose.base import Physical
from pipeline.diagnose.describing import Loads
from pipeline.diagnose.effects import Effect
from pipeline.diagnose.families import Family, channel, dynamic, film_at, rig_of

Float = NDArray[np.float64]

_CRACK_POWER = 1.5
"""Cracks open faster than in proportion to the strain."""
_PHASE = 2 * np.pi * np.arange(64) / 64
_CRACK_HARMONICS = np.array(
    [np.mean(2 * ((1 + np.cos(_PHASE)) / 2) ** _CRACK_POWER * np.cos(m * _PHASE)) for m in (1, 2)]
)
"""Harmonics 1 and 2 of that power of a sinusoid between 0 and 1, phase as that of the strain."""


class CapacitanceFamily(Family):
    """First and second harmonic of the capacitance over the fundamental of the displacement, pF/mm.

    A film of one material strains evenly; a capacitance linear in the stretch has no second harmonic of its own.
    """

    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family."""
        rig, view = rig_of(physical, self.rig, effect), self.view
        k = film_at(physical, effect, view).k
        own = dynamic(rig, view, effect, k)
        response = physical.pf_per_mm * own / (own + k * rig.compliance)
        response = response * channel(effect.capacitance, view) * channel(effect.electrode, view)
        values = self.apply(np.atleast_2d(response / channel(effect.displacement, view)))
        if effect.opening:
            self._opened(values, effect)
        return values

    def _opened(self, values: Float, effect: Effect) -> None:
        """Cracks that open as a power of the strain, above that of the rest: less capacitance towards the peak of each cycle."""
        total: Float = np.zeros((self.states.size, 1))
        for function in effect.opening:
            total = total + np.asarray(np.real(function(self.view)))
        at = 0
        for p in self.places:
            rest = self.session.recordings[p.recording].values.get("capacitance_rest_pf", 0.0)
            amplitude = float(p.block.support["input_mm"][0])
            peak = 2 * amplitude / self.session.scale.length_mm
            share = min(peak / max(self.session.scale.strain, 1e-12), 1.0) ** _CRACK_POWER
            lost = rest * float(total[self.state_of[id(p)], 0]) * share / amplitude
            values[at : at + 2] -= lost * _CRACK_HARMONICS
            at += p.block.size
