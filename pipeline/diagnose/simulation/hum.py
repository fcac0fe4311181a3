"""Mains in a session: whether the rest shows them, and the variance that they then have in everything read off the force."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc

from pipeline.diagnose.features.kinds import REST_HUM
from pipeline.diagnose.features.noise_density import NoiseLaw
from pipeline.diagnose.features.rest import hum_score
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.mains import HUM_HZ, MAINS_HZ, mains_components
from pipeline.diagnose.simulation.session import Session
from schemas.arrays import Float

_RANGE_N = (1e-7, 1.0)
"""Amplitudes of the mains between which they are searched, N."""


def with_hum(session: Session) -> Session:
    """The session with mains in its noise, as strong as the rests say; as it is where they show none."""
    rests = _Rests.of(session)
    if rests.score.size == 0 or rests.find_chance() > RULES.features.mains_level:
        return session
    mains = min(MAINS_HZ, key=lambda f: rests.on(f, 2 * f).find_chance())
    amplitude = {f: rests.on(f).find_amplitude() if f in (mains, 2 * mains) else 0.0 for f in HUM_HZ}
    laws = dict(session.laws)
    count = len(session.recordings)
    for quantity, coefficient in mains_components(amplitude).items():
        for rig in range(len(session.rigs)):
            laws[(rig, quantity)] = NoiseLaw(np.full(count, coefficient), 0.0, 0.0)
    return replace(session, laws=laws)


@dataclass(frozen=True)
class _Rests:
    """Lines of the mains in all rests, (n,) each: their frequency Hz, score, variance N² and its degrees of freedom."""

    frequency_hz: Float
    score: Float
    variance: Float
    freedom: Float

    @classmethod
    def of(cls, session: Session) -> _Rests:
        """Those of a session that could be read."""
        found = [p.block for p in session.places if p.block.kind == REST_HUM]
        lines = [(b.frequency_hz, b.value, b.support["variance"], b.support["freedom"]) for b in found]
        columns = [np.concatenate(c) for c in zip(*lines, strict=True)] if lines else [np.zeros(0)] * 4
        sound = np.isfinite(columns[1]) & np.isfinite(columns[2])
        return cls(*(c[sound] for c in columns))

    def on(self, *frequencies_hz: float) -> _Rests:
        """Those of some lines."""
        own = np.isin(self.frequency_hz, frequencies_hz)
        return _Rests(self.frequency_hz[own], self.score[own], self.variance[own], self.freedom[own])

    def find_chance(self) -> float:
        """Probability of scores like these without mains."""
        return float(chdtrc(max(self.score.size, 1), float(np.sum(np.maximum(self.score, 0.0) ** 2))))

    def find_amplitude(self) -> float:
        """Amplitude in N that explains the scores best."""
        if self.score.size == 0:
            return 0.0

        def misfit(log_amplitude: float) -> float:
            size = np.full(self.score.size, np.exp(log_amplitude))
            return float(np.sum((self.score - hum_score(size, self.variance, self.freedom)) ** 2))

        found = minimize_scalar(misfit, bounds=np.log(_RANGE_N), method="bounded")
        return float(np.exp(found.x))
