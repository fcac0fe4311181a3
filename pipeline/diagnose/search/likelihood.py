"""How likely a session's features are under a model whose form is not quite right: one likelihood for all hypotheses.

The features of one kind in one recording are a *group*. What a model leaves of a group is noise, and beside it a few smooth modes by
which the model's form is wrong. How wrong is not known beforehand: usually by a share of what the hypothesis itself changes there, and
now and then by anything, for reality is not listed. So the variance of the modes is a mixture,

    L = log Σ_a p(a) (1 + a)^(−m/2) exp(−½ (n − m) − ½ max(r² − (n − m), 0)/(1 + a)),

with r² the sum of squares of the group's n whitened residuals and m ≤ `form.modes` the number of modes: a group that is missed by ten
thousand standard deviations says little more against a hypothesis than one that is missed by a thousand, and one within the noise
counts in full. (Not so a calibration: no film is in it, and what contradicts it is the sensor or the rig.) In place of n − m stands the least r² that any hypothesis leaves, where that is less: the noise of a test may be quieter
than that of its rests, or quieter by chance, and what lies between the two is misfit of all others. It may also be louder: r² over a
scale, for all n residuals. How often groups drift or are louder depends on the session (`form.session`, `form.many`), of which there are
three kinds: L is summed over these. A scale mixture of normals: Andrews and Mallows 1974; a form error in proportion to the effect:
Brynjarsdóttir and O'Hagan 2014.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence, Set
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from pipeline.diagnose.features.kinds import CALIBRATIONS, DRIFTING
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit, orthonormalise
from pipeline.diagnose.simulation.session import Session
from schemas.arrays import Bool, Float, Int

_RIDGE = 1e-9
"""Share of a scaled normal matrix's diagonal that is added before it is inverted."""
LARGEST = 1e100
"""Change of a feature beyond which it was not computed: about a resonance without damping it may be anything."""
_PLACES, _MORE_PLACES = 9, 29
"""Variances of groups that drift, and of those that are wrong by something else, that are summed over."""
_STEPS = 6
"""Linear steps to the optimum under the mixture at most."""
_SETTLED = 1e-4
"""Rise of the log likelihood, twice as foreseen, below which a step is not taken any more."""
_DRIFTS, _ODD = 1, 2
"""Numbers of the ways in which a group drifts, and in which something else is wrong."""
_NEVER = 1e-300
"""A probability that is none."""
_LONGEST = 0.7
"""Longest step of one entry of film and rig: what is computed to first order holds about so far."""


@dataclass(frozen=True)
class Groups:
    """Features by kind and recording.

    Parameters
    ----------
    number : (N,) group of each feature
    size : (G,) features of each group
    quiet : (G,) sums of squares that are noise; None: as many as are expected beside the modes by which a form is wrong
    kind : (G,) kind of their features; empty: any
    """

    number: Int
    size: Int
    quiet: Float | None = None
    kind: tuple[str, ...] = ()

    @classmethod
    def of(cls, session: Session, quiet: Float | None = None) -> Groups:
        """The groups of a session."""
        _, kind = np.unique(session.kind, return_inverse=True)
        _, first, number = np.unique(
            session.recording_of * (kind.max() + 1) + kind, return_index=True, return_inverse=True
        )
        return cls(number, np.bincount(number), quiet, tuple(np.asarray(session.kind)[first].tolist()))

    def are_of(self, kinds: Set[str]) -> Bool:
        """(G,) whether a group is of one of some kinds."""
        return np.array([kind in kinds for kind in self.kind] or [False] * self.size.size)

    @cached_property
    def order(self) -> Int:
        """(N,) places of the features, group by group."""
        return np.argsort(self.number, kind="stable")

    @property
    def modes(self) -> Float:
        """(G,) modes by which a form is wrong."""
        return np.minimum(self.size, RULES.form.modes)

    @property
    def noise(self) -> Float:
        """(G,) sums of squares that are noise."""
        return self.size - self.modes if self.quiet is None else self.quiet

    def sum_squares(self, values: Float) -> Float:
        """(G,) sums of squares of values (N,)."""
        return np.asarray(np.bincount(self.number, values**2, self.size.size), dtype=np.float64)


@dataclass(frozen=True)
class Peak:
    """The optimum of a linearised model under the mixture.

    Parameters
    ----------
    log_likelihood : with the terms of the priors
    covariance : (P, P) of the entries
    step : (P,) from where the model was linearised
    weight : (N,) of whitened residuals: 1 in groups within the noise
    odd : (G,) probabilities that a group is wrong by something that is not in the model
    """

    log_likelihood: float
    covariance: Float
    step: Float
    weight: Float
    odd: Float


@dataclass(frozen=True)
class Linearised:
    """A model about a point: whitened residuals, not weighted, and what priors add.

    Parameters
    ----------
    residual, jacobian : (N,) and (N, P)
    beside, beside_jacobian : (K,) and (K, P) deviations from priors in standard deviations
    """

    residual: Float
    jacobian: Float
    beside: Float
    beside_jacobian: Float

    @property
    def is_computed(self) -> bool:
        """Whether all of it is a number that squares can be taken of."""
        return bool(np.all(np.abs(self.residual) < LARGEST) and np.all(np.abs(self.jacobian) < LARGEST))

    @classmethod
    def of(cls, fit: ExtendedFit) -> Linearised:
        """A fitted model about its optimum."""
        n = fit.of.session.size
        jacobian = fit.solution.jacobian
        weight = fit.of.weight
        return cls(fit.misfit / weight, jacobian[:n] / weight[:, None], fit.solution.residual[n:], jacobian[n:])

    def extend(self, columns: Float) -> Linearised:
        """The model with further entries that change the predicted features by `columns` (N, K), each with a standard normal prior."""
        count, size = columns.shape[1], self.jacobian.shape[1]
        beside = [
            [self.beside_jacobian, np.zeros((self.beside.size, count))],
            [np.zeros((count, size)), np.eye(count)],
        ]
        return Linearised(
            self.residual,
            np.concatenate([self.jacobian, -columns], axis=1),
            np.concatenate([self.beside, np.zeros(count)]),
            np.block(beside),
        )


@dataclass(frozen=True)
class Mixture:
    """The mixture of variances by which groups may be missed, A of them, in ways: the form is wrong, a group drifts, something else is
    wrong, the noise is louder.

    Parameters
    ----------
    groups : of the features
    log_prior : (A, G) of each variance within its way, with what does not depend on the residual
    precision : (A, G) of the squares beyond the noise, of the `ways[-1]` rows of all squares
    ways : rows of each way
    believed : (K, ways, G) probabilities of the ways in each kind of session
    """

    groups: Groups
    log_prior: Float
    precision: Float
    ways: tuple[slice, ...]
    believed: Float

    @classmethod
    def of(cls, groups: Groups, trace: Float, *, noise_alone: bool) -> Mixture:
        """Parameters as in `score_groups`."""
        rules = RULES.form
        n, modes, noise = groups.size, groups.modes, groups.noise
        shares, louder = np.array(rules.shares), np.array(rules.louder)[:, None] ** 2
        slow = np.geomspace(1.0, rules.widest_drift, _PLACES)
        other = np.geomspace(rules.widest_drift, rules.widest, 0 if noise_alone else _MORE_PLACES)
        wide = np.concatenate([slow, other])
        variance = np.concatenate([
            np.zeros((1, n.size)),
            shares[:, None] ** 2 * trace * n / modes,
            np.broadcast_to(wide[:, None], (wide.size, n.size)),
        ])  # fmt: skip
        counts = 1 + shares.size, slow.size, other.size, louder.size
        ends = np.cumsum([0, *counts])
        ways = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))
        within = np.concatenate([np.full(count, -np.log(max(count, 1))) for count in counts[:-1]])
        each = within[:, None] - 0.5 * noise - 0.5 * modes * np.log1p(variance)
        # Forces over time drift by fewer modes; the others hold noise.
        few = np.where(groups.are_of(DRIFTING), np.minimum(n, rules.drift_modes), modes)
        drifting = 0.5 * (modes - few) * (np.log1p(variance[ways[_DRIFTS]]) - 1)
        each[ways[_DRIFTS]] += np.where(modes > few, drifting, 0.0)
        # In a calibration there is nothing that nobody has thought of, and no drift.
        each[counts[0] :, groups.are_of(CALIBRATIONS)] = np.log(_NEVER)
        noisy = -np.log(louder.size) - 0.5 * n * np.log(louder)
        precision = np.concatenate([1 / (1 + variance), np.broadcast_to(1 / louder, noisy.shape)])
        return cls(groups, np.concatenate([each, noisy]), precision, ways, _believe_ways(groups))

    def score(self, squares: Float) -> tuple[float, Float, Float]:
        """What `score_groups` returns, of sums of squares (G,)."""
        asked = np.repeat(np.maximum(squares - self.groups.noise, 0.0)[None], self.log_prior.shape[0], axis=0)
        asked[self.ways[-1]] = squares
        each = self.log_prior - 0.5 * asked * self.precision
        highest = each.max(axis=0)
        share = np.exp(each - highest)
        of_way = np.array([share[rows].sum(axis=0) for rows in self.ways])
        weighed = np.array([np.sum(share[rows] * self.precision[rows], axis=0) for rows in self.ways])
        # One kind of session for all groups: where many drift, another that does is no surprise.
        total = np.sum(self.believed * of_way, axis=1)
        of_kind = _log_kinds() + np.log(total).sum(axis=1)
        log = float(logsumexp(of_kind))
        kind = np.exp(of_kind - log)[:, None]
        odd = self.believed[:, _ODD] * of_way[_ODD]
        return (
            log + float(highest.sum()),
            np.sum(kind * np.sum(self.believed * weighed, axis=1) / total, axis=0),
            np.sum(kind * odd / total, axis=0),
        )


def _believe_ways(groups: Groups) -> Float:
    """(3, 4, G) probabilities of the ways in which a group may be missed, in a session of usual noise, one whose forces over time drift, and a
    noisy one."""
    rules = RULES.form
    drifts = np.where(groups.are_of(DRIFTING), rules.many, rules.drifting)
    rare = (rules.drifting, rules.noisy), (drifts, rules.noisy), (rules.drifting, rules.many)
    ones = np.ones(groups.size.size)
    return np.array([[(1 - d - rules.outlier - n) * ones, d * ones, rules.outlier * ones, n * ones] for d, n in rare])


def _log_kinds() -> Float:
    """(3,) log probabilities of these sessions."""
    other = RULES.form.session
    return np.log([1 - 2 * other, other, other])


def score_groups(groups: Groups, residual: Float, trace: Float, *, noise_alone: bool) -> tuple[float, Float, Float]:
    """Log likelihood of all groups, and the weight that a square has in each.

    Parameters
    ----------
    groups : of the features
    residual : (N,) whitened, not weighted
    trace : (G,) mean square of what the hypothesis changes in a group, beyond what film and rig absorb
    noise_alone : whether nothing but noise is wrong

    Returns
    -------
    Log likelihood, (G,) mean of 1/(1 + a): −2 times its slope over r², (G,) probabilities that a group is wrong by something else
    """
    return Mixture.of(groups, trace, noise_alone=noise_alone).score(groups.sum_squares(residual))


@dataclass(frozen=True)
class Products:
    """Products of the columns of a linearised model, summed over each group: all that the search of its peak has to know.

    Parameters
    ----------
    of_groups : (G, Q + 1, Q + 1) of the columns of the Jacobian and, last, the residual
    of_priors : (Q + 1, Q + 1) of the deviations from priors
    """

    of_groups: Float
    of_priors: Float

    @classmethod
    def of(cls, groups: Groups, model: Linearised) -> Products:
        """The products of a model."""
        columns = np.concatenate([model.jacobian, model.residual[:, None]], axis=1)
        parts = np.split(columns[groups.order], np.cumsum(groups.size)[:-1])
        beside = np.concatenate([model.beside_jacobian, model.beside[:, None]], axis=1)
        return cls(np.array([part.T @ part for part in parts]), beside.T @ beside)

    def scale_last(self, count: int, share: float) -> Products:
        """The model whose last `count` entries change that share of the features."""
        scale = np.ones(self.of_priors.shape[0])
        scale[-1 - count : -1] = share
        return Products(self.of_groups * np.outer(scale, scale), self.of_priors)


def find_peak(
    groups: Groups, of: Linearised | Products, trace: Float, moving: int, *, noise_alone: bool, stay: bool = False
) -> Peak:
    """The optimum of a linearised model under the mixture: least squares with weights that follow from what is left.

    Parameters
    ----------
    groups : of the features
    of : the model about a point, or its products
    trace, noise_alone : as in `score_groups`
    moving : number of entries, film and rig first, whose steps are bounded
    stay : whether the point itself is the optimum
    """
    products = of if isinstance(of, Products) else Products.of(groups, of)
    mixture = Mixture.of(groups, trace, noise_alone=noise_alone)
    step = np.zeros(products.of_priors.shape[0] - 1)
    best: tuple[float, Float, Float, Float, Float] | None = None
    for _ in range(1 if stay else _STEPS):
        at = np.append(step, 1.0)
        squares = np.maximum(products.of_groups @ at @ at, 0.0)
        score, weight, odd = mixture.score(squares)
        value = score - 0.5 * float(at @ products.of_priors @ at)
        normal = np.tensordot(weight, products.of_groups, axes=1) + products.of_priors
        covariance = _invert(normal[:-1, :-1])
        if best is None or value > best[0]:
            best = value, step, weight, odd, covariance
        slope = (normal @ at)[:-1]
        change = -covariance @ slope
        if -slope @ change < _SETTLED:
            break
        step = step + change * min(1.0, _LONGEST / max(float(np.abs(change[:moving]).max(initial=0.0)), 1e-12))
    assert best is not None
    value, step, weight, odd, covariance = best
    return Peak(value, covariance, step, np.sqrt(weight)[groups.number], odd)


def _invert(normal: Float) -> Float:
    """(P, P) inverse of a normal matrix, scaled to a diagonal of ones."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    return np.asarray(
        np.linalg.inv(normal / np.outer(scale, scale) + _RIDGE * np.eye(scale.size)) / np.outer(scale, scale)
    )


def measure_quiet(fits: Sequence[ExtendedFit]) -> Float:
    """(G,) sums of squares that are noise in the groups of a session: what is expected, or the least that a fit leaves where that is less.

    Parameters
    ----------
    fits : models of one session at their optima
    """
    groups = Groups.of(fits[0].of.session)
    left = [groups.sum_squares(Linearised.of(f).residual) for f in fits]
    return np.asarray(np.min([groups.noise, *left], axis=0))


def measure_trace(groups: Groups, absorbed: Float, change: Float) -> Float:
    """(G,) mean square of a change, beyond what film and rig absorb.

    Parameters
    ----------
    groups : of the features
    absorbed : (N, R) basis of what they absorb
    change : (N,) whitened
    """
    return groups.sum_squares(change - absorbed @ (absorbed.T @ change)) / groups.size


def find_absorbed(fit: ExtendedFit) -> Float:
    """(N, R) orthonormal basis of what film and rig of a fit absorb under the noise alone."""
    of = Linearised.of(fit)
    size = fit.of.model.size
    return orthonormalise(np.concatenate([of.jacobian[:, :size], of.beside_jacobian[:, :size]]))[: fit.of.session.size]
