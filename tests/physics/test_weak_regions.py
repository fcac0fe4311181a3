"""Expected against found failures of a rod film."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.analyse.weak_regions import weak_region_tables
from pipeline.fit.survival.weak_regions import check_layout, compare_regions, electrodes, on_grid
from pipeline.physics.thickness.continuous import continuous_thickness
from pipeline.physics.thickness.film import RodFilm

CASE_1 = ["left"] * 7 + ["centre"] * 10 + ["right"] * 3


@pytest.fixture(scope="module")
def film_map():
    return continuous_thickness(RodFilm(), elements=1200)


def test_regions_of_the_thesis(film_map) -> None:
    shares = {s.region: s for s in compare_regions(film_map, electrodes(film_map.film, None), CASE_1)}
    assert sum(s.predicted for s in shares.values()) == pytest.approx(1)
    assert shares["centre"].predicted == max(s.predicted for s in shares.values())
    assert [shares[r].observed for r in ("left", "centre", "right")] == [0.35, 0.5, 0.15]
    low, high = shares["centre"].observed_interval  # exact binomial limits of 10 of 20
    assert (low, high) == pytest.approx((0.272, 0.728), abs=5e-4)


def test_without_failures_nothing_is_observed(film_map) -> None:
    shares = compare_regions(film_map, electrodes(film_map.film, None), [])
    assert all(s.observed is None and s.observed_interval is None and s.failures == 0 for s in shares)


def test_layouts(film_map) -> None:
    film = film_map.film
    single = check_layout(film_map, electrodes(film, None), ["rod"] * 19 + ["lead"], voltage_kv=7.5, thickness_mm=1.0)
    apart = check_layout(film_map, electrodes(film, 1.0), ["lead"] * 16, voltage_kv=7.5, thickness_mm=1.0)
    assert single.observed_rod_share == 0.95
    assert apart.observed_rod_share == 0.0
    assert single.thin_share > apart.thin_share
    assert single.peak_field_mv_per_m == pytest.approx(7.5 / film_map.thickness.min())
    assert 20 < apart.peak_field_mv_per_m < single.peak_field_mv_per_m


def test_grid_and_rows(film_map) -> None:
    layout = electrodes(film_map.film, None)
    grid = on_grid(film_map, layout, points=31)
    inside = np.isfinite(grid.thickness)
    assert 0.5 < inside.mean() < 1.0  # between the rods the ends have run back
    assert np.nanmin(grid.thickness) >= film_map.thickness.min() - 1e-9
    tables = weak_region_tables("single", compare_regions(film_map, layout, CASE_1), [], [grid])
    assert tables["film_maps"].num_rows == 31 * 31
    assert tables["film_maps"]["thickness"].null_count == (~inside).sum()
    assert tables["weak_regions"].num_rows == 3
