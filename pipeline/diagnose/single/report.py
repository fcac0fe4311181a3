"""A comparison of models as a diagnosis: for records that are asked without a session.

Does not belong here: which models are compared, and what they are fitted to (`cycle_diagnosis`, `system_diagnosis`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.diagnose.results import (
    AMBIGUOUS,
    NAMED,
    NONE,
    Diagnosis,
    Discrepancy,
    Extension,
    HeldOut,
    NextRecording,
    Residuals,
)
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.single.comparison import Comparison, RankedModel, TriedModel
from pipeline.physics.film import RelaxationModel
from schemas.arrays import Float
from schemas.assumptions import Assumption
from schemas.mechanisms import UNLISTED, plain_name
from schemas.numbers import capital, with_unit


@dataclass(frozen=True)
class Films:
    """The film in the plain and in the extended model, with standard deviations of k0, k…, τ…, and of the dampers."""

    plain: RelaxationModel
    extended: RelaxationModel
    plain_sd: tuple[float, ...] = ()
    extended_sd: tuple[float, ...] = ()
    damper_sd: tuple[float, ...] = ()


@dataclass(frozen=True)
class Details:
    """What is known of a record beside the comparison; fields that `Diagnosis` has as well mean the same.

    Parameters
    ----------
    left_out : what was left out, in words → root mean square error of the plain and of the best model
    films : the film in both models
    smallest : mechanism → key → smallest detectable severity
    unexplained : what is left in words: by the best mechanism, or by the plain model where no mechanism has a name
    assumed : recording → what is taken for granted of it
    """

    specimen_id: str
    protocols: tuple[str, ...]
    left_out: Mapping[str, tuple[float, float]]
    films: Films
    discrepancies: tuple[Discrepancy, ...]
    residuals: tuple[Residuals, ...]
    smallest: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    invisible: tuple[str, ...] = ()
    could_not_ask: tuple[str, ...] = ()
    unexplained: tuple[str, ...] = ()
    next_recording: NextRecording | None = None
    assumed: Mapping[str, tuple[Assumption, ...]] = field(default_factory=dict)


def report_comparison(
    comparison: Comparison,
    verdict: str,
    measured: Float,
    left_out: Float,
    sd: float,
    plain: Float,
    details: Details,
) -> Diagnosis:
    """The diagnosis that a comparison of models leads to.

    Parameters
    ----------
    comparison, verdict : the models by what they predict, and what was concluded
    measured, plain : (N,) everything, and the plain model's fit to it
    left_out : (H,) the parts left out
    sd : standard deviation of the noise of one value
    details : what is known beside
    """
    best = comparison.told
    chi2 = float(np.sum(((measured - plain) / sd) ** 2))
    found = verdict in (NAMED, AMBIGUOUS)
    possible = dict.fromkeys(p.model.mechanism for p in comparison.possible)
    others = tuple(m for m in possible if m != best.model.mechanism)
    if not best.shortfall.is_adequate:
        others = (*others, UNLISTED)
    return Diagnosis(
        specimen_id=details.specimen_id,
        verdict=verdict,
        mechanisms=(best.model.mechanism,) if found else (),
        also_possible=others if verdict == AMBIGUOUS else (),
        p_value=comparison.p_value,
        supported_by=details.protocols if found else (),
        held_out=HeldOut(best.before, best.after, best.gain, best.lower, best.upper, left_out.size, details.left_out)
        if found
        else None,
        extension=_report_extension(best, measured, sd, chi2, details.films) if found else None,
        candidates=(),
        discrepancies=details.discrepancies,
        next_recording=details.next_recording if verdict == AMBIGUOUS else None,
        smallest_detectable=details.smallest,
        invisible=details.invisible,
        could_not_ask=details.could_not_ask,
        unexplained=() if verdict == NONE else details.unexplained,
        plain_film=details.films.plain,
        residuals=details.residuals,
        explained=best.explained if found else float("nan"),
        assumed=details.assumed,
    )


def _report_extension(best: RankedModel, measured: Float, sd: float, chi2: float, films: Films) -> Extension:
    model = best.model
    return Extension(
        severities={model.mechanism: model.severity},
        variants={model.mechanism: model.variant},
        film=films.extended,
        film_sd=films.extended_sd,
        damper_sd=films.damper_sd,
        plain_film=films.plain,
        plain_film_sd=films.plain_sd,
        chi2=float(np.sum(((measured - model.whole) / sd) ** 2)),
        plain_chi2=chi2,
        size=measured.size,
    )


def list_smallest(models: Iterable[TriedModel]) -> dict[str, dict[str, float]]:
    """Mechanism → main key → severity that stands out of what the fit to everything leaves open, of its first variant."""
    found: dict[str, dict[str, float]] = {}
    for model in models:
        for key, estimate in list(model.severity.items())[:1]:
            if np.isfinite(estimate.sd) and estimate.sd > 0:
                away = RULES.single.detectable * estimate.sd
                found.setdefault(model.mechanism, {key: abs(model.nothing - away)})
    return found


def describe_what_stays(words: str, residual: Float, sd: float, unit: str) -> str:
    """What a mechanism leaves, in words: how much, and how much of it neighbours have in common.

    Parameters
    ----------
    words : the model
    residual : (N,) of the fit to everything, in `unit`
    sd : standard deviation of the noise
    """
    correlation = float(residual[1:] @ residual[:-1] / max(float(residual @ residual), 1e-300))
    left = with_unit(f"{np.sqrt(np.mean(residual**2)):.3g}", name_unit(unit))
    return (
        f"{words}, fitted to everything, leaves {left}, "
        f"{np.sqrt(np.mean((residual / sd) ** 2)):.2g} times the noise, of which neighbours have {correlation:.3f} in common"
    )


def describe_closest(comparison: Comparison) -> tuple[str, ...]:
    """Why the cause that predicts best has no name, in words; nothing where no cause is possible, or nothing speaks against it.

    Parameters
    ----------
    comparison : of the models
    """
    told = comparison.told
    against = told.shortfall.describe()
    if told not in comparison.possible or not against:
        return ()
    form = f" ({told.model.variant})" if told.model.variant else ""
    return (f"{capital(plain_name(told.model.mechanism))}{form} comes closest, but {against}",)


def name_unit(unit: str) -> str:
    """A unit as it stands behind a number: nothing for what has none."""
    return "" if unit == "1" else unit


def thin_curves(values: Sequence[Float], most: int) -> list[Float]:
    """Every so many values of arrays of one length, `most` of each."""
    return [v[:: max(1, -(-v.size // most))] for v in values]
