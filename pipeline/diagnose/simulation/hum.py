"""Mains in a session: whether the rest shows them, and the variance that they then have in everything read off the force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc

from pipeline.diagnose.features.kinds import REST_HUM
from pipeline.diagnose.features.noise_density import NoiseLaw
from pipeline.diagnose.features.rest import hum_score
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.mains import HUM_HZ, mains_components
from pipeline.diagnose.simulation.session import Session
from schemas.arrays import Float

_RANGE_N = (1e-7, 1.0)
"""Amplitudes of the mains between which they are searched, N."""


def with_hum(session: Session) -> Session:
    """The session with mains in its noise, as strong as the rests say; as it is where they show none."""
    frequency, score, variance = _rests(session)
    if score.size == 0 or chdtrc(score.size, float(np.sum(np.maximum(score, 0.0) ** 2))) > RULES.features.mains_level:
        return session
    amplitude = {f: _amplitude(score[frequency == f], variance[frequency == f]) for f in HUM_HZ}
    laws = dict(session.laws)
    count = len(session.recordings)
    for quantity, coefficient in mains_components(amplitude).items():
        for rig in range(len(session.rigs)):
            laws[(rig, quantity)] = NoiseLaw(np.full(count, coefficient), 0.0, 0.0)
    return replace(session, laws=laws)


def _rests(session: Session) -> tuple[Float, Float, Float]:
    """Frequency, score and variance of a line, (n,) each, of all rests."""
    found = [p for p in session.places if p.block.kind == REST_HUM]
    if not found:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    frequency = np.concatenate([p.block.frequency_hz for p in found])
    score = np.concatenate([p.block.value for p in found])
    variance = np.concatenate([p.block.support["variance"] for p in found])
    sound = np.isfinite(score) & np.isfinite(variance)
    return frequency[sound], score[sound], variance[sound]


def _amplitude(score: Float, variance: Float) -> float:
    """Amplitude in N that explains the scores best."""
    if score.size == 0:
        return 0.0

    def misfit(log_amplitude: float) -> float:
        expected = hum_score(np.full(score.size, np.exp(log_amplitude)), variance)
        return float(np.sum((score - expected) ** 2))

    found = minimize_scalar(misfit, bounds=np.log(_RANGE_N), method="bounded")
    return float(np.exp(found.x))
