"""Causes that compete for what one simple model leaves: judged by what they predict of a part that they were not fitted to.

For recordings that are asked alone: a large cycle, a system of another kind. There is no measured noise of other recordings to lean
on, and what is left has a long memory, so that sums of squares over the fitted part decide nothing. Does not belong here: the models
themselves, and how they are fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.results import AMBIGUOUS, NAMED, NONE, UNKNOWN, Estimate
from pipeline.diagnose.search.decide import EXPLAINED
from schemas.arrays import Float, Int

_LEVEL = 0.95


@dataclass(frozen=True)
class TriedModel:
    """A model with one cause, or none, in it.

    mechanism, form, equation : of the cause; empty for the plain model
    severity : key → estimate, from the fit to everything
    whole : (N,) simulation of everything, fitted to everything
    unseen : (H,) prediction of the part left out, fitted to the rest
    drawn : (B or 1, H) the same with parameters drawn from what the fit to the rest leaves open
    """

    mechanism: str
    variant: str
    equation: str
    severity: Mapping[str, Estimate]
    whole: Float
    unseen: Float
    drawn: Float


@dataclass(frozen=True)
class RankedModel:
    """An model's result.

    before, after : root mean square error on the part left out, plain model and this one, in units of the noise
    gain : share of the removable held-out error that it removes, `lower` to `upper` its 95 % interval
    explained : share of the misfit to everything that it explains, fitted to everything
    beaten : whether the best model predicts better by more than chance
    """

    model: TriedModel
    before: float
    after: float
    gain: float
    lower: float
    upper: float
    explained: float
    beaten: bool


@dataclass(frozen=True)
class Comparison:
    """All models, best first, and the verdict."""

    verdict: str
    ranked: tuple[RankedModel, ...]

    @property
    def possible(self) -> tuple[RankedModel, ...]:
        """Those that gain for certain and that the best does not beat."""
        return _possible(self.ranked)


def _possible(ranked: Sequence[RankedModel]) -> tuple[RankedModel, ...]:
    return tuple(p for p in ranked if p.lower > 0 and not p.beaten)


def compare_predictions(
    plain: TriedModel, models: Sequence[TriedModel], measured: Float, left_out: Float, sd: float
) -> Comparison:
    """Places of the models, and what they let one say.

    The part left out is one, and is no sample of anything, and the plain model's prediction of it is the one that was made: intervals
    are of what the fits to the rest leave open about the models.

    measured, left_out : (N,) everything, and (H,) the part left out; sd : of the noise of one value, the largest that it may be
    """
    size = left_out.size

    def error(model: TriedModel) -> tuple[float, Float]:
        """Mean square over the noise, and (B,) drawn."""
        drawn = np.mean(((model.drawn - left_out) / sd) ** 2, axis=1)
        return float(np.mean(((model.unseen - left_out) / sd) ** 2)), drawn

    before, _ = error(plain)
    removable = max(before - 1, 1 / size)
    misfit = float(np.mean(((plain.whole - measured) / sd) ** 2)) - 1
    found = [(model, *error(model)) for model in models]
    found.sort(key=lambda one: one[1])
    places = []
    for model, after, drawn in found:
        lower, upper = _take_interval((before - drawn) / removable)
        left = float(np.mean(((model.whole - measured) / sd) ** 2)) - 1
        worse, _ = _take_interval(drawn - found[0][2])
        places.append(
            RankedModel(
                model,
                float(np.sqrt(before)),
                float(np.sqrt(after)),
                (before - after) / removable,
                lower,
                upper,
                1 - left / max(misfit, 1 / size),
                worse > 0,
            )
        )
    ranked = tuple(places)
    return Comparison(_verdict(ranked, misfit > 0), ranked)


def _verdict(ranked: Sequence[RankedModel], misfit: bool) -> str:
    if not misfit:
        return NONE
    possible = _possible(ranked)
    if not possible or max(p.explained for p in possible) < EXPLAINED:
        return UNKNOWN
    return NAMED if len({p.model.mechanism for p in possible}) == 1 else AMBIGUOUS


def _take_interval(drawn: Float) -> tuple[float, float]:
    outside = (1 - _LEVEL) / 2
    low, high = np.quantile(drawn, [outside, 1 - outside])
    return float(low), float(high)


def _draw_blocks(size: int, memory: int, times: int, rng: np.random.Generator) -> Int:
    """(B, H) places of a part drawn anew in blocks, around its end (circular block bootstrap, Politis and Romano 1992)."""
    length = min(max(memory, 1), size)
    starts = rng.integers(0, size, (times, -(-size // length)))
    places = (starts[:, :, None] + np.arange(length)) % size
    return np.asarray(places.reshape(times, -1)[:, :size], dtype=np.int64)


def draw_parameters(jacobian: Float, residual: Float, memory: int, times: int, rng: np.random.Generator) -> Float:
    """(B, P) changes of parameters that the fit leaves open: its residual (N,) drawn anew in blocks, one step of the linear problem.

    jacobian : (N, P) of the residual. Directions that the data do not hold at all are left where they are.
    """
    chosen = _draw_blocks(residual.size, memory, times, rng)
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    solve = np.linalg.pinv(jacobian / scale, rcond=1e-6) / scale[:, None]
    return np.asarray((residual - residual.mean())[chosen] @ solve.T)
