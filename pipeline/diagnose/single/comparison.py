"""Models with one mechanism each, compared by what they predict of a part that they were not fitted to.

For records that are asked alone: a large cycle, a system of another kind. There is no measured noise of other
recordings to lean on, and what is left has a long memory, so that sums of squares over the fitted part decide nothing.
Does not belong here: the models themselves and how they are fitted, and the verdict (`pipeline.diagnose.judge`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.results import Estimate
from pipeline.diagnose.rules import RULES
from schemas.arrays import Float, Int


@dataclass(frozen=True)
class TriedModel:
    """A model with one mechanism, or none, in it.

    Parameters
    ----------
    mechanism, variant, equation : of the mechanism; empty for the plain model
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
    """How well a model predicts the part left out.

    Parameters
    ----------
    model : the model
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
    """All models with a mechanism, best prediction first.

    Parameters
    ----------
    misfit : mean square error of the plain model over everything, in units of the noise, less 1
    ranked : the models
    """

    misfit: float
    ranked: tuple[RankedModel, ...]

    @property
    def possible(self) -> tuple[RankedModel, ...]:
        """Those that gain for certain and that the best does not beat."""
        return tuple(p for p in self.ranked if p.lower > 0 and not p.beaten)


def compare_predictions(
    plain: TriedModel, models: Sequence[TriedModel], measured: Float, left_out: Float, sd: float
) -> Comparison:
    """Models ranked by what they predict of the part left out.

    Parameters
    ----------
    plain, models : the plain model, and those with a mechanism
    measured : (N,) everything
    left_out : (H,) the part left out
    sd : standard deviation of the noise of one value, the largest that it may be

    Notes
    ----- The part left out is one, and is no sample of anything, and the plain model's prediction of it is the one that
    was made: intervals are of what the fits to the rest leave open about the models.
    """
    size = left_out.size

    def measure_error(model: TriedModel) -> tuple[float, Float]:
        """Mean square over the noise, and (B,) of the predictions drawn."""
        drawn = np.mean(((model.drawn - left_out) / sd) ** 2, axis=1)
        return float(np.mean(((model.unseen - left_out) / sd) ** 2)), drawn

    before, _ = measure_error(plain)
    removable = max(before - 1, 1 / size)
    misfit = float(np.mean(((plain.whole - measured) / sd) ** 2)) - 1
    found = [(model, *measure_error(model)) for model in models]
    found.sort(key=lambda one: one[1])
    ranked = []
    for model, after, drawn in found:
        lower, upper = _take_interval((before - drawn) / removable)
        left = float(np.mean(((model.whole - measured) / sd) ** 2)) - 1
        worse, _ = _take_interval(drawn - found[0][2])
        ranked.append(
            RankedModel(
                model=model,
                before=float(np.sqrt(before)),
                after=float(np.sqrt(after)),
                gain=(before - after) / removable,
                lower=lower,
                upper=upper,
                explained=1 - left / max(misfit, 1 / size),
                beaten=worse > 0,
            )
        )
    return Comparison(misfit, tuple(ranked))


def _take_interval(drawn: Float) -> tuple[float, float]:
    outside = (1 - RULES.single.interval) / 2
    low, high = np.quantile(drawn, [outside, 1 - outside])
    return float(low), float(high)


def _draw_blocks(size: int, memory: int, times: int, rng: np.random.Generator) -> Int:
    """(B, H) places of a part drawn anew in blocks, around its end (circular block bootstrap, Politis and Romano 1992)."""
    length = min(max(memory, 1), size)
    starts = rng.integers(0, size, (times, -(-size // length)))
    places = (starts[:, :, None] + np.arange(length)) % size
    return np.asarray(places.reshape(times, -1)[:, :size], dtype=np.int64)


def draw_parameters(jacobian: Float, residual: Float, memory: int, times: int, rng: np.random.Generator) -> Float:
    """(B, P) changes of parameters that the fit leaves open: its residual (N,) drawn anew in blocks, one step of the
    linear problem.

    jacobian : (N, P) of the residual. Directions that the data do not hold at all are left where they are.
    """
    chosen = _draw_blocks(residual.size, memory, times, rng)
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    solve = np.linalg.pinv(jacobian / scale, rcond=1e-6) / scale[:, None]
    return np.asarray((residual - residual.mean())[chosen] @ solve.T)
