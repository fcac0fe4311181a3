"""Tables of the life regressions of each campaign."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.fit.survival.kaplan_meier import Estimate
from pipeline.fit.survival.life_models import NO_FAMILY, CampaignLives, LifeModel
from pipeline.fit.survival.life_regression import FAMILIES
from schemas.numbers import p_equals, significant
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

_BATCHES_AT_RANDOM = "batches at random"
_OWN_LOCATIONS = "location per group"


def life_model_tables(campaigns: Sequence[CampaignLives]) -> dict[str, pa.Table]:
    """The tables of regressions, coefficients, groups, lines, residuals, modes, proportionality, limits and batches."""
    made = {
        "life_regressions": _regressions,
        "life_coefficients": _coefficients,
        "life_group_fits": _groups,
        "life_lines": _lines,
        "life_residuals": _residuals,
        "mode_effects": _modes,
        "proportionality_tests": _proportionality,
        "endurance_limits": _limits,
        "batch_scatter": _batch_scatter,
        "batch_effects": _batch_effects,
    }
    return {name: TABLES[name].rows([row for one in campaigns for row in rows(one)]) for name, rows in made.items()}


def _bounded(name: str, estimate: Any) -> dict[str, float | None]:
    if estimate is None:
        return {}
    return {name: estimate.value, f"{name}_lower": estimate.lower, f"{name}_upper": estimate.upper}


def _regressions(one: CampaignLives) -> list[dict[str, Any]]:
    warnings = "; ".join(one.refused) or None
    if not one.models:
        failures = sum(row.failed for row in one.rows)
        return [
            {
                "campaign": one.campaign,
                "family": NO_FAMILY,
                "specimens": len(one.rows),
                "failures": failures,
                "warnings": warnings,
            }
        ]
    return [_regression(one, model, warnings) for model in one.models]


def _regression(one: CampaignLives, model: LifeModel, warnings: str | None) -> dict[str, Any]:
    fit = model.regression
    own = next((test.p_value for test in fit.tests if test.against == _OWN_LOCATIONS), None)
    tests = (
        f"{'against ' if test.against == _OWN_LOCATIONS else '' if test.against in FAMILIES else 'without '}"
        f"{test.against}: likelihood ratio {significant(test.statistic)}, {test.degrees_of_freedom} d.f., "
        f"{p_equals(test.p_value)}"
        for test in fit.tests
    )
    return {
        "campaign": one.campaign,
        "family": fit.family,
        "stress_law": model.stress_law or None,
        "chosen": model.chosen,
        "specimens": fit.specimens,
        "failures": fit.failures,
        **_bounded("sigma", fit.sigma),
        **_bounded("shape", fit.shape),
        "log_likelihood": fit.log_likelihood,
        "aic": fit.aic,
        "p_value": own,
        "tests": "; ".join(tests) or None,
        "method": fit.method,
        "warnings": warnings if model.chosen else None,
    }


def _coefficients(one: CampaignLives) -> list[dict[str, Any]]:
    rows = [
        {
            "campaign": one.campaign,
            "family": model.regression.family,
            "stress_law": model.stress_law or None,
            "coefficient": found.name,
            **_kind_of(one, found.name, model.stress_law),
            **_bounded("value", found.value),
            "standard_error": found.standard_error,
            "p_value": found.p_value,
            **(_factor(one, found.name, found.value) if model.chosen else {}),
        }
        for model in one.models
        for found in model.regression.coefficients
    ]
    chosen = one.chosen
    for effect in one.batches.coefficients if one.batches else ():
        rows.append(
            {
                "campaign": one.campaign,
                "family": _BATCHES_AT_RANDOM,
                "stress_law": (one.models[0].stress_law if one.models else "") or None,
                "coefficient": effect.name,
                **_bounded("value", effect.value),
                "standard_error": effect.standard_error,
            }
        )
    if one.cox is None or chosen is None:
        return rows
    for hazard in one.cox.effects:
        rows.append(
            {
                "campaign": one.campaign,
                "family": "cox",
                "stress_law": chosen.stress_law or None,
                "coefficient": hazard.name,
                **_bounded("value", hazard.value),
                "standard_error": hazard.standard_error,
                "p_value": hazard.p_value,
                **_factor(one, hazard.name, hazard.value),
            }
        )
    return rows


def _kind_of(one: CampaignLives, coefficient: str, stress_law: str) -> dict[str, Any]:
    """Law and unit of the covariate that a coefficient is of, the voltage by the law of its model."""
    for covariate in one.covariates:
        if coefficient == covariate.name or (covariate.is_category and coefficient.startswith(f"{covariate.name}: ")):
            law = stress_law if covariate.name == "voltage_kv" else covariate.law
            return {"law": law, "unit": covariate.unit or None}
    return {}


def _factor(one: CampaignLives, coefficient: str, value: Estimate) -> dict[str, Any]:
    """The effect of a coefficient over the contrast of its covariate, as a factor."""
    for contrast in one.contrasts:
        if contrast.coefficient == coefficient:
            with np.errstate(over="ignore"):  # of a handful of lives a limit may be no number at all
                ends = sorted(np.exp(contrast.change * np.array([value.lower, value.upper])).tolist())
            factor = Estimate(float(np.exp(contrast.change * value.value)), *ends)
            return {"contrast": contrast.words, **_bounded("factor", factor)}
    return {}


def _groups(one: CampaignLives) -> list[dict[str, Any]]:
    if one.chosen is None:
        return []
    points = {point.group: point for point in one.group_points}
    rows = []
    for group in one.chosen.regression.groups:
        point = points.get(group.name)
        rows.append(
            {
                "campaign": one.campaign,
                "conditions": group.name,
                "specimens": group.specimens,
                "failures": group.failures,
                "expected_failures": group.expected,
                "factor": group.factor,
                "p_value": group.p_value,
                "stress": point and point.stress,
                "stress_value": point and point.value,
                "life_s": point and point.life_s,
                "category": point and point.category,
                "line_life_s": point and point.line_life_s,
            }
        )
    return rows


def _lines(one: CampaignLives) -> list[dict[str, Any]]:
    return [
        {
            "campaign": one.campaign,
            "category": point.group,
            "stress": point.stress,
            "stress_law": point.stress_law,
            "stress_unit": point.stress_unit or None,
            "stress_value": point.value,
            **_bounded("life_s", point.life_s),
            "extrapolated": point.is_extrapolated,
        }
        for point in one.points
    ]


def _residuals(one: CampaignLives) -> list[dict[str, Any]]:
    if one.chosen is None:
        return []
    fit = one.chosen.regression
    return [
        {
            "campaign": one.campaign,
            "specimen_id": row.specimen_id,
            "conditions": conditions,
            "failed": row.failed,
            "cox_snell": hazard,
            "deviance": deviance,
            "observed_hazard": observed,
        }
        for row, conditions, hazard, deviance, observed in zip(
            one.rows, one.conditions, fit.cox_snell, fit.deviance, one.observed_hazards, strict=True
        )
    ]


def _proportionality(one: CampaignLives) -> list[dict[str, Any]]:
    return [
        {
            "campaign": one.campaign,
            "covariate": test.covariate,
            "trend": test.trend,
            "statistic": test.statistic,
            "degrees_of_freedom": test.degrees_of_freedom,
            "p_value": test.p_value,
        }
        for test in one.proportionality
    ]


def _limits(one: CampaignLives) -> list[dict[str, Any]]:
    found = one.limit
    if found is None:
        return []
    return [
        {
            "campaign": one.campaign,
            "stress": found.stress,
            "family": found.family,
            **_bounded("stress_limit", found.limit),
            "exponent": found.exponent,
            "statistic": found.statistic,
            "p_value": found.p_value,
        }
    ]


def _batch_scatter(one: CampaignLives) -> list[dict[str, Any]]:
    found = one.batches
    if found is None:
        return []
    return [
        {
            "campaign": one.campaign,
            "family": found.family,
            "batches": len(found.batches),
            **_bounded("tau", found.tau),
            "sigma": found.sigma,
            "log_likelihood": found.log_likelihood,
            "statistic": found.statistic,
            "p_value": found.p_value,
        }
    ]


def _batch_effects(one: CampaignLives) -> list[dict[str, Any]]:
    return [
        {
            "campaign": one.campaign,
            "batch": batch.name,
            "specimens": batch.specimens,
            "failures": batch.failures,
            **_bounded("factor", batch.factor),
        }
        for batch in (one.batches.batches if one.batches else ())
    ]


def _modes(one: CampaignLives) -> list[dict[str, Any]]:
    return [
        {
            "campaign": one.campaign,
            "failure_mode": found.mode,
            "model": model,
            "coefficient": effect.name,
            "failures": found.failures,
            **_bounded("value", effect.value),
            "standard_error": effect.standard_error,
            "p_value": effect.p_value,
        }
        for found in one.modes
        for model, regression in (("cause-specific", found.cause_specific), ("fine-gray", found.fine_gray))
        for effect in regression.effects
    ]
