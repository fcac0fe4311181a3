"""Smallest severities: what leaves no trace at all would never be found."""

from __future__ import annotations

import numpy as np

from pipeline.diagnose.search.detectable import find_smallest
from pipeline.diagnose.search.extended_model import Chosen
from pipeline.diagnose.search.screen import Signatures


def look_at(length: float) -> Signatures:
    """A relaxation at one point of its grid, of a signature so long."""
    chosen = (Chosen("power_law_relaxation", ""),)
    values = ({p.name: p.low for p in chosen[0].mechanism.parameters},)
    return Signatures(chosen, values, np.eye(1), np.array([length]), np.zeros(1), np.array([True]))


def test_what_further_arms_would_leave_nothing_of_is_not_detectable() -> None:
    assert "power_law_relaxation" in find_smallest(look_at(100.0), 10.0)
    assert "power_law_relaxation" not in find_smallest(look_at(0.0), 10.0)
