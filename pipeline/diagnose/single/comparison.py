"""Models with one mechanism each, compared by what they predict of a part that they were not fitted to.

For records that are asked alone: a large cycle, a system of another kind. There is no measured noise of other
recordings to lean on, and what is left has a long memory, so that sums of squares over the fitted part decide nothing.
Does not belong here: the models themselves and how they are fitted, and the verdict (`pipeline.diagnose.judge`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_law

from pipeline.diagnose.adequacy import Shortfall, combine
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
    nothing : the first of them where the mechanism does nothing
    at_limit, unresolved : whether the fit to everything ended at the largest severity that is searched, or at one that is finer than the
        samples tell
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
    nothing: float = 0.0
    at_limit: bool = False
    unresolved: bool = False


@dataclass(frozen=True)
class RankedModel:
    """How well a model predicts the part left out.

    Parameters
    ----------
    model : the model
    before, after : root mean square error on the part left out, plain model and this one, in units of the noise
    gain : share of the held-out squared error beyond the noise that it removes, `lower` to `upper` its 95 % interval; NaN where the plain
        model's error is within the noise: there is nothing to remove
    explained : share of the misfit to everything that it explains, fitted to everything; NaN where that is within the noise
    beaten : whether the best model predicts better by more than chance
    shortfall : what speaks against it, fitted to everything
    """

    model: TriedModel
    before: float
    after: float
    gain: float
    lower: float
    upper: float
    explained: float
    beaten: bool
    shortfall: Shortfall


@dataclass(frozen=True)
class Comparison:
    """All models with a mechanism, best prediction first.

    Parameters
    ----------
    p_value : of the plain model's misfit to everything, or where it is worst, under the noise alone
    ranked : the models
    """

    p_value: float
    ranked: tuple[RankedModel, ...]

    @property
    def possible(self) -> tuple[RankedModel, ...]:
        """Those that gain for certain and that the best does not beat."""
        return tuple(p for p in self.ranked if p.lower > 0 and not p.beaten)

    @property
    def told(self) -> RankedModel:
        """The one that is told: the best of those that are possible and that nothing speaks against, else of the possible, else of all."""
        possible = self.possible
        adequate = (p for p in possible if p.shortfall.is_adequate)
        return next(adequate, next(iter(possible), self.ranked[0]))


def compare_predictions(
    plain: TriedModel,
    models: Sequence[TriedModel],
    measured: Float,
    left_out: Float,
    sd: float,
    places: Sequence[float] = (),
) -> Comparison:
    """Models ranked by what they predict of the part left out.

    Parameters
    ----------
    plain, models : the plain model, and those with a mechanism
    measured : (N,) everything
    left_out : (H,) the part left out
    sd : standard deviation of the noise of one value, the largest that it may be
    places : p-values of the plain model's misfit in parts of everything

    Notes
    -----
    The part left out is one, and is no sample of anything, and the plain model's prediction of it is the one that was
    made: intervals are of what the fits to the rest leave open about the models. What errs less than the noise removes
    all that can be removed, no more.
    """
    chi2 = float(np.sum(((plain.whole - measured) / sd) ** 2))
    of_all = float(chi2_law.sf(chi2, measured.size))
    p_value = combine([of_all, *places])
    before = _measure_error(plain.unseen, left_out, sd)
    excess, misfit = _beyond_noise(before, left_out.size), _beyond_noise(chi2 / measured.size, measured.size)
    tried = [
        (model, _measure_error(model.unseen, left_out, sd), np.mean(((model.drawn - left_out) / sd) ** 2, axis=1))
        for model in models
    ]
    tried.sort(key=lambda one: one[1])
    ranked: list[RankedModel] = []
    for model, after, drawn in tried:
        gain = float(np.maximum(1 - max(after - 1, 0.0) / excess, -1.0))
        lower, upper = _take_interval(np.maximum(1 - np.maximum(drawn - 1, 0.0) / excess, -1.0))
        square = _measure_error(model.whole, measured, sd)
        left = max(square - 1, 0.0)
        worse, _ = _take_interval(drawn - tried[0][1])
        ranked.append(
            RankedModel(
                model=model,
                before=float(np.sqrt(before)),
                after=float(np.sqrt(after)),
                gain=gain,
                lower=min(lower, gain),
                upper=max(upper, gain),
                explained=float(np.maximum(1 - left / misfit, 0.0)),
                beaten=worse > 0 and bool(ranked),
                shortfall=Shortfall(
                    left=_share_left(_beyond_noise(square, measured.size), misfit),
                    at_limit=model.at_limit,
                    unresolved=model.unresolved,
                ),
            )
        )
    return Comparison(p_value, tuple(ranked))


def _beyond_noise(square: float, size: int) -> float:
    """Excess of a mean square over that of the noise; NaN where the noise may have made it."""
    excess = square - 1
    return excess if excess > RULES.gain.removable * np.sqrt(2 / size) else float("nan")


def _share_left(left: float, misfit: float) -> float:
    """Share of what is beyond the noise that a model leaves: 0 where it leaves noise (NaN), all where there was no more (NaN)."""
    if np.isnan(left):
        return 0.0
    return 1.0 if np.isnan(misfit) else left / misfit


def _measure_error(predicted: Float, measured: Float, sd: float) -> float:
    """Mean square error over that of the noise."""
    return float(np.mean(((predicted - measured) / sd) ** 2))


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
