"""Holds of displacement after ramps of any speed, as the diagnosis reads them."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.diagnose.features.ramp import _holds


@pytest.mark.parametrize("ramp", [40, 400, 4_000, 12_000], ids=lambda n: f"{n} samples")
def test_a_hold_is_found_however_slow_its_ramp(ramp: int) -> None:
    """A ramp over a tenth of the record moved less between neighbours than counted as moving: "0 windows while the step is held"."""
    rest, count = 2_000, 40_000
    x = np.clip((np.arange(count) - rest) / ramp, 0, 1) + np.random.default_rng(seed=1).normal(0, 1e-4, count)
    ((begin, held, end),) = _holds(x, rest)
    assert begin == pytest.approx(rest, abs=0.1 * ramp + 30)
    assert held == pytest.approx(rest + ramp, abs=0.1 * ramp + 30)
    assert end >= count - 2
