"""Electrodes for a film over rods: closed forms, other electrodes, lives drawn cell by cell, and the files of the command."""

from __future__ import annotations

import csv
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.cli import main
from pipeline.fit.survival.electrode_design import (
    ANY_SHAPE,
    RECTANGLES,
    SHAPED,
    ElectrodeDesign,
    design_electrodes,
    place_rectangles,
)
from pipeline.fit.survival.film_life import FilmLifeFit
from pipeline.fit.survival.kaplan_meier import Estimate
from pipeline.physics.thickness.film import RodFilm, ThicknessMap
from pipeline.physics.thickness.layout import Rectangle, covered_share, separate_regions, single_region
from reports.build import build_reports
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from tests.helpers.rod_film_lives import draw_paired_lives
from tests.helpers.synthetic_lab import Story

FILM = RodFilm(length_mm=20.0, width_mm=20.0)
P, BETA = 11.0, 1.6


def law(spread: float = 0.0) -> FilmLifeFit:
    one = Estimate(1.0, 1.0, 1.0)
    center = np.array([0.0, np.log(P), np.log(BETA)])
    return FilmLifeFit(40.0, one, one, one, center, spread**2 * np.eye(3) + 1e-14 * np.eye(3), 200, ("a",), 0.0)


def rod_map(dip: float, cells: int = 60) -> ThicknessMap:
    """Squares whose thickness dips at the rods and, half as much, at the film's ends."""
    edge = np.linspace(-10, 10, cells + 1)
    x, y = np.meshgrid(edge[:-1], edge[:-1], indexing="ij")
    step = edge[1] - edge[0]
    corners = np.stack([np.stack([x + a * step, y + b * step], -1) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))], 2)
    middle = corners.reshape(-1, 4, 2).mean(axis=1)
    rods = np.abs(middle[:, 1:] - FILM.rod_positions_mm).min(axis=1)
    ends = 10 - np.abs(middle[:, 0])
    thickness = (1 - dip * np.exp(-(rods**2) / 2) - 0.5 * dip * np.exp(-(ends**2) / 2)) / 3.6
    return ThicknessMap(FILM, corners.reshape(-1, 4, 2), thickness, step**2 * thickness, "formula", 0)


def test_on_a_flat_film_larger_electrodes_live_longer_by_a_closed_form() -> None:
    """Force and hazard both go with the area a: at equal force life goes with a^((p/2 − 1)/β)."""
    flat = rod_map(0.0)
    now = separate_regions(FILM, 2.0)
    best = design_electrodes(flat, now, law())[0]
    assert (best.gap_mm, best.inset_mm) == (0.5, 0.0)
    more = (5 - 0.5) / (5 - 2.0)
    assert best.relative_force == pytest.approx(more, rel=0.02)
    assert best.life_ratio.value == pytest.approx(more ** ((P / 2 - 1) / BETA), rel=0.05)


def test_a_dip_keeps_electrodes_away_and_the_bound_is_never_exceeded() -> None:
    film_map = rod_map(0.45)
    by = {d.design: d for d in design_electrodes(film_map, single_region(FILM), law(0.1))}
    assert set(by) == {RECTANGLES, SHAPED, ANY_SHAPE}
    assert by[RECTANGLES].gap_mm is not None
    assert by[RECTANGLES].gap_mm > 0.5
    assert by[ANY_SHAPE].life_ratio.value >= by[SHAPED].life_ratio.value > 0.9 * by[ANY_SHAPE].life_ratio.value
    assert by[ANY_SHAPE].life_ratio.value >= by[RECTANGLES].life_ratio.value > 1
    for one in by.values():
        assert one.life_ratio.lower < one.life_ratio.value < one.life_ratio.upper
        assert one.voltage_ratio == pytest.approx(one.relative_force**-0.5)


@pytest.mark.long
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_no_random_electrodes_live_longer_than_the_bound(seed: int) -> None:
    film_map, now = rod_map(0.2, 30), separate_regions(FILM, 1.0)
    bound = design_electrodes(film_map, now, law())[-1].life_ratio.value
    rng = np.random.default_rng(seed)
    thick = film_map.thickness > np.quantile(film_map.thickness, rng.uniform(0, 0.7))
    cover = np.where(thick, rng.uniform(size=thick.size) < rng.uniform(0.3, 1.0), 0.0)
    assert life_over(film_map, cover, covered_share(film_map, now)) <= bound * 1.02  # classes of thickness are 1 % wide


def life_over(film_map: ThicknessMap, cover: Float, now: Float) -> float:
    """Ratio of median lives at equal force, cell by cell."""
    rods = np.abs(film_map.centres_mm[:, 1:] - FILM.rod_positions_mm).min(axis=1) < FILM.rod_diameter_mm / 2
    force, hazard = [], []
    for one in (cover, now):
        force.append(sum(a * c / h for a, c, h, r in zip(film_map.area_mm2, one, film_map.thickness, rods, strict=True) if not r))  # fmt: skip
        hazard.append(sum(a * c * h**-P for a, c, h in zip(film_map.undeformed_area_mm2, one, film_map.thickness, strict=True)))  # fmt: skip
    return float(((force[0] / force[1]) ** (P / 2) * hazard[1] / hazard[0]) ** (1 / BETA))


def test_lives_drawn_cell_by_cell_have_the_ratio_that_is_promised() -> None:
    film_map, now = rod_map(0.25, 40), separate_regions(FILM, 1.0)
    best = design_electrodes(film_map, now, law())[0]
    covers = [covered_share(film_map, r) for r in (best.electrodes, now)]
    rng = np.random.default_rng(4)
    lives = draw_paired_lives(
        film_map, covers, [best.voltage_ratio, 1.0], exponent=P / BETA, shape=BETA, specimens=4000, rng=rng
    )
    # ln of a median of 4000 Weibull lives is known to ± 1.25/(β √4000).
    assert np.log(np.median(lives[0]) / np.median(lives[1])) == pytest.approx(
        np.log(best.life_ratio.value), abs=4 * 2**0.5 * 1.25 / BETA / 4000**0.5
    )


def test_a_film_without_room_between_rods_is_refused() -> None:
    one = RodFilm(rods=1)
    alone = ThicknessMap(one, rod_map(0.1).corners_mm, rod_map(0.1).thickness, rod_map(0.1).undeformed_area_mm2, "", 0)
    with pytest.raises(NotIdentifiableError, match="no room"):
        design_electrodes(alone, single_region(one), law())
    assert place_rectangles(FILM, 5.0, 0.0) == ()


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    story = Story()
    story.recording("L-1", "L-1", "lifetime", "electrical", keys={"configuration": "case 3"})
    about = {"campaign": story.rows["recordings"][0].get("campaign"), "configuration": "case 3"}
    both = ElectrodeDesign("shaped", (Rectangle(-9, 9, -9, -1), Rectangle(-9, 9, 1, 9)), None, None, 0.7, 0.95, 1.03, Estimate(1.1, 1.0, 1.3), 0.87)  # fmt: skip
    for design, life in (("shaped", 1.11), ("any shape", 1.15)):
        story.rows["electrode_designs"].append(
            about
            | {
                "design": design,
                "covered_share": 0.7,
                "relative_force": 0.95,
                "voltage_ratio": 1.03,
                "life_ratio": life,
                "life_ratio_lower": 1.01,
                "life_ratio_upper": 1.3,
                "thinnest": 0.87,
            }
        )
    for number, r in enumerate(both.electrodes, 1):
        story.rows["electrode_shapes"].append(
            about
            | {
                "design": "shaped",
                "number": number,
                "x_low_mm": r.x_low,
                "x_high_mm": r.x_high,
                "y_low_mm": r.y_low,
                "y_high_mm": r.y_high,
            }
        )
    story.run()
    return story.write(tmp_path_factory.mktemp("layout") / "lab")


def test_the_command_says_what_is_gained_and_writes_both_files(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = lab.parent / "best.svg"
    assert main(["layout", "case 3", "--lab", str(lab), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "life at the same force × 1.11" in said
    assert "no electrodes of any shape exceed × 1.15" in said
    rectangles = ElementTree.parse(out).getroot().findall(".//{http://www.w3.org/2000/svg}rect")
    assert sum(float(r.get("width", 0)) * float(r.get("height", 0)) for r in rectangles) == pytest.approx(2 * 18 * 8)
    assert [float(r.get("y", 0)) for r in rectangles] == [11.0, 1.0]  # upwards on the film
    with out.with_suffix(".csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["y_high_mm"] for row in rows] == ["-1", "9"]


@pytest.mark.parametrize(
    ("words", "said"),
    [(("nobody",), "no shaped electrodes were designed"), (("case 3", "--out", "x.dxf"), "ends in .svg")],
)
def test_slips_of_the_command(lab: Path, words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["layout", *words, "--lab", str(lab)]) == 2
    assert said in capsys.readouterr().err


def test_pages_are_written_with_designs(lab: Path) -> None:
    build_reports(lab)
