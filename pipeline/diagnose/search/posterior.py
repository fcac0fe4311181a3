"""One comparison of everything that may be behind a session: the plain model, listed causes, several of them, and regions without a name.

    P(h | data) ∝ P(h) ∫ L(data | θ, s, h) p(s | h) ds

with the likelihood of `likelihood`, the same for all, the integral in Laplace's approximation about each hypothesis' optimum (Kass and
Raftery 1995), and the prior odds of `RULES.prior`. The verdict, the names and the doubts are read off these probabilities.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from pipeline.diagnose.adequacy import Shortfall
from pipeline.diagnose.features.kinds import AMPLIFIER
from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Chosen, Extended, ExtendedFit, compose_chosen
from pipeline.diagnose.search.likelihood import Groups, Linearised, find_absorbed, find_peak, measure_trace
from pipeline.diagnose.search.regions import Region
from schemas.arrays import Float

PLAIN, ANYTHING = "plain", "anything"
"""Names of the hypotheses that nothing is beside the plain model but noise, and that some groups of features are wrong by anything."""
_STEPS = 10
"""Steps of a fit under other weights."""
_ROUNDS = 6
"""Rounds in which weights and optimum follow from each other."""
_SAME = 1.0
"""Log evidence within which two optima are one."""
_WITHIN = 30.0
"""Log probability behind the best within which a hypothesis may come to the front at its own optimum."""


@dataclass(frozen=True)
class RegionFit:
    """A region at the best values of its weights.

    Parameters
    ----------
    region : what depends on what
    weights, covariance : (K,) and (K, K), in the units of the region's shapes
    plain : the plain model that it was computed about, or one with the listed causes that it is beside
    step : (P,) of the entries of film and rig from there to the optimum with the function
    width : of the prior of the weights, over `region.width`
    """

    region: Region
    weights: Float
    covariance: Float
    plain: ExtendedFit
    step: Float
    width: float

    def tell(self) -> tuple[Float, Float]:
        """(M,) the function at the region's values, as a relative change, and its standard deviation."""
        shapes = self.region.shapes
        return shapes @ self.weights, np.sqrt(np.maximum(np.sum((shapes @ self.covariance) * shapes, axis=1), 0.0))

    def predict(self) -> Float:
        """(N,) features of the session with the function, film and rig at its optimum."""
        of, x = self.plain.of, self.plain.x + self.step
        return of.simulation.predict(of.model, x[: of.model.size], of.effect(x) | self.region.weigh(self.weights))

    def compute_change_in(self, of: Extended, x: Float) -> Float:
        """(N,) what it would change in the features of a session.

        Parameters
        ----------
        of, x : the model over that session, and its entries (P,)
        """
        own, theta = of.effect(x), x[: of.model.size]
        changed = of.simulation.predict(of.model, theta, own | self.region.weigh(self.weights))
        return np.asarray(np.nan_to_num(changed - of.predict(x)))


@dataclass(frozen=True)
class Bend:
    """A way in which the form of a cause may be wrong.

    Parameters
    ----------
    columns : (N, K) whitened changes of the features by shapes with standard normal weights
    log_prior : logarithm of what is believed of it beforehand
    """

    columns: Float
    log_prior: float


@dataclass(frozen=True)
class Hypothesis:
    """What may be behind a session.

    Parameters
    ----------
    name : `plain`, `anything`, ids of causes joined by `+`, or `stage/covariate`, with the causes that it is beside before it
    log_evidence : of the data under it
    log_prior : what is believed of it beforehand
    fit : the model with its causes; None for a region
    region : the fitted region; None for listed causes
    weight : (N,) of whitened residuals at its optimum
    odd : (G,) probabilities that a group of features is wrong by something else
    bend : the most probable way in which the form of its causes, or of those that a region is beside, is wrong; None: not asked
    """

    name: str
    log_evidence: float
    log_prior: float
    fit: ExtendedFit | None
    region: RegionFit | None
    weight: Float
    odd: Float
    bend: Bend | None = None

    @property
    def shortfall(self) -> Shortfall:
        """What speaks against it.

        What the amplifier makes of its command is not asked: the simulation is driven by the voltage that was measured.
        """
        asked = ~Groups.of(self.model.of.session).are_of(AMPLIFIER)
        return Shortfall(
            something_else=float(np.max(self.odd[asked], initial=0.0)),
            at_limit=any(
                p.is_at_limit(values[p.name])
                for chosen, values in zip(self.model.of.chosen, self.model.values, strict=True)
                for p in chosen.mechanism.severities
            ),
        )

    @property
    def log_joint(self) -> float:
        """Logarithm of evidence times prior."""
        return self.log_evidence + self.log_prior

    @property
    def model(self) -> ExtendedFit:
        """Its fit, which all but regions have."""
        if self.fit is None:
            raise TypeError(f"{self.name} has no fit of its own")
        return self.fit

    @property
    def causes(self) -> tuple[str, ...]:
        """Ids of its listed causes, in the order of the fit."""
        return () if self.fit is None else tuple(c.id for c in self.fit.of.chosen)

    @property
    def variants(self) -> tuple[str, ...]:
        """Variants of its listed causes, sorted as the name is."""
        chosen = () if self.fit is None else self.fit.of.chosen
        return tuple(c.variant for c in sorted(chosen, key=lambda c: c.id))

    @property
    def beside(self) -> tuple[str, ...]:
        """Ids of the listed causes that a region is beside."""
        return () if self.region is None else tuple(c.id for c in self.region.plain.of.chosen)

    @property
    def stages(self) -> frozenset[str]:
        """Stages in which it acts."""
        if self.region is not None:
            return frozenset({self.region.region.stage})
        return frozenset(MECHANISMS[id].stage for id in self.causes)

    @property
    def depends_on(self) -> frozenset[str]:
        """What it depends on."""
        if self.region is not None:
            return frozenset({self.region.region.depends_on})
        return frozenset(name for id in self.causes for name in MECHANISMS[id].depends_on)


@dataclass(frozen=True)
class Posterior:
    """All hypotheses, the most probable first."""

    hypotheses: tuple[Hypothesis, ...]

    @classmethod
    def of(cls, found: Iterable[Hypothesis]) -> Posterior:
        """The hypotheses, one of each name: its best variant, with the probability of all variants that were fitted."""
        best: dict[tuple[str, tuple[str, ...]], Hypothesis] = {}
        for h in found:
            key = (h.name, h.variants)
            if key not in best or h.log_joint > best[key].log_joint:
                best[key] = h
        by_name: dict[str, list[Hypothesis]] = {}
        for h in best.values():
            by_name.setdefault(h.name, []).append(h)
        return cls(tuple(rank_hypotheses([_add_up_variants(own) for own in by_name.values()])))

    @cached_property
    def probability(self) -> dict[str, float]:
        """Name → probability; they sum to 1."""
        joint = np.array([h.log_joint for h in self.hypotheses])
        shares = np.exp(joint - logsumexp(joint))
        return {h.name: float(p) for h, p in zip(self.hypotheses, shares / shares.sum(), strict=True)}

    @property
    def listed(self) -> tuple[Hypothesis, ...]:
        """Those of listed causes, the most probable first."""
        return tuple(h for h in self.hypotheses if h.causes)

    @property
    def regions(self) -> tuple[Hypothesis, ...]:
        """Those without a name, the most probable first."""
        return tuple(h for h in self.hypotheses if h.region is not None)

    def find_set(self, probability: float) -> tuple[Hypothesis, ...]:
        """The fewest hypotheses that hold a probability together."""
        shares = np.cumsum([self.probability[h.name] for h in self.hypotheses])
        return self.hypotheses[: int(np.searchsorted(shares, probability)) + 1]

    @property
    def named_share(self) -> float:
        """Probability that listed causes are all that there is."""
        return sum(self.probability[h.name] for h in self.listed)

    def doubt_listed(self, most: float) -> Posterior:
        """The posterior where listed causes are together no more probable than that, whatever the likelihood says.

        Parameters
        ----------
        most : between 0 and 1
        """
        others = [h for h in self.hypotheses if not h.causes]
        if self.named_share <= most or not others:
            return self
        sides = [float(logsumexp([h.log_joint for h in own])) for own in (self.listed, others)]
        less = sides[0] - sides[1] - float(np.log(most / (1 - most)))
        doubted = [replace(h, log_prior=h.log_prior - less) if h.causes else h for h in self.hypotheses]
        return Posterior(tuple(rank_hypotheses(doubted)))

    def find_sure(self) -> tuple[Hypothesis, ...]:
        """The hypotheses of listed causes that are as good as certain, whatever is beside them: what has no name may be, and a cause of
        a hypothesis may stand for it. The most probable first; empty where no cause is certain.
        """
        sure = self._list_sure()
        return tuple(h for h in self.listed if {*h.causes} <= sure)

    def find_sure_beside(self) -> Hypothesis | None:
        """The listed causes beside which the most probable region without a name was fitted, where they are as good as certain."""
        beside = {id for h in self.regions[:1] for id in h.beside}
        if not beside or not beside <= self._list_sure():
            return None
        return next((h for h in self.listed if {*h.causes} == beside), None)

    def _list_sure(self) -> set[str]:
        """Listed causes that are there as good as certainly, alone or beside anything else."""
        of = {h.name: {*h.causes, *h.beside} for h in self.hypotheses}
        total = {
            id: sum(self.probability[name] for name, own in of.items() if id in own) for id in set().union(*of.values())
        }
        return {id for id, p in total.items() if p >= RULES.verdict.credible}

    def sum_by(self, stage: bool) -> dict[str, float]:
        """Stage, or what something depends on → probability that a cause acts there."""
        total: dict[str, float] = {}
        for h in self.hypotheses:
            for name in h.stages if stage else h.depends_on:
                total[name] = total.get(name, 0.0) + self.probability[h.name]
        return total


def weigh_fit(fit: ExtendedFit, *, noise_alone: bool = False) -> Hypothesis:
    """A fitted model as a hypothesis.

    Parameters
    ----------
    fit : the plain model, or one with causes, at its optimum under any weights
    noise_alone : whether the plain model is believed to miss nothing but noise
    """
    of, groups = fit.of, Groups.of(fit.of.session, fit.of.quiet)
    trace = measure_trace_of_causes(fit, groups)
    peak = find_peak(groups, Linearised.of(fit), trace, fit.x.size, noise_alone=noise_alone)
    return Hypothesis(
        "+".join(sorted(c.id for c in of.chosen)) or (PLAIN if noise_alone else ANYTHING),
        peak.log_likelihood + fit.integrate_mechanisms(peak.covariance),
        believe(of.chosen, noise_alone=noise_alone),
        fit,
        None,
        peak.weight,
        peak.odd,
    )


def measure_trace_of_causes(fit: ExtendedFit, groups: Groups) -> Float:
    """(G,) mean square of what the causes of a fit change in each group, beyond what film and rig absorb.

    Parameters
    ----------
    fit : a model with causes at its optimum
    groups : of its session's features
    """
    return measure_trace(groups, find_absorbed(fit), compute_change_by_causes(fit))


def compute_change_by_causes(fit: ExtendedFit) -> Float:
    """(N,) whitened change of the features by the causes of a fit."""
    of = fit.of
    if not of.chosen:
        return np.zeros(of.session.size)
    return of.session.whiten(of.predict(fit.x) - of.simulation.predict(of.model, fit.theta))


def compute_change_by_cause(fit: ExtendedFit, number: int) -> Float:
    """(N,) whitened change of the features by one cause of a fit, beside its others."""
    of = fit.of
    others = [i for i in range(len(of.chosen)) if i != number]
    without = compose_chosen([of.chosen[i] for i in others], [fit.values[i] for i in others])
    return of.session.whiten(of.predict(fit.x) - of.simulation.predict(of.model, fit.theta, without))


def believe(causes: Sequence[Chosen], *, noise_alone: bool) -> float:
    """Logarithm of what is believed beforehand.

    Parameters
    ----------
    causes : listed ones, whose mechanisms are believed alike, and of each its variants; none: the plain model
    noise_alone : whether the plain model is believed to miss nothing but noise

    Notes
    -----
    Every amplifier lags a little: that one does says nothing of the film, and beside its lag a cause is as likely, against none, as it is
    alone.
    """
    rules = RULES.prior
    if not causes:
        return float(np.log(rules.plain if noise_alone else rules.anything))
    # The lag of the amplifier first, whatever is beside it.
    ordered = sorted(causes, key=lambda c: not c.is_monitored_lag)
    shares = [share_of_next(ordered[:i]) for i in range(len(ordered))]
    each = [len(MECHANISMS) * len(c.mechanism.variants) for c in causes]
    return float(np.sum(np.log(shares) - np.log(each)))


def share_of_next(causes: Sequence[Chosen]) -> float:
    """Probability beforehand that a listed cause is there beside some, of which each is as likely."""
    rules = RULES.prior
    if not causes:
        return rules.listed
    return rules.listed / rules.plain if all(c.is_monitored_lag for c in causes) else rules.further


def _add_up_variants(found: Sequence[Hypothesis]) -> Hypothesis:
    """The most probable of one name, with the probability of all."""
    best = max(found, key=lambda h: h.log_joint)
    if len(found) == 1:
        return best
    return replace(best, log_prior=float(logsumexp([h.log_joint for h in found])) - best.log_evidence)


def reweigh_fit(hypothesis: Hypothesis, most: int) -> ExtendedFit:
    """The model of a hypothesis at its optimum under the weights that it deserves.

    Parameters
    ----------
    hypothesis : one with a fit
    most : steps at most
    """
    fit = hypothesis.model
    of = fit.of.reweigh(hypothesis.weight)
    return of.refine(of.fit(fit.x, most=most, near=fit))


def settle_hypotheses(found: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The hypotheses, those near the best one at their optimum under the weights that they deserve themselves.

    Parameters
    ----------
    found : hypotheses with fits under weights that allow for causes of any form
    """
    settled: dict[int, Hypothesis] = {}
    for _ in range(RULES.fit.settled):
        near = max((settled.get(id(h), h).log_joint for h in found), default=0.0) - RULES.fit.close_call
        waiting = [h for h in found if id(h) not in settled and h.log_joint > near - _WITHIN]
        if not waiting:
            break
        best = max(waiting, key=lambda h: h.log_joint)
        settled[id(best)] = settle_hypothesis(best)
    return [settled.get(id(h), h) for h in found]


def settle_hypothesis(hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis where its weights follow from its own optimum."""
    best = hypothesis
    for _ in range(_ROUNDS):
        again = weigh_fit(reweigh_fit(best, _STEPS), noise_alone=best.name == PLAIN)
        gain = again.log_evidence - best.log_evidence
        # What was computed to first order from elsewhere may promise a little more than the optimum itself holds.
        best = again if gain > -_SAME else best
        if gain < _SAME:
            break
    return best


def refit_under(base: ExtendedFit, hypothesis: Hypothesis) -> ExtendedFit:
    """The model of a hypothesis at its optimum under the weights of another fit, so that the two can be compared number by number.

    Parameters
    ----------
    base : the fit with the weights
    hypothesis : one with a fit
    """
    fit = hypothesis.model
    if fit.of.weight is base.of.weight:
        return fit
    of = fit.of.reweigh(base.of.weight)
    return of.refine(of.fit(fit.x, most=_STEPS, near=fit))


def rank_hypotheses(found: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The most probable first."""
    return sorted(found, key=lambda h: -h.log_joint)
