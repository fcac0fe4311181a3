"""Which mechanism could explain what a fitted simulation leaves: signatures over grids, and their null distribution.

A signature is what a mechanism changes in all features when it is switched on at a severity: whitened, and with
everything taken off that film, rig and their priors can absorb. Secants at several severities stand for derivatives,
for effects with an onset have none. Under the null the scores along signatures are jointly normal, so that the
distribution of the best of all of them, looked at everywhere, follows from the signatures alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaincinv, ndtr

from pipeline.diagnose.features.kinds import AMPLIFIER
from pipeline.diagnose.mechanisms import MECHANISMS, Mechanism, Parameter
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Chosen, Extended, ExtendedFit, compose_chosen, orthonormalise
from schemas.arrays import Bool, Float

_DRAWS = 20_000
"""Draws of the null distribution."""
_VARIANCES = 64
"""Variances of the noise over which a probability is averaged, as likely each."""
_SEED = 20_260
"""Of these draws."""
_RANK = 1e-7
"""Eigenvalue of the correlation over the largest below which it is none."""


@dataclass(frozen=True)
class Signatures:
    """Signatures at the points of all grids; those that leave no trace are left out.

    Parameters
    ----------
    chosen, values : (G,) mechanism in its variant, and its parameters at each point
    correlation : (G, G) of the signatures
    length : (G,) in standard deviations of the noise
    score : (G,) of the fitted model's residual along them, each standard normal under the null
    weak : (G,) whether the change was taken at a small part of the severity
    """

    chosen: tuple[Chosen, ...]
    values: tuple[Mapping[str, float], ...]
    correlation: Float
    length: Float
    score: Float
    weak: Bool

    @cached_property
    def _factor(self) -> Float:
        """(G, K): scores under the null are this times independent standard normal numbers."""
        values, vectors = np.linalg.eigh(self.correlation)
        kept = values > _RANK * values[-1]
        return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))

    @cached_property
    def null(self) -> Float:
        """(draws,) sorted: Λ of the best point under the null."""
        rng = np.random.default_rng(_SEED)
        best = np.zeros(_DRAWS)
        for part in np.array_split(np.arange(_DRAWS), 20):
            scores = self._factor @ rng.normal(size=(self._factor.shape[1], part.size))
            best[part] = np.maximum(scores.max(axis=0), 0.0)
        return np.sort(best**2)

    def compute_p_in_doubt(self, statistic: float, spread: float) -> float:
        """The same where the variance of the noise is itself known to a relative standard deviation `spread`: the mean over it, as of a Γ."""
        variance = gammaincinv(spread**-2, (np.arange(_VARIANCES) + 0.5) / _VARIANCES) * spread**2
        return float(np.mean([self.compute_p(statistic / v) for v in variance]))

    def compute_p(self, statistic: float) -> float:
        """Probability that the best of all points reaches Λ by chance; beyond the draws the tail falls as that of a χ².

        Parameters
        ----------
        statistic : Λ
        """
        tail = float(np.mean(self.null >= statistic))
        known = self.null[int(0.998 * _DRAWS)]
        if statistic <= known:
            return max(tail, 1 / _DRAWS)
        return float(0.002 * np.exp(-(statistic - known) / 2))

    def reaches(self, statistic: float, level: float) -> bool:
        """Whether the probability of Λ under the null is at most `level`.

        Without draws where the probability of one point alone, or of all as if they were independent, decides it.
        """
        alone = float(ndtr(-np.sqrt(max(statistic, 0.0))))
        if alone > level or alone * self.length.size <= level:
            return alone <= level
        return self.compute_p(statistic) <= level

    def find_threshold(self, level: float) -> float:
        """Λ that the best of all points reaches by chance with probability `level`."""
        return float(np.quantile(self.null, 1 - level))


@dataclass(frozen=True)
class Score:
    """The best point of a mechanism in one variant.

    Parameters
    ----------
    chosen, values : mechanism in its variant, and its parameters there
    statistic : Λ, the fall of χ² along its signature
    share : part of the severity at which that fall is reached
    """

    chosen: Chosen
    values: Mapping[str, float]
    statistic: float
    share: float


@dataclass(frozen=True)
class Secants:
    """What mechanisms would change in the features, at the points of all grids.

    Parameters
    ----------
    chosen, values : (G,) mechanism in its variant, and its parameters at each point
    change : (N, G) whitened changes of all features
    weak : (G,) whether the change was taken at a small part of the severity, and scaled
    """

    chosen: tuple[Chosen, ...]
    values: tuple[Mapping[str, float], ...]
    change: Float
    weak: Bool


def renew_secants(found: Secants, fit: ExtendedFit) -> Secants:
    """Changes beside the lag of the amplifier: a gain behind a lag is not the gain before it. What the monitor's voltage does not show is
    as it was.

    Parameters
    ----------
    found : changes about the plain model
    fit : that model with the lag
    """
    kept = np.array([not c.mechanism.shows & AMPLIFIER for c in found.chosen], dtype=bool)
    anew = compute_secants(fit, AMPLIFIER)
    return Secants(
        (*itertools.compress(found.chosen, kept), *anew.chosen),
        (*itertools.compress(found.values, kept), *anew.values),
        np.concatenate([found.change[:, kept], anew.change], axis=1),
        np.concatenate([found.weak[kept], anew.weak]),
    )


def compute_secants(fit: ExtendedFit, kinds: Set[str] | None = None) -> Secants:
    """Changes about a fitted model by every visible mechanism that is not in it: the one costly step of a screen.

    Weak effects of either sign have central differences: what a small step leaves of the curvature is more than some
    mechanisms show.

    Parameters
    ----------
    fit : of the plain model, or of one with mechanisms
    kinds : of features of which one at least has to show a mechanism; None: any
    """
    of = fit.of
    base = of.predict(fit.x)

    def change(c: Chosen, values: Mapping[str, float], part: float) -> Float:
        own = scale_severities(c.mechanism, values, part)
        moved = of.simulation.predict(of.model, fit.theta, compose_chosen((*of.chosen, c), (*fit.values, own)))
        return np.asarray((moved - base) / part)

    rows: list[Float] = []
    chosen, values, weak = [], [], []
    opposite: dict[tuple[Chosen, tuple[float, ...]], Float] = {}
    places: dict[tuple[object, ...], list[int]] = {}
    for c, own, part in make_grid(of, {c.id for c in of.chosen}):
        if kinds is not None and not c.mechanism.shows & kinds:
            continue
        row = opposite.get((c, tuple(own.values())))
        if row is None:
            row = change(c, own, part)
            if part < 1 and _may_change_sign(c.mechanism, own):
                row = (row + change(c, own, -part)) / 2
                opposite[c, tuple(scale_severities(c.mechanism, own, -1.0).values())] = -row
        if not np.isfinite(row).all():
            continue
        # A variant that does here what an earlier one does is that one.
        point = c.id, tuple(own.values()), part
        if not any(np.array_equal(row, rows[i]) for i in places.get(point, ())):
            places.setdefault(point, []).append(len(rows))
            rows.append(row)
            chosen.append(c)
            values.append(own)
            weak.append(part < 1)
    changes = of.session.whiten(np.array(rows).T) if rows else np.zeros((of.session.size, 0))
    return Secants(tuple(chosen), tuple(values), changes, np.array(weak, dtype=bool))


def compute_signatures(found: Secants, fit: ExtendedFit) -> Signatures:
    """Secants as a fitted model sees them: weighted, and without what its entries absorb. Mechanisms that it has are
    left out.

    Parameters
    ----------
    found : changes about this model or one nearby
    fit : the model
    """
    held = {c.id for c in fit.of.chosen}
    open_ = np.array([i for i, c in enumerate(found.chosen) if c.id not in held], dtype=np.int64)
    seen = fit.of.weight[:, None] * found.change[:, open_]
    gram, along = project_out(fit, seen, make_absorbed_basis(fit))
    length = np.sqrt(np.maximum(np.diag(gram), 0.0))
    places = np.flatnonzero(length > np.maximum(RULES.alarm.visible, 1e-6 * np.sqrt(np.sum(seen**2, axis=0))))
    length = length[places]
    return Signatures(
        tuple(found.chosen[open_[i]] for i in places),
        tuple(found.values[open_[i]] for i in places),
        np.asarray(gram[np.ix_(places, places)] / np.outer(length, length)),
        length,
        np.asarray(along[places] / length),
        found.weak[open_][places],
    )


def find_best_scores(found: Signatures) -> tuple[Score, ...]:
    """The best point of each mechanism and variant, best first.

    A small part of a strong effect's change is not the change of a weak one, for which there is a point of its own: the
    score of a strong point counts where it stands for at least `alarm.least_part` of the severity.
    """
    along = np.maximum(found.score, 0.0)
    share = along / found.length
    best: dict[Chosen, int] = {}
    for i, c in enumerate(found.chosen):
        # A small part of a strong effect's change is not the change of a weak one: that has a point of its own.
        curved = not c.mechanism.onset and not found.weak[i] and share[i] < RULES.alarm.least_part
        if not curved and (c not in best or along[i] > along[best[c]]):
            best[c] = i
    result = [Score(c, found.values[i], float(along[i] ** 2), float(share[i])) for c, i in best.items()]
    return tuple(sorted(result, key=lambda s: -s.statistic))


def make_grid(of: Extended, held: set[str]) -> Iterator[tuple[Chosen, dict[str, float], float]]:
    """Points at which signatures are taken: of every visible mechanism its variants, severities and shapes.

    With each point goes the part of the severity at which the change is taken. It is small where a weak effect is asked
    for: what the model absorbs of a strong effect by curvature is not what it absorbs of a weak one.

    Parameters
    ----------
    of : the model
    held : ids of mechanisms that are left out
    """
    for id, mechanism in MECHANISMS.items():
        if id in held or not (mechanism.shows & of.session.kinds):
            continue
        for variant in mechanism.variants:
            shapes = mechanism.list_shapes(variant)
            places = [
                _place_shapes(p, RULES.alarm.shape_places[min(i, len(RULES.alarm.shape_places) - 1)])
                for i, p in enumerate(shapes)
            ]
            for severity, part in _list_severities(mechanism):
                for combination in itertools.product(*places):
                    own = dict(zip((p.name for p in shapes), combination, strict=True))
                    yield Chosen(id, variant), severity | own, part


def scale_severities(mechanism: Mechanism, values: Mapping[str, float], part: float) -> dict[str, float]:
    """Parameters with the severities multiplied by a part; shapes as they are."""
    names = {p.name for p in mechanism.severities}
    return {name: part * value if name in names else value for name, value in values.items()}


def _may_change_sign(mechanism: Mechanism, values: Mapping[str, float]) -> bool:
    """Whether the severities that are not 0 may be of either sign."""
    return all(p.signed for p in mechanism.severities if values[p.name] != 0)


def _place_shapes(p: Parameter, shares: tuple[float, ...]) -> list[float]:
    """Values of a shape at these parts of its plausible range."""
    if p.low == p.high:
        return [p.low]
    if p.log:
        return [float(p.low * (p.high / p.low) ** s) for s in shares]
    return [p.low + (p.high - p.low) * s for s in shares]


def _list_severities(mechanism: Mechanism) -> list[tuple[dict[str, float], float]]:
    """Values of each severity alone, the others 0, of both signs where both are possible; with the part at which each
    is taken."""
    found = []
    for p in mechanism.severities:
        for number, level in enumerate(np.geomspace(p.low, p.high, RULES.alarm.severity_levels)):
            part = RULES.alarm.weak_part if number == 0 and not mechanism.onset else 1.0
            for sign in (1.0, -1.0) if p.signed else (1.0,):
                if p.least <= sign * level <= p.most or not p.signed:
                    found.append(({q.name: 0.0 for q in mechanism.severities} | {p.name: sign * float(level)}, part))
    return found


def project_out(fit: ExtendedFit, seen: Float, absorbed: Float) -> tuple[Float, Float]:
    """What a fit cannot absorb of changes, as products.

    Parameters
    ----------
    fit : the model at its optimum
    seen : (N, G) weighted whitened changes
    absorbed : (M, P) basis of what the entries absorb

    Returns
    -------
    (G, G) products of the changes with each other, and (G,) with the residual
    """
    # The priors' rows see nothing of a change, but they hold back what absorbs it.
    coefficients = absorbed[: fit.of.session.size].T @ seen
    gram = seen.T @ seen - coefficients.T @ coefficients
    return gram, seen.T @ fit.misfit - coefficients.T @ (absorbed.T @ fit.solution.residual)


def make_absorbed_basis(fit: ExtendedFit) -> Float:
    """(M, P) orthonormal basis of what changes of a fit's entries can absorb; the priors in the last rows."""
    return orthonormalise(fit.solution.jacobian)
