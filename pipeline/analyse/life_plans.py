"""The table of what to test next in each campaign."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from pipeline.fit.life_plan.known_lives import CampaignPlan
from schemas.numbers import finite_or_none
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


def life_plan_table(plans: Sequence[CampaignPlan]) -> pa.Table:
    """Table `life_plans`."""
    return TABLES["life_plans"].rows(row for one in plans for row in _rows(one))


def _rows(one: CampaignPlan) -> Iterator[dict[str, Any]]:
    about = {"campaign": one.campaign, "configuration": one.configuration}
    if one.rig is None or one.life_at_use is None:
        yield {**about, "plan": "none", "warnings": one.refused}
        return
    life = one.life_at_use
    for plan in one.plans:
        for test in plan.tests:
            yield {
                **about,
                "plan": plan.name,
                "voltage_kv": test.voltage_kv,
                "duration_s": 3600 * test.duration_h,
                "specimens": test.specimens,
                "expected_failures": test.failures,
                "rig_hours": test.hours,
                "use_kv": one.rig.use_kv,
                "failed_share": one.rig.failed_share,
                "life_at_use_s": life.value,
                "life_at_use_s_lower": life.lower,
                "life_at_use_s_upper": life.upper,
                "limits_ratio": finite_or_none(plan.factor),
                "worst_limits_ratio": finite_or_none(plan.worst_factor),
            }
