"""When a comparison may be stopped early: bounds at each look that keep the error rates of the whole.

The bounds spend the error as O'Brien and Fleming's do (K. Lan, D. DeMets, Biometrika 70 (1983) 659); probabilities by
P. Armitage, C. McPherson and B. Rowe's recursion (J. R. Stat. Soc. A 132 (1969) 235) over the increments of the
statistic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import optimize, special

from schemas.arrays import Float
from schemas.errors import UsageError

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(101)
_LARGEST_Z = 8.0
_MOST_LOOKS = 20


@dataclass(frozen=True)
class Look:
    """One look at the lives so far.

    Parameters
    ----------
    share : of all planned failures that have come by then
    bound : |z| from which the test stops: the designs differ
    p_value : two-sided p that this is
    false_alarm : probability to have stopped by this look where the designs are equal
    power : probability to have stopped by this look where they differ as planned
    """

    share: float
    bound: float
    p_value: float
    false_alarm: float
    power: float


@dataclass(frozen=True)
class Stopping:
    """All looks. `inflation`: failures over those that one look at the end would need; `expected_share`: of the planned
    failures that have come when the test stops, on average, where the designs differ as planned.
    """

    looks: tuple[Look, ...]
    inflation: float
    expected_share: float


def plan_stopping(shares: Sequence[float], level: float = 0.05, power: float = 0.8) -> Stopping:
    """Bounds of a two-sided test that looks several times.

    Parameters
    ----------
    shares : of the planned failures at each look, rising to 1
    level : false alarms of all looks together
    power : wanted of all looks together

    Raises
    ------
    UsageError
        The shares do not rise to 1, or a probability is none.
    """
    times = np.asarray(shares, dtype=np.float64)
    if not (0 < times.size <= _MOST_LOOKS and (np.diff(times, prepend=0.0) > 0).all() and abs(times[-1] - 1) < 1e-9):
        raise UsageError(f"looks at {list(shares)}", expected=f"up to {_MOST_LOOKS} shares that rise to 1")
    if not (0 < level < 0.5 and level < power < 1):
        raise UsageError(
            f"false alarms {level:g}, power {power:g}", expected="false alarms below 0.5 and below the power"
        )
    bounds = _find_bounds(times, level)
    single = _drift(np.array([-special.ndtri(level / 2)]), np.ones(1), power)
    drift = _drift(bounds, times, power)
    alarms, powers = (np.cumsum(_stop_probabilities(bounds, times, d)) for d in (0.0, drift))
    at_stop = np.diff(powers, prepend=0.0)
    looks = tuple(
        Look(float(t), float(b), float(2 * special.ndtr(-b)), float(a), float(p))
        for t, b, a, p in zip(times, bounds, alarms, powers, strict=True)
    )
    return Stopping(looks, float((drift / single) ** 2), float(at_stop @ times + 1 - powers[-1]))


def _find_bounds(times: Float, level: float) -> Float:
    """Bounds that spend 2 − 2 Φ(z/√t) on each side, with z the normal point of a quarter of the level."""
    spent = 4 * special.ndtr(special.ndtri(level / 4) / np.sqrt(times))
    bounds = np.empty(times.size)
    state, spent_before = _State(), 0.0
    for i, (time, until_now) in enumerate(zip(times, spent, strict=True)):
        wanted = float(until_now) - spent_before

        def excess(bound: float, time: float = time, wanted: float = wanted, state: _State = state) -> float:
            return state.stop_probability(bound, time, 0.0) - wanted

        bounds[i] = _LARGEST_Z if excess(_LARGEST_Z) > 0 else optimize.brentq(excess, 0.5, _LARGEST_Z, xtol=1e-9)
        spent_before += state.stop_probability(bounds[i], time, 0.0)
        state = state.advance(bounds[i], time, 0.0)
    return bounds


@dataclass(frozen=True)
class _State:
    """The score B(t) = z √t of those who have not stopped by `time`: quadrature points and their probabilities.

    Its mean is drift · t, its variance t.
    """

    time: float = 0.0
    score: Float = field(default_factory=lambda: np.zeros(1))
    mass: Float = field(default_factory=lambda: np.ones(1))

    def stop_probability(self, bound: float, time: float, drift: float) -> float:
        """Probability to pass the bound on either side at the next look."""
        edge, spread = bound * np.sqrt(time), np.sqrt(time - self.time)
        mean = self.score + drift * (time - self.time)
        return float(self.mass @ (special.ndtr((mean - edge) / spread) + special.ndtr((-edge - mean) / spread)))

    def advance(self, bound: float, time: float, drift: float) -> _State:
        """Those who do not stop at the next look."""
        edge, spread = bound * np.sqrt(time), np.sqrt(time - self.time)
        mean = self.score + drift * (time - self.time)
        # The density is looked at where it is: within the bounds, and within eight standard deviations of its mean.
        middle = float(np.clip(drift * time, -edge, edge))
        low, high = max(-edge, middle - 8 * np.sqrt(time)), min(edge, middle + 8 * np.sqrt(time))
        score = low + (high - low) * (_NODES + 1) / 2
        density = np.exp(-(((score[:, None] - mean[None, :]) / spread) ** 2) / 2) / (spread * np.sqrt(2 * np.pi))
        return _State(time, score, (density @ self.mass) * _WEIGHTS * (high - low) / 2)


def _stop_probabilities(bounds: Float, times: Float, drift: float) -> Float:
    """(looks,) probability to stop at each look."""
    found, state = np.empty(times.size), _State()
    for i, (time, bound) in enumerate(zip(times, bounds, strict=True)):
        found[i] = state.stop_probability(float(bound), float(time), drift)
        state = state.advance(float(bound), float(time), drift)
    return found


def _drift(bounds: Float, times: Float, power: float) -> float:
    """Mean of the final z at which the probability to stop is `power`."""
    return float(
        optimize.brentq(
            lambda d: float(_stop_probabilities(bounds, times, d).sum()) - power, 0.0, 20.0, xtol=1e-8, rtol=1e-8
        )
    )
