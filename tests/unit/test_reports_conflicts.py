"""What a campaign's page holds against the thesis, of films of any geometry."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from reports.pages.campaign import conflicts


@pytest.mark.parametrize(("active_mm", "has_factor"), [(20.0, True), (75.0, False), (None, False)])
def test_an_electrode_over_the_whole_length_has_no_factor(active_mm: float | None, has_factor: bool) -> None:
    sizes = [{"specimen_id": "A", "total_mm": 75.0, "active_mm": active_mm}]
    draft = SimpleNamespace(item="campaign", results=SimpleNamespace(rows=lambda query: sizes))
    fit = {
        "specimen_id": "A", "modulus_mpa": 0.16, "modulus_mpa_sd": 0.01, "nonlinearity": 0.1, "mechanical_modulus_mpa": None,
    }  # fmt: skip
    row = conflicts._factor(cast(Any, draft), [fit])
    assert row is not None
    assert ("with the factor" in str(row.cells[-1])) == has_factor
