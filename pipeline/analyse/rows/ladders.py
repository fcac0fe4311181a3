"""Rows of `order_ladders`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pipeline.fit.relaxation.ladder import Rung
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


def ladder_table(specimen_id: str, rungs: Sequence[Rung]) -> dict[str, pa.Table]:
    """Rows of one specimen's ladder."""
    rows = (
        {
            "specimen_id": specimen_id,
            "model_order": rung.order,
            "resolved_arms": rung.resolved_arms,
            "relative_error": rung.relative_error,
            "r_squared_storage": rung.r_squared_storage,
            "r_squared_loss": rung.r_squared_loss,
            "r_squared_relaxation": rung.r_squared_relaxation,
            "order_p_value": rung.order_p_value,
        }
        for rung in rungs
    )
    return {"order_ladders": TABLES["order_ladders"].rows(rows)}
