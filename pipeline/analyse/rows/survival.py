"""Results of the survival analysis as arrow tables.

What the tables answer, for instance the survival at 60 s of each configuration: the last row up to that time,

    SELECT configuration, voltage_kv, arg_max(survival, time_s) AS survival_60,
           arg_max(lower_95, time_s) AS lower_95, arg_max(upper_95, time_s) AS upper_95
    FROM survival_curves WHERE time_s <= 60 GROUP BY ALL

`survival_curves` has a row at time 0 for it (all at risk, survival 1). A configuration whose curve ends before 60 s with
survivors does not say what comes later; `HAVING max(time_s) ...` is not enough to see that, so join the curve's end:

    WITH ends AS (SELECT configuration, voltage_kv, max(time_s) AS seen_to_s, min(survival) AS last
                  FROM survival_curves GROUP BY ALL)
    SELECT c.configuration, c.voltage_kv, CASE WHEN seen_to_s >= 60 OR last = 0 THEN arg_max(survival, time_s) END
    FROM survival_curves c JOIN ends e ON c.configuration IS NOT DISTINCT FROM e.configuration
         AND c.voltage_kv IS NOT DISTINCT FROM e.voltage_kv
    WHERE time_s <= 60 GROUP BY c.configuration, c.voltage_kv, seen_to_s, last
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.analyse.rows.recordings import joined
from pipeline.fit.survival.groups import SurvivalGroup, SurvivalResults
from pipeline.fit.survival.kaplan_meier import Estimate
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


def survival_tables(results: SurvivalResults) -> dict[str, pa.Table]:
    """Tables `survival_curves`, `survival_summaries`, `survival_comparisons`, `lifetime_distributions`,
    `failure_causes`, `voltage_life` and `voltage_residuals`.
    """
    made: dict[str, list[dict[str, Any]]] = {
        "survival_summaries": [_summary(group) for group in results.groups],
        "survival_comparisons": [
            {
                "configuration_a": c.configuration_a,
                "configuration_b": c.configuration_b,
                "voltage_kv": c.voltage_kv,
                "test": c.test,
                "statistic": c.statistic,
                "statistic_lower": c.lower,
                "statistic_upper": c.upper,
                "p_value": c.p_value,
                "p_value_holm": c.p_value_holm,
                "warnings": joined(c.warnings),
            }
            for c in results.comparisons
        ],
        "lifetime_distributions": [row for group in results.groups for row in _distributions(group)],
        "voltage_life": [],
        "voltage_residuals": [],
    }
    for configuration, law in results.voltage_life:
        made["voltage_life"].append(
            {
                "configuration": configuration,
                "specimens": law.specimens,
                "failures": law.failures,
                **bounded("intercept", law.intercept),
                **bounded("exponent", law.exponent),
                **bounded("sigma", law.sigma),
                "log_likelihood": law.log_likelihood,
                "p_value": law.tests[-1].best_p_value if law.tests else None,
                "holds": law.holds,
                "statement": law.statement,
                "warnings": joined(law.warnings),
            }
        )
        made["voltage_residuals"] += [
            {
                "configuration": configuration,
                "voltage_kv": r.voltage_kv,
                "specimens": r.specimens,
                "failures": r.failures,
                "scale_s": r.scale_s,
                "law_scale_s": r.law_scale_s,
                "residual": r.residual,
                "standardised_residual": r.standardised,
                "p_value_without": r.p_value_without,
            }
            for r in law.residuals
        ]
    tables = {name: TABLES[name].rows(rows) for name, rows in made.items()}
    tables["survival_curves"] = _stacked("survival_curves", [_curve(group) for group in results.groups])
    causes = [cause for group in results.groups for cause in _causes(group)]
    tables["failure_causes"] = _stacked("failure_causes", causes)
    return tables


def _stacked(name: str, parts: Sequence[pa.Table]) -> pa.Table:
    import pyarrow as pa

    return pa.concat_tables(parts) if parts else TABLES[name].empty()


def _curve(group: SurvivalGroup) -> pa.Table:
    """The Kaplan–Meier rows, after a row at time 0 where nobody had failed yet (unless somebody did, at 0 s)."""
    curve = group.curve
    lead = int(curve.time[0] > 0)

    def column(first: float, values: np.ndarray) -> np.ndarray:
        return np.concatenate((np.full(lead, first, dtype=values.dtype), values))

    return TABLES["survival_curves"].arrays(
        curve.time.size + lead,
        configuration=group.configuration,
        voltage_kv=group.voltage_kv,
        time_s=column(0.0, curve.time),
        at_risk=column(curve.specimens, curve.at_risk),
        failures=column(0, curve.failures),
        censored=column(0, curve.censored),
        survival=column(1.0, curve.survival),
        lower_95=column(np.nan, curve.lower),
        upper_95=column(np.nan, curve.upper),
    )


def _summary(group: SurvivalGroup) -> dict[str, Any]:
    summary = group.summary
    return {
        "configuration": group.configuration,
        "voltage_kv": group.voltage_kv,
        "specimens": summary.specimens,
        "failures": summary.failures,
        "restricted_to_s": summary.restricted_to_s,
        **bounded("restricted_mean_s", summary.restricted_mean_s),
        **bounded("median_s", summary.median_s),
        **bounded("survival_at_end", summary.survival_at_end),
        **bounded("weibull_shape", summary.weibull_shape),
        **bounded("weibull_scale_s", summary.weibull_scale_s),
        "warnings": joined(summary.warnings),
        "campaign": ", ".join(group.campaigns) or None,
    }


def _distributions(group: SurvivalGroup) -> list[dict[str, Any]]:
    return [
        {
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
    ]


def _causes(group: SurvivalGroup) -> list[pa.Table]:
    return [
        TABLES["failure_causes"].arrays(
            cause.time.size,
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


def bounded(name: str, estimate: Estimate) -> dict[str, float]:
    """The columns `name`, `name_lower` and `name_upper`."""
    return {name: estimate.value, f"{name}_lower": estimate.lower, f"{name}_upper": estimate.upper}
