"""Ladders of orders over wide bands: what each number of arms reaches, against a known number of arms."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.fit.relaxation.identify import fit_specimen
from pipeline.fit.relaxation.ladder import ladder, wants_ladder
from pipeline.fit.relaxation.order import LEVEL
from schemas.tables import TABLES
from tests.helpers.fit_truth import ACRYLATE, BAND, film, relaxation_curve, response

WIDE = np.logspace(-4, 4, 80)
TAUS = np.logspace(-4, 3, 8)
MASTER = (1.0, tuple([2.0] * 8), tuple(2.0 * TAUS))
"""Eight arms, one per decade."""


def test_enough_is_the_number_of_arms_that_there_are() -> None:
    rng = np.random.default_rng(seed=0)
    given = [response(WIDE, film(WIDE, MASTER), rng)]
    fits = fit_specimen(given)
    assert wants_ladder(fits)
    rungs = ladder(given, orders=(1, 2, 4, 8, 10))
    error = np.array([r.relative_error for r in rungs])
    assert np.all(np.diff(error) < 1e-3)
    needed = [r.order_p_value is None or r.order_p_value < LEVEL for r in rungs]
    assert needed == [True, True, True, False, False]
    eight = rungs[3]
    assert eight.relative_error == pytest.approx(0.01, rel=0.15)  # the noise
    assert eight.r_squared_storage == pytest.approx(1.0, abs=1e-3)
    assert eight.r_squared_loss > 0.9
    assert eight.r_squared_relaxation is None
    assert rungs[0].relative_error > 0.3


def test_curves_in_time_have_their_own_share() -> None:
    model = (1.0, (2.0, 1.0), (0.2, 10.0))
    (rung,) = ladder([], relaxations=[relaxation_curve(model, np.random.default_rng(seed=1))], orders=(2,))
    assert rung.r_squared_storage is None
    assert rung.r_squared_loss is None
    assert rung.r_squared_relaxation > 0.99
    (row,) = TABLES["order_ladders"].from_objects((rung,), specimen_id="s").to_pylist()
    assert (row["specimen_id"], row["model_order"], row["r_squared_loss"]) == ("s", 2, None)
    assert row["r_squared_relaxation"] == rung.r_squared_relaxation


def test_a_sweep_needs_no_ladder() -> None:
    rng = np.random.default_rng(seed=2)
    assert not wants_ladder(fit_specimen([response(BAND, film(BAND, ACRYLATE), rng)]))
    narrow = fit_specimen([response(BAND, film(BAND, MASTER), rng)], orders=(1,))
    assert narrow.selected.order_p_value < 0.01
    assert not wants_ladder(narrow)  # many arms, but two decades
    enough = fit_specimen([response(WIDE, film(WIDE, (1.0, (4.0,), (0.1,))), rng)])
    assert not wants_ladder(enough)  # eight decades, but one arm
