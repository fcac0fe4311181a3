"""Survival of configurations from single lives: curves, numbers, comparisons, distributions, causes, laws over voltage.

What is asked of the curves most often, the survival at a given time, the view `survival_at` answers (`schemas.views`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.life_models import life_model_tables
from pipeline.analyse.life_plans import life_plan_table
from pipeline.fit.life_plan.known_lives import plan_campaigns
from pipeline.fit.survival.groups import SurvivalGroup, SurvivalResults, survival_group, usable_lives
from pipeline.fit.survival.turnbull import Turnbull
from pipeline.fit.survival.voltage_life import VoltageLife
from schemas.lifetimes import LifetimeRow
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


def analyse_survival(lives: Sequence[LifetimeRow]) -> Analysis:
    """Survival per campaign, configuration and voltage, comparisons, and what to test next, from all lives."""
    analysis = Analysis()
    results = analysis.attempt("survival", survival_group, lives)
    if results is not None:
        analysis.add(survival_tables(results))
    plans = analysis.attempt("plans of life tests", plan_campaigns, usable_lives(lives))
    if plans is not None:
        analysis.add({"life_plans": life_plan_table(plans)})
    return analysis


def survival_tables(results: SurvivalResults) -> dict[str, pa.Table]:
    """Tables `survival_curves`, `survival_summaries`, `survival_comparisons`, `survival_notes`, `lifetime_distributions`,
    `lifetime_quantiles`, `failure_causes`, `voltage_life`, `voltage_residuals` and those of `life_model_tables`.
    """
    made: dict[str, list[pa.Table]] = {
        "survival_curves": [_curve(group) for group in results.groups],
        "survival_summaries": [_summary(group) for group in results.groups],
        "survival_comparisons": [
            TABLES["survival_comparisons"].from_objects(
                results.comparisons, statistic_lower=lambda c: c.lower, statistic_upper=lambda c: c.upper
            )
        ],
        "lifetime_distributions": [_distributions(group) for group in results.groups],
        "lifetime_quantiles": [_quantiles(group) for group in results.groups],
        "survival_notes": [TABLES["survival_notes"].from_objects(results.notes, statement=lambda note: note.text)],
        "failure_causes": [cause for group in results.groups for cause in _causes(group)],
        "voltage_life": [_law(*law) for law in results.voltage_life],
        "voltage_residuals": [_residuals(*law) for law in results.voltage_life],
    }
    found = {name: TABLES[name].stack(parts) for name, parts in made.items()}
    return found | life_model_tables(results.life_models)


def _law(campaign: str | None, configuration: str | None, law: VoltageLife) -> pa.Table:
    return TABLES["voltage_life"].from_objects(
        [law],
        campaign=campaign,
        configuration=configuration,
        p_value=law.tests[-1].best_p_value if law.tests else None,
    )


def _residuals(campaign: str | None, configuration: str | None, law: VoltageLife) -> pa.Table:
    return TABLES["voltage_residuals"].from_objects(
        law.residuals,
        campaign=campaign,
        configuration=configuration,
        standardised_residual=lambda residual: residual.standardised,
    )


def _curve(group: SurvivalGroup) -> pa.Table:
    """The curve's rows, after a row at time 0 where nobody had failed yet (unless somebody did, at 0 s).

    Of Turnbull's curve nobody knows who failed at its times.
    """
    curve = group.curve
    if isinstance(curve, Turnbull):
        method, time, begins, counts = "turnbull", curve.ends, curve.begins, {}
    else:
        counts = {"failures": curve.failures, "censored": curve.censored}
        method, time, begins = "kaplan-meier", curve.time, curve.time
    lead = int(time[0] > 0)

    def column(first: float, values: np.ndarray) -> np.ndarray:
        return np.concatenate((np.full(lead, first, dtype=values.dtype), values))

    return TABLES["survival_curves"].arrays(
        time.size + lead,
        campaign=group.campaign,
        configuration=group.configuration,
        voltage_kv=group.voltage_kv,
        time_s=column(0.0, time),
        at_risk=column(curve.specimens, curve.at_risk),
        survival=column(1.0, curve.survival),
        lower_95=column(np.nan, curve.lower),
        upper_95=column(np.nan, curve.upper),
        method=method,
        from_s=column(0.0, begins),
        **{name: column(0, number) for name, number in counts.items()},
    )


def _summary(group: SurvivalGroup) -> pa.Table:
    return TABLES["survival_summaries"].from_objects(
        [group.summary],
        configuration=group.configuration,
        voltage_kv=group.voltage_kv,
        campaign=group.campaign,
    )


def _distributions(group: SurvivalGroup) -> pa.Table:
    return TABLES["lifetime_distributions"].rows(
        {
            "campaign": group.campaign,
            "configuration": group.configuration,
            "voltage_kv": group.voltage_kv,
            "distribution": fit.distribution,
            "parameter": name,
            "value": estimate.value,
            "lower_95": estimate.lower,
            "upper_95": estimate.upper,
            "log_likelihood": fit.log_likelihood,
            "aic": fit.aic,
            "distance": fit.goodness.distance if fit.goodness else None,
            "p_value": fit.goodness.p_value if fit.goodness else None,
            "statement": fit.goodness.statement if fit.goodness else None,
        }
        for fit in group.distributions
        for name, estimate in fit.parameters.items()
    )


def _quantiles(group: SurvivalGroup) -> pa.Table:
    return TABLES["lifetime_quantiles"].from_objects(
        group.quantiles,
        campaign=group.campaign,
        configuration=group.configuration,
        voltage_kv=group.voltage_kv,
    )


def _causes(group: SurvivalGroup) -> list[pa.Table]:
    return [
        TABLES["failure_causes"].arrays(
            cause.time.size,
            campaign=group.campaign,
            configuration=group.configuration,
            voltage_kv=group.voltage_kv,
            failure_site=cause.cause,
            time_s=cause.time,
            failures=cause.failures,
            probability=cause.probability,
            standard_error=cause.standard_error,
            lower_95=cause.lower,
            upper_95=cause.upper,
        )
        for cause in group.causes.causes
    ]
