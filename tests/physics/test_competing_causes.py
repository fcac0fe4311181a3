"""Aalen–Johansen against lifelines, a closed form and simulation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.fit.survival.competing_causes import UNKNOWN_CAUSE, aalen_johansen
from pipeline.fit.survival.kaplan_meier import kaplan_meier
from schemas.errors import RefusedError

SITES = {0: None, 1: "rod", 2: "lead", 3: ""}


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 3)), min_size=1, max_size=60))
def test_causes_and_survival_add_up_to_one(rows: list[tuple[int, int]]) -> None:
    time = np.array([float(t) for t, _ in rows])
    codes = np.array([c for _, c in rows])
    found = aalen_johansen(time, codes > 0, [SITES[c] for c in codes.tolist()])
    total = sum((curve.probability for curve in found.causes), start=np.zeros_like(found.survival)) + found.survival
    np.testing.assert_allclose(total, 1, atol=1e-12)
    assert [curve.cause for curve in found.causes] == sorted({SITES[c] or UNKNOWN_CAUSE for c in codes.tolist() if c})
    np.testing.assert_allclose(found.survival, kaplan_meier(time, codes > 0).survival, atol=1e-14)
    for curve in found.causes:
        assert np.all(np.diff(curve.probability) >= 0)
        inside = ~np.isnan(curve.lower)
        assert np.all(curve.lower[inside] <= curve.probability[inside] + 1e-12)
        assert np.all(curve.upper[inside] >= curve.probability[inside] - 1e-12)


def test_without_censoring_it_is_the_share_of_failures() -> None:
    time = np.array([1.0, 2, 3, 4, 5])
    found = {c.cause: c for c in aalen_johansen(time, np.ones(5), ["rod", "lead", "rod", "rod", None]).causes}
    np.testing.assert_allclose(found["rod"].probability, [0.2, 0.2, 0.4, 0.6, 0.6])
    np.testing.assert_allclose(found["lead"].probability, [0, 0.2, 0.2, 0.2, 0.2])
    np.testing.assert_allclose(found["unknown"].probability[-1], 0.2)
    share = found["rod"].probability[:-1]
    np.testing.assert_allclose(found["rod"].standard_error[:-1], np.sqrt(share * (1 - share) / 5), rtol=1e-12)


def test_one_minus_kaplan_meier_would_overstate() -> None:
    rng = np.random.default_rng(seed=0)
    time = rng.exponential(1.0, 200)
    codes = rng.integers(1, 3, 200)
    rod = next(
        c for c in aalen_johansen(time, codes > 0, [SITES[c] for c in codes.tolist()]).causes if c.cause == "rod"
    )
    naive = 1 - kaplan_meier(time, codes == 1).survival[-2]
    assert naive > rod.probability[-2] + 0.2


@pytest.mark.study
def test_bands_hold_their_level() -> None:
    """Two constant hazards 0.7 and 0.3 with censoring: F_rod(t) = 0.7 (1 − e^{−t})."""
    rng = np.random.default_rng(seed=1)
    held = 0
    for _ in range(500):
        life, end = rng.exponential(1.0, 40), rng.uniform(0.5, 3.0, 40)
        codes = np.where(life > end, 0, rng.choice([1, 2], 40, p=[0.7, 0.3]))
        causes = aalen_johansen(np.minimum(life, end), codes > 0, [SITES[c] for c in codes.tolist()]).causes
        rod = next(c for c in causes if c.cause == "rod")
        row = int(np.searchsorted(rod.time, 0.8, side="right")) - 1
        held += rod.lower[row] <= 0.7 * (1 - np.exp(-0.8)) <= rod.upper[row]
    assert 0.92 <= held / 500 <= 0.985


def test_against_lifelines() -> None:
    lifelines = pytest.importorskip("lifelines", reason="lifelines is in the environment of peers only")
    rng = np.random.default_rng(seed=2)
    for _ in range(50):
        time, codes = rng.permutation(60) + 1.0, rng.integers(0, 3, 60)
        rod = next(
            c for c in aalen_johansen(time, codes > 0, [SITES[c] for c in codes.tolist()]).causes if c.cause == "rod"
        )
        theirs = lifelines.AalenJohansenFitter(calculate_variance=True).fit(time, codes, event_of_interest=1)
        np.testing.assert_allclose(rod.probability, theirs.cumulative_density_.to_numpy()[-60:, 0], atol=1e-12)
        np.testing.assert_allclose(
            rod.standard_error[:-1] ** 2, theirs.variance_.to_numpy().ravel()[-60:-1], atol=1e-12
        )


def test_bad_input_is_named() -> None:
    with pytest.raises(RefusedError, match="1 causes for 2 lifetimes"):
        aalen_johansen([1.0, 2.0], [1, 1], ["rod"])
    with pytest.raises(RefusedError, match="-1 s"):
        aalen_johansen([-1.0], [1], ["rod"])
    assert aalen_johansen([5.0], [0], [None]).causes == ()
