"""The order test: closed tail against simulated processes and against fits under the null."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.fit.relaxation.assemble import assemble
from pipeline.fit.relaxation.identify import fit_specimen
from pipeline.fit.relaxation.order import arc_length, bic, choose, tail_probability
from pipeline.fit.relaxation.reference import find_reference
from pipeline.fit.relaxation.search import Search
from tests.helpers.fit_truth import BAND, SILICONE, film, response


@pytest.mark.parametrize("length", [1.0, 3.0, 6.0])
def test_tail_is_that_of_the_largest_positive_value_of_a_process(length: float) -> None:
    """Z(t) = a cos t + b sin t + noise along a curve of known length on the sphere of four dimensions."""
    rng = np.random.default_rng(seed=0)
    t = np.linspace(0, length, 200)
    curve = np.stack(
        [np.cos(t / 2), np.sin(t / 2), np.cos(np.sqrt(3) * t / 2 * 1.0), np.sin(np.sqrt(3) * t / 2)]
    ) / np.sqrt(2)
    speed = np.linalg.norm(np.diff(curve, axis=1), axis=0).sum()
    draws = rng.normal(size=(200_000, 4)) @ curve
    ratio = np.maximum(draws.max(axis=1), 0) ** 2
    for level in (6.6, 9.0):
        assert tail_probability(level, float(speed)) == pytest.approx((ratio > level).mean(), rel=0.12)
    assert tail_probability(0.0, length) == 1.0


def test_arc_length_does_not_depend_on_the_noise_level() -> None:
    lengths = []
    for relative in (0.01, 0.001):
        data = response(BAND, film(BAND, SILICONE), np.random.default_rng(seed=0), relative=relative)
        observations, _, _ = assemble([data], [None])
        search = Search(find_reference(observations))
        lengths.append(arc_length(observations, search.order(1, None).solution, search.bounds))
    assert lengths[0] == pytest.approx(lengths[1], rel=0.1)
    assert 1 < lengths[0] < 6


@pytest.mark.slow
@pytest.mark.study
def test_level_under_the_null() -> None:
    """100 draws of a first-order film: p below 20 % in about 20 %, below 1 % hardly ever."""
    p = []
    for seed in range(100):
        fits = fit_specimen([response(BAND, film(BAND, SILICONE), np.random.default_rng(seed))], orders=(1,))
        p.append(fits.selected.order_p_value)
    below = np.array([np.mean(np.array(p) < level) for level in (0.01, 0.05, 0.2)])
    assert below[0] <= 0.04
    assert below[1] <= 0.10
    assert 0.08 <= below[2] <= 0.32


def test_rules() -> None:
    chosen = choose((1, 2, 3), {1: 1e-5, 2: 0.4, 3: 0.5}, {1: 9.0, 2: 5.0, 3: 4.0}, {1: 3.0, 2: 1.0, 3: 1.1})
    assert chosen == {"test": 2, "bic": 3, "held_out": 2}
    assert choose((1, 2), {1: 0.0, 2: 0.0}, {1: 1.0, 2: 2.0}, {1: None, 2: None}) == {"test": 2, "bic": 1}
    assert bic(10.0, 2.0, 3, 100) == pytest.approx(5 + 3 * np.log(100))
