"""Expected against found failures of a rod film."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.analyse import weak_regions
from pipeline.analyse.inputs import Measured
from pipeline.analyse.weak_regions import analyse_weak_regions, weak_region_tables
from pipeline.fit.survival.weak_regions import check_layout, compare_regions, electrodes, on_grid
from pipeline.physics.thickness.continuous import continuous_thickness
from pipeline.physics.thickness.film import RodFilm
from schemas.errors import NotIdentifiableError
from schemas.lifetimes import LifetimeRow
from schemas.metadata import RecordingMetadata, RigConstants

CASE_1 = [("left", "rod")] * 7 + [("centre", "rod")] * 9 + [("centre", None)] + [("right", "edge")] * 3
"""Region and site of each failure."""


@pytest.fixture(scope="module")
def film_map():
    return continuous_thickness(RodFilm(), elements=1200)


def test_the_film_is_that_of_the_metadata_and_not_its_electrode() -> None:
    """Of a divided electrode 2 × 8 mm across the rods lie on a film of 20 × 20 mm."""
    about = {
        "recording_id": "a", "protocol": "lifetime", "loading": "electrical", "specimen_id": "a", "started_at": "2026-03-01T08:00:00Z",
        "stretch_1": 1.2, "stretch_2": 3.0, "active_length_mm": 16, "active_width_mm": 18, "active_drawn": "stretched",
        "rods": 3, "rod_spacing_mm": 10, "rod_diameter_mm": 0.75,
    }  # fmt: skip
    whole = weak_regions.rod_film(RecordingMetadata.parse({**about, "film_length_mm": 16.667, "film_width_mm": 6.667}))
    assert (whole.width_mm, whole.length_mm) == pytest.approx((20, 20), abs=0.01)
    alone = weak_regions.rod_film(RecordingMetadata.parse({**about, "rod_spacing_mm": 8}))
    assert (alone.width_mm, alone.length_mm) == (16, 18)
    with pytest.raises(NotIdentifiableError, match="do not fit"):
        weak_regions.rod_film(RecordingMetadata.parse(about))


def test_regions_of_the_thesis(film_map) -> None:
    shares = {s.region: s for s in compare_regions(film_map, electrodes(film_map.film, None), CASE_1)}
    assert sum(s.predicted for s in shares.values()) == pytest.approx(1)
    assert shares["centre"].predicted == max(s.predicted for s in shares.values())
    assert [shares[r].unknown_site for r in ("left", "centre", "right")] == [0, 1, 0]
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
    assert 7.5 < apart.peak_field_mv_per_m < 0.7 * single.peak_field_mv_per_m


def test_grid_and_rows(film_map) -> None:
    layout = electrodes(film_map.film, None)
    grid = on_grid(film_map, layout, points=31)
    inside = np.isfinite(grid.thickness)
    assert 0.5 < inside.mean() < 1.0  # between the rods the ends have run back
    assert np.nanmin(grid.thickness) >= film_map.thickness.min() - 1e-9
    tables = weak_region_tables("one", "single", compare_regions(film_map, layout, CASE_1), [], [grid], 2)
    assert tables["film_maps"].num_rows == 31 * 31
    assert tables["film_maps"]["thickness"].null_count == (~inside).sum()
    assert tables["weak_regions"].num_rows == 3
    assert tables["weak_regions"]["other_failures"].to_pylist() == [2, 2, 2]


def test_failures_at_the_lead_say_nothing_about_the_film(monkeypatch: pytest.MonkeyPatch, film_map) -> None:
    """Of two campaigns with configurations of one name, each with its own film and failures."""
    monkeypatch.setattr(weak_regions, "_maps", lambda film: (film_map, film_map))
    about = {
        "protocol": "lifetime", "loading": "electrical", "started_at": "2026-03-01T08:00:00Z", "configuration": "single",
        "stretch_1": 3.0, "stretch_2": 1.2, "active_length_mm": 34, "active_width_mm": 34, "rods": 3, "rod_spacing_mm": 10,
        "rod_diameter_mm": 0.7, "active_drawn": "stretched",
    }  # fmt: skip

    def failed(campaign: str, number: int, region: str, site: str | None) -> Measured:
        name = f"{campaign}-{number}"
        metadata = RecordingMetadata.parse({**about, "recording_id": name, "specimen_id": name, "campaign": campaign})
        life = LifetimeRow(
            specimen_id=name, lifetime_s=10.0, failed=True, failure_region=region, failure_site=site, voltage_kv=7.5
        )
        return Measured(metadata, RigConstants(), (life,))

    one = [
        ("left", "rod"),
        ("left", "lead"),
        ("centre", "active"),
        ("right", "lead"),
        ("right", None),
        ("left", "lead"),
    ]
    given = [failed("one", i, *where) for i, where in enumerate(one)] + [failed("two", 0, "right", "rod")]
    tables = analyse_weak_regions(given).joined()
    rows = tables["weak_regions"].to_pylist()
    found = {(r["campaign"], r["region"]): (r["failures"], r["unknown_site"], r["other_failures"]) for r in rows}
    assert found == {
        ("one", "left"): (1, 0, 3), ("one", "centre"): (1, 0, 3), ("one", "right"): (1, 1, 3),
        ("two", "left"): (0, 0, 0), ("two", "centre"): (0, 0, 0), ("two", "right"): (1, 0, 0),
    }  # fmt: skip
    layouts = {r["campaign"]: r["observed_rod_share"] for r in tables["electrode_layouts"].to_pylist()}
    assert layouts == {"one": 0.5, "two": 1.0}, "of the sites in the film that somebody noted"
