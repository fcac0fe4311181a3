"""Regions at their own optima: what a function changes is in proportion to its weights only as long as it is small.

To first order about the plain model a region promises more than it can hold, or less. Those that come to the front are therefore
searched as they are simulated, in the way of listed causes: least squares under weights that allow for causes of any form, then under
those that follow from what it leaves itself. No promise enters a comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from pipeline.diagnose.search.extended_model import Extended, ExtendedFit
from pipeline.diagnose.search.form_functions import WIDTHS, integrate_peak, list_forms
from pipeline.diagnose.search.likelihood import (
    LARGEST,
    Groups,
    Linearised,
    Peak,
    find_absorbed,
    find_peak,
    measure_trace,
    score_groups,
)
from pipeline.diagnose.search.posterior import Bend, Hypothesis, RegionFit
from pipeline.physics.least_squares import Solution, central, minimise
from schemas.arrays import Bool, Float

_STEPS, _FEWER = 25, 10
"""Steps of a search at most, and of one under weights that hardly differ."""
_ROUNDS = 8
"""Rounds in which weights and optimum follow from each other."""
_GAIN = 0.5
"""Log probability that is not worth another round."""
_FAR = (-30.0, 30.0)
"""Limits of weights in standard deviations."""
_AT_MOST = 4
"""Regions that are searched at most."""
_WITHIN = 5.0
"""Log probability behind the best listed cause within which a region may come to the front at its own optimum."""


def settle_regions(
    regions: Sequence[Hypothesis], listed: Sequence[Hypothesis], tempered: ExtendedFit
) -> list[Hypothesis]:
    """The regions, those that would come before the listed causes at their own optimum.

    Parameters
    ----------
    regions : hypotheses of regions to first order about the plain model, or beside listed causes
    listed : hypotheses that they are compared with
    tempered : the plain model, or that with the causes, under weights that allow for causes of any form
    """
    found = {h.name: h for h in regions}
    least = max((h.log_joint for h in listed), default=-np.inf) - _WITHIN
    settled: set[str] = set()
    while len(settled) < _AT_MOST:
        waiting = [h for h in found.values() if h.name not in settled and h.log_joint > least]
        if not waiting:
            break
        best = max(waiting, key=lambda h: h.log_joint)
        if settled and best.log_joint < max(found[name].log_joint for name in settled) - _WITHIN:
            break
        found[best.name] = settle_region(best, tempered)
        settled.add(best.name)
    return list(found.values())


def settle_region(hypothesis: Hypothesis, tempered: ExtendedFit) -> Hypothesis:
    """A region at its own optimum, over all widths of its prior; `tempered` as in `settle_regions`."""
    start = hypothesis.region
    if start is None:
        raise TypeError(f"{hypothesis.name} is no region")
    search = _RegionSearch.of(start, hypothesis.bend)
    found, weight = search.begin(tempered), tempered.of.weight
    here, best = found.x, search.compute_value(found.x)
    for _ in range(_ROUNDS):
        before, weight = weight, search.find_weight(here)
        found = search.go_on(found, here, before, weight)
        value = search.compute_value(found.x)
        gain = value - best
        if gain > 0:
            here, best = found.x, value
        if gain < _GAIN:
            break
    x, weights = search.split(here)
    evidence, peak = search.weigh(here)
    scale = search.scale[search.free]
    spread = np.zeros((weights.size, weights.size))
    own = slice(x.size, x.size + scale.size)
    spread[np.ix_(search.free, search.free)] = np.outer(scale, scale) * peak.covariance[own, own]
    fit = replace(start, weights=weights, covariance=spread, step=x - start.plain.x)
    return replace(hypothesis, log_evidence=evidence, region=fit, weight=peak.weight, odd=peak.odd)


@dataclass(frozen=True)
class _RegionSearch:
    """The search of one region, over u (P + F,): entries of film and rig and of listed causes that it is beside, and free weights in
    standard deviations of their prior.

    Parameters
    ----------
    start : the region to first order
    groups, absorbed : of its session's features
    scale : (K,) standard deviations of its weights
    free : (K,) weights that leave a trace, F of them
    bend : how the form of causes that it is beside may be wrong, as in `Hypothesis`
    """

    start: RegionFit
    groups: Groups
    absorbed: Float
    scale: Float
    free: Bool
    bend: Bend | None

    @classmethod
    def of(cls, start: RegionFit, bend: Bend | None) -> _RegionSearch:
        scale = start.width * start.region.width
        free = np.diag(start.covariance) > 0
        of = start.plain.of
        return cls(start, Groups.of(of.session, of.quiet), find_absorbed(start.plain), scale, free, bend)

    @property
    def _of(self) -> Extended:
        return self.start.plain.of

    @property
    def _limits(self) -> tuple[Float, Float]:
        """Least and largest u."""
        free = np.ones(int(self.free.sum()))
        low, high = self._of.limits
        return np.concatenate([low, _FAR[0] * free]), np.concatenate([high, _FAR[1] * free])

    def split(self, u: Float) -> tuple[Float, Float]:
        """Entries of film, rig and causes (P,), weights (K,)."""
        size, weights = self.start.plain.x.size, np.zeros(self.scale.size)
        weights[self.free] = self.scale[self.free] * u[size:]
        return u[:size], weights

    def predict(self, u: Float) -> Float:
        """(N,) features."""
        x, weights = self.split(u)
        of = self._of
        return of.simulation.predict(of.model, x[: of.model.size], of.effect(x) | self.start.region.weigh(weights))

    def compute_left(self, u: Float) -> Float:
        """(N,) measured less predicted features, whitened."""
        session = self._of.session
        left = session.whiten(session.value - self.predict(u))
        return np.where(np.isfinite(left) & (np.abs(left) < LARGEST), left, np.sqrt(LARGEST))

    def compute_beside(self, u: Float) -> Float:
        """(P′ + F,) deviations from what is known beforehand."""
        x, own = np.split(u, [self.start.plain.x.size])
        return np.concatenate([self._of.compute_deviations(x), own])

    def begin(self, tempered: ExtendedFit) -> Solution:
        """The optimum under the weights of a fit without the region, from there and with its Jacobian."""
        known, own = tempered.solution.jacobian, int(self.free.sum())
        lent = np.zeros((known.shape[0] + own, known.shape[1] + own))
        lent[: known.shape[0], : known.shape[1]] = known
        return self._minimise(np.concatenate([tempered.x, np.zeros(own)]), tempered.of.weight, _STEPS, lent)

    def go_on(self, found: Solution, u: Float, before: Float, weight: Float) -> Solution:
        """The optimum under other weights (N,) than those `before`, from u and with the Jacobian of where a search has ended."""
        lent = found.jacobian.copy()
        lent[: weight.size] *= (weight / before)[:, None]
        return self._minimise(u, weight, _FEWER, lent)

    def _minimise(self, u: Float, weight: Float, most: int, lent: Float) -> Solution:
        def residuals(several: Float) -> Float:
            data = [np.concatenate([weight * self.compute_left(x), self.compute_beside(x)]) for x in several]
            return np.array(data)

        return minimise(residuals, u, *self._limits, most=most, jacobian=lent, moving=self.start.plain.x.size)

    def trace(self, u: Float) -> Float:
        """(G,) mean square of what causes and function change."""
        of = self._of
        change = self.predict(u) - of.simulation.predict(of.model, u[: of.model.size])
        return measure_trace(self.groups, self.absorbed, of.session.whiten(np.nan_to_num(change)))

    def find_weight(self, u: Float) -> Float:
        """(N,) weights of residuals that follow from what is left."""
        weight = score_groups(self.groups, self.compute_left(u), self.trace(u), noise_alone=False)[1]
        return np.sqrt(weight)[self.groups.number]

    def compute_value(self, u: Float) -> float:
        """Logarithm of likelihood times prior."""
        score = score_groups(self.groups, self.compute_left(u), self.trace(u), noise_alone=False)[0]
        beside = self.compute_beside(u)
        return score - 0.5 * float(beside @ beside)

    def weigh(self, u: Float) -> tuple[float, Peak]:
        """Log evidence over all widths of the prior at an optimum, and the peak at that of the start."""
        fit = self.start.plain
        size = fit.x.size
        here = replace(fit, solution=replace(fit.solution, x=u[:size]))
        jacobian = central(lambda several: np.array([self.compute_left(x) for x in several]), u, *self._limits)
        left, trace, evidence, peaks = self.compute_left(u), self.trace(u), [], []
        known = central(lambda several: np.array([self.compute_beside(x) for x in several]), u, *self._limits)
        for width in WIDTHS:
            share = width / self.start.width
            columns, beside = jacobian.copy(), self.compute_beside(u)
            columns[:, size:] *= share
            beside[beside.size - (u.size - size) :] /= share
            about = Linearised(left, columns, beside, known)
            found = []
            for believed, form in list_forms(self.bend, about):
                peak = find_peak(self.groups, form, trace, size, noise_alone=False, stay=form is about)
                found.append((believed + integrate_peak(here, peak), peak))
            evidence.append(float(logsumexp([value for value, _ in found])))
            peaks.append(max(found, key=lambda pair: pair[0])[1])
        nearest = int(np.argmin(np.abs(np.log(WIDTHS / self.start.width))))
        return float(logsumexp(evidence) - np.log(len(evidence))), peaks[nearest]
