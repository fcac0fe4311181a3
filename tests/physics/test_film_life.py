"""Life from the film: area, voltage and thickness as the weakest link has them, and a layout that was never tested."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.analyse.film_lives import LayoutLives, film_life_tables
from pipeline.fit.survival.film_life import (
    PLAUSIBLE_EXPONENT,
    FilmLayout,
    FilmLives,
    fit_film_life,
    lay_film,
    predict_film_life,
)
from pipeline.fit.survival.lifetime_distributions import Lives, fit_distribution
from pipeline.physics.thickness.film import RodFilm, ThicknessMap
from pipeline.physics.thickness.layout import Rectangle
from schemas.errors import NotIdentifiableError, RefusedError
from schemas.lifetimes import LifetimeRow
from tests.helpers.weak_films import SHEETS, Film, draw_lives
from tests.studies.study_film_life import describe_layout

pytestmark = pytest.mark.quick

FLAT = FilmLayout("flat", np.array([0.2]), np.array([100.0]))


def draw(layout_number: int, voltage_kv: float, specimens: int, seed: int, end_s: float = 2e4) -> FilmLives:
    sheet = SHEETS[layout_number]
    time, failed = draw_lives(Film(), sheet, voltage_kv, specimens, end_s, np.random.default_rng(seed))
    return FilmLives(describe_layout(sheet), voltage_kv, Lives.right_censored(time, failed))


def test_one_uniform_layout_at_two_voltages_is_a_weibull_law() -> None:
    """Without map and scatter the film's law is the inverse power law, whose Weibull fits are elsewhere."""
    rng = np.random.default_rng(2)
    groups = []
    for voltage in (7.0, 9.0):
        life = 1e4 * (voltage / 8) ** -6 * rng.weibull(1.7, 25)
        groups.append(FilmLives(FLAT, voltage, Lives(life, life)))
    fit = fit_film_life(groups)
    both = sum(fit_distribution(g.lives, "weibull").log_likelihood for g in groups)
    assert fit.log_likelihood <= both + 1e-6
    assert fit.log_likelihood > both - 2.0
    scale = [fit_distribution(g.lives, "weibull").parameters["scale_s"].value for g in groups]
    slope = np.log(scale[1] / scale[0]) / np.log(9 / 7)
    assert fit.exponent.value == pytest.approx(slope, rel=0.05)
    assert fit.exponent.lower < fit.exponent.value < fit.exponent.upper < 0


def test_area_and_thickness_count_absolutely() -> None:
    fit = fit_film_life([draw(0, 7.0, 12, 1), draw(1, 9.0, 12, 2)])
    one = predict_film_life(fit, FLAT, 8.0, 10).median_s.value
    twice = FilmLayout("twice", np.array([0.2, 0.2]), np.array([100.0, 100.0]))
    assert predict_film_life(fit, twice, 8.0, 10).median_s.value == pytest.approx(
        one * 2 ** (-1 / fit.shape.value), rel=1e-6
    )
    thick = FilmLayout("thick", np.array([0.22]), np.array([100.0]))
    assert predict_film_life(fit, thick, 8.8, 10).median_s.value == pytest.approx(one, rel=1e-6)
    rough = FilmLayout("rough", np.array([0.2]), np.array([100.0]), local_scatter=0.05)
    assert predict_film_life(fit, rough, 8.0, 10).median_s.value < one


def test_a_layout_that_was_never_tested_is_predicted() -> None:
    """One campaign drawn flaw by flaw; how often the interval holds is for the study."""
    groups = [draw(i, voltage, 20, 10 * i + int(voltage)) for i in (0, 1) for voltage in (7.0, 9.0)]
    fit = fit_film_life(groups)
    found = predict_film_life(fit, describe_layout(SHEETS[2]), 7.5, 10, 1e4)
    time, _ = draw_lives(Film(), SHEETS[2], 7.5, 2000, np.inf, np.random.default_rng(7))
    assert found.median_s.lower < np.median(time) < found.median_s.upper
    assert found.sample_median_s.lower < found.median_s.lower
    assert found.median_s.upper / found.median_s.lower < 2
    assert found.failed_share is not None
    assert found.failed_share.lower <= (time < 1e4).mean() <= found.failed_share.upper


def test_pieces_of_equal_thickness_keep_area_and_hazard() -> None:
    rng = np.random.default_rng(4)
    corners = np.array([[[0, 0], [1, 0], [1, 1], [0, 1]]], dtype=float) + rng.uniform(-9, 8, (300, 1, 2))
    thickness = rng.uniform(0.2, 0.3, 300)
    film = ThicknessMap(RodFilm(), corners, thickness, np.full(300, 0.3), "continuous", 1)
    whole = lay_film("whole", film, (Rectangle(-10.0, 10.0, -10.0, 10.0),), 1.0)
    assert whole.area_mm2.sum() == pytest.approx(90.0)
    assert whole.area_mm2.size < 60
    for p in (8.0, 15.0):
        assert whole.log_exposure(np.array(p)) == pytest.approx(np.log((0.3 * thickness**-p).sum()), abs=3e-3)
    with pytest.raises(RefusedError, match="no electrode"):
        lay_film("away", film, (Rectangle(30.0, 31.0, 0.0, 1.0),), 1.0)


def test_what_carries_no_law_is_named() -> None:
    with pytest.raises(NotIdentifiableError, match="distinct failures in the film"):
        fit_film_life([draw(0, 7.0, 5, 3, end_s=1.0), draw(1, 7.0, 5, 4, end_s=1.0)])
    with pytest.raises(NotIdentifiableError, match="one layout at one voltage"):
        fit_film_life([draw(0, 9.0, 12, 3)])
    assert fit_film_life([draw(0, 9.0, 12, 3)], PLAUSIBLE_EXPONENT).failures > 3, "plausible exponents carry it"
    with pytest.raises(RefusedError):
        FilmLayout("none", np.array([0.0]), np.array([1.0]))


def test_each_layout_is_predicted_by_the_others_as_rows() -> None:
    layouts = []
    for i in (0, 1):
        time, failed = draw_lives(Film(), SHEETS[i], 9.0, 12, 2e4, np.random.default_rng(30 + i))
        rows = [
            LifetimeRow(specimen_id=f"{i}-{k}", lifetime_s=float(t), failed=bool(f), voltage_kv=9.0, failure_site="rod")
            for k, (t, f) in enumerate(zip(time, failed, strict=True))
        ]
        layouts.append(LayoutLives(describe_layout(SHEETS[i]), rows))
    found = film_life_tables("thesis", layouts)
    (law,) = found["film_lives"].to_pylist()
    assert law["life_s_lower"] < law["life_s"] < law["life_s_upper"]
    predicted = found["film_life_predictions"].to_pylist()
    assert [row["fitted_on"] for row in predicted] == ["large", "small"]
    for row in predicted:
        assert row["predicted_median_s_low"] < row["predicted_median_s"] < row["predicted_median_s_high"]
        assert row["within"] is not None
    assert film_life_tables("thesis", layouts[:1])["film_lives"].num_rows == 0
