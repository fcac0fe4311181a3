"""Film thickness by finite elements: material law, patch, symmetry, refinement, and what the thesis' map can mean."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics.hyperelastic import energy, principal_stress, principal_tangent, stress_and_tangent
from pipeline.physics.thickness import layout
from pipeline.physics.thickness.assembly import q4
from pipeline.physics.thickness.continuous import continuous_thickness
from pipeline.physics.thickness.film import RodFilm, undeformed_mesh
from pipeline.physics.thickness.incremental import incremental_thickness

stretch = st.floats(0.6, 3.2)


def _energy_of(gradient: np.ndarray) -> np.ndarray:
    c = np.swapaxes(gradient, -1, -2) @ gradient
    squared = np.linalg.eigvalsh(c)
    return energy(np.sqrt(squared[..., 0]), np.sqrt(squared[..., 1]))


@given(stretch, stretch, st.floats(-3, 3), st.floats(-0.5, 0.5))
@settings(max_examples=60, deadline=None)
def test_stress_and_tangent_are_derivatives_of_the_energy(a: float, b: float, turn: float, shear: float) -> None:
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    gradient = rotation @ np.array([[a, shear], [0.0, b]])
    stress, tangent = stress_and_tangent(gradient)
    h = 1e-5
    for i in range(2):
        for j in range(2):
            step = np.zeros((2, 2))
            step[i, j] = h
            difference = (_energy_of(gradient + step) - _energy_of(gradient - step)) / (2 * h)
            assert difference == pytest.approx(stress[i, j], abs=1e-6)
            ahead, behind = stress_and_tangent(gradient + step)[0], stress_and_tangent(gradient - step)[0]
            np.testing.assert_allclose((ahead - behind) / (2 * h), tangent[:, :, i, j], atol=2e-6)


def test_coefficient_8_27_makes_the_uniaxial_slope_youngs_modulus() -> None:
    h = 1e-6

    def uniaxial(l1: float) -> float:
        return float(principal_stress(l1, l1**-0.5)[0])

    assert (uniaxial(1 + h) - uniaxial(1 - h)) / (2 * h) == pytest.approx(1.0, abs=1e-6)


def test_tangent_at_held_width_is_four_thirds_of_youngs_modulus_and_off_diagonal_is_known() -> None:
    c11, c22, c12 = principal_tangent(1.0, 1.0)
    assert c11 == pytest.approx(4 / 3)
    assert c22 == pytest.approx(4 / 3)
    assert c12 == pytest.approx(2 / 3)
    compliance = np.linalg.inv([[float(c11), float(c12)], [float(c12), float(c22)]])
    np.testing.assert_allclose(compliance, [[1.0, -0.5], [-0.5, 1.0]], atol=1e-12)


def test_patch_of_uniform_stretch_is_in_equilibrium() -> None:
    mesh = undeformed_mesh(RodFilm(), 300)
    elements = q4(mesh)
    points = np.asarray(mesh.p.T)
    gradient = np.array([[2.1, 0.2], [-0.1, 1.3]])
    deformation = elements.deformation(points @ (gradient - np.eye(2)).T)
    np.testing.assert_allclose(deformation, np.broadcast_to(gradient, deformation.shape), atol=1e-12)
    forces = elements.forces(stress_and_tangent(deformation)[0]).reshape(-1, 2)
    inside = (np.abs(points) < np.abs(points).max(axis=0) - 1e-9).all(axis=1)
    assert np.abs(forces[inside]).max() < 1e-12
    assert np.abs(forces[~inside]).max() > 1e-3


def test_film_without_lateral_stretch_and_wide_rods_keeps_the_pre_stretch() -> None:
    film = RodFilm(rods=1, rod_diameter_mm=19.0, stretch_across=1.0)
    found = continuous_thickness(film, elements=400)
    held = np.abs(found.centres_mm[:, 1]) < film.rod_diameter_mm / 2
    np.testing.assert_allclose(found.thickness[held], film.uniform_thickness, rtol=1e-9)


@pytest.fixture(scope="module")
def film_map():
    return continuous_thickness(RodFilm(), elements=1200)


def test_film_is_thinnest_beside_the_rods_and_thickens_at_the_free_ends(film_map) -> None:
    x, y = film_map.centres_mm.T
    film = film_map.film
    thin = film_map.thickness < 0.30
    distance = np.abs(y[:, None] - film.rod_positions_mm).min(axis=1)
    edge = film.width_mm / 2 - np.abs(y)
    assert np.minimum(distance, edge)[thin].max() < 1.5  # every thin place lies at a rod or at the held edge
    middle = np.abs(y - film.rod_spacing_mm / 2) < 0.8
    ends = film_map.thickness[middle & (np.abs(x) == np.abs(x[middle]).max())]
    bonded = distance < film.rod_diameter_mm / 2 / film.stretch_across
    assert ends.min() > 2 * film_map.thickness[bonded].max()
    assert np.abs(x[middle]).max() < 0.5 * film.length_mm / 2, "between rods 10 mm apart the free ends run back"


def test_map_is_symmetric(film_map) -> None:
    shares = layout.region_shares(film_map, layout.single_region(film_map.film), 10.0)
    assert shares["left"] == pytest.approx(shares["right"], rel=1e-6)
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["centre"] == max(shares.values())


@pytest.mark.slow
def test_shares_of_failures_converge() -> None:
    """Two meshes agree within 1 %, and with what the thesis found: 19 of 20 at the rods, half in the centre third."""
    coarse, fine = (continuous_thickness(RodFilm(), elements=n) for n in (3000, 6000))
    electrode = layout.single_region(fine.film)
    for exponent in (8.0, 10.0, 15.0):
        found = [layout.rod_share(m, electrode, exponent) for m in (coarse, fine)]
        assert found[0] == pytest.approx(found[1], abs=0.01)
        assert 0.95 < found[1] <= 1.0
    regions = [layout.region_shares(m, electrode, 10.0) for m in (coarse, fine)]
    for name, expected in {"left": 0.32, "centre": 0.36, "right": 0.32}.items():
        assert regions[0][name] == pytest.approx(regions[1][name], abs=0.01)
        assert regions[1][name] == pytest.approx(expected, abs=0.02)


def test_rods_on_the_edges_of_the_film_move_with_them(film_map) -> None:
    """Three rods 10 mm apart span a film of 20 mm; the bonded film keeps its width there and does not turn."""
    film = film_map.film
    assert film.rod_positions_mm.tolist() == [-10, 0, 10]
    y = film_map.corners_mm[..., 1]
    assert (y.min(), y.max()) == pytest.approx((-10, 10))
    bonded = film_map.centres_mm[:, 1] > 10 - film.rod_diameter_mm / 2 / film.stretch_across
    assert bonded.sum() >= 2
    np.testing.assert_allclose(film_map.thickness[bonded], 1 / film.stretch_along, rtol=1e-9)


def test_a_divided_electrode_loses_the_fifth_that_the_thesis_states() -> None:
    film = RodFilm()
    area = sum((r.x_high - r.x_low) * (r.y_high - r.y_low) for r in layout.separate_regions(film, 1.0))
    assert area / (film.length_mm * film.width_mm) == pytest.approx(0.8)


def test_an_electrode_that_covers_part_of_an_element_counts_in_part(film_map) -> None:
    half = (layout.Rectangle(-10, 10, 0, 10),)
    area = film_map.area_mm2
    assert (layout.covered_share(film_map, half) * area).sum() == pytest.approx(area.sum() / 2, rel=1e-6)


def test_volume_is_kept(film_map) -> None:
    volume = (film_map.area_mm2 * film_map.thickness).sum()
    assert volume == pytest.approx(film_map.undeformed_area_mm2.sum(), rel=2e-3)


def test_separate_regions_leave_the_thin_film_out(film_map) -> None:
    film = film_map.film
    single = layout.thin_share(film_map, layout.single_region(film), 0.9)
    separate = layout.thin_share(film_map, layout.separate_regions(film), 0.9)
    assert single > 0.1
    assert separate < 0.5 * single
    thinnest = [
        film_map.relative_thickness[layout.covered(film_map, e)].min()
        for e in (layout.single_region(film), layout.separate_regions(film))
    ]
    assert thinnest[0] < 0.6 < thinnest[1]


def test_incremental_scheme_concentrates_the_stretch_at_the_rod_ends() -> None:
    """The level of the thesis' map is a result of its boundary condition: the body hardly stretches."""
    found = incremental_thickness(RodFilm(), elements=1200)
    x = found.centres_mm[:, 0]
    assert np.median(found.thickness) > 2 * found.film.uniform_thickness
    thinnest = np.argsort(found.thickness)[:20]
    assert np.abs(x[thinnest]).min() > 0.7 * np.abs(x).max()
    assert found.thickness.min() < 0.2 * np.median(found.thickness)


@pytest.mark.parametrize(
    "wrong",
    [
        {"rods": 0},
        {"rod_spacing_mm": 12.0},
        {"rod_spacing_mm": 0.5},
        {"rod_diameter_mm": 7.0},
        {"stretch_along": 0.9},
        {"length_mm": -1.0},
    ],
)
def test_impossible_films_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"expected|fit"):
        RodFilm(**wrong)
