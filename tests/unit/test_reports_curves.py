"""Curves drawn from stored parameters, against the fitted model, tabulated values and random draws."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from pipeline.physics.film import RelaxationModel
from reports import evidence
from reports.figures import curves
from reports.figures.responses import Lines
from reports.pages.campaign.places import clopper_pearson
from reports.pages.campaign.reference import POLYACRYLATE, SILICONE, STACK, reference
from schemas.tables import TABLES

F = np.geomspace(0.01, 200, 40)


def fit(**values: object) -> dict[str, object]:
    """A row of `model_fits` with the given columns, the rest NULL."""
    return {**dict.fromkeys(TABLES["model_fits"].names), **values}


def row(model: RelaxationModel) -> dict[str, object]:
    found = fit(k0_n_per_mm=model.k0)
    for i, (k, c) in enumerate(zip(model.k, model.c, strict=True), 1):
        found |= {f"k{i}_n_per_mm": k, f"c{i}_n_s_per_mm": c}
    if model.c_inf:
        found[f"c{len(model.k) + 1}_n_s_per_mm"] = model.c_inf
    return found


arms = st.lists(st.tuples(st.floats(0.01, 50), st.floats(1e-4, 100)), max_size=4)


@settings(deadline=None)
@given(st.floats(0.01, 10), arms, st.sampled_from([0.0, 0.02]))
def test_stored_model_is_the_fitted_one(k0: float, arms: list[tuple[float, float]], dashpot: float) -> None:
    model = RelaxationModel(k0, tuple(k for k, _ in arms), tuple(t for _, t in arms), dashpot)
    np.testing.assert_allclose(curves.stiffness(row(model), F), model.stiffness(F), rtol=1e-9)
    assert len(curves.arms(row(model))) == model.order


@pytest.mark.parametrize(
    ("film", "order", "frequency", "magnitude", "angle"),
    [
        (POLYACRYLATE, 3, 10.0, 3.945, 44.0),
        (POLYACRYLATE, 3, 100.0, 14.222, 51.1),
        (POLYACRYLATE, 1, 1.0, 1.256, 29.2),
        (STACK, 3, 5.0, 2.561, 46.7),
        (STACK, 2, 0.1, 0.787, 26.9),
        (SILICONE, 1, 50.0, 0.299, 8.3),
    ],
)
def test_published_models_have_their_published_curves(film, order, frequency, magnitude, angle) -> None:  # type: ignore[no-untyped-def]
    k = curves.stiffness(next(m for m in film.models if m.order == order).row(), [frequency])[0]
    assert abs(k) == pytest.approx(magnitude, abs=6e-4)
    assert np.degrees(np.angle(k)) == pytest.approx(angle, abs=0.06)


@pytest.mark.parametrize(
    ("frequency", "magnitude", "angle"), [(10, 2.495, 25.0), (40, 4.410, 10.1), (52, 5.313, -0.2), (90, 6.562, -51.8)]
)
def test_recorded_response_against_integration_in_time(frequency: float, magnitude: float, angle: float) -> None:
    """Values found by integrating the rig's equations of motion: clamp alone at 52 Hz, 0.5 % damping, 5.34 N/mm."""
    cell, resonance = 5.34, 2 * np.pi * 52
    rig = curves.Rig(1e3 * cell / resonance**2, cell, 2 * 0.005 * cell / resonance)
    film = curves.stiffness(POLYACRYLATE.models[2].row(), [float(frequency)])
    recorded = rig.recorded(film, [float(frequency)])[0]
    assert abs(recorded) == pytest.approx(magnitude, abs=3e-3)
    assert np.degrees(np.angle(recorded)) == pytest.approx(angle, abs=0.1)
    assert rig.resonance_hz == pytest.approx(52)


def test_a_rigid_cell_shows_the_whole_actuation_force() -> None:
    film = curves.stiffness(POLYACRYLATE.models[2].row(), F)
    np.testing.assert_allclose(curves.Rig(0.01, 1e9, 0.0).actuated(film, F), 1, rtol=1e-3)


def test_the_factors_of_a_fit_find_their_recordings_whatever_the_level_of_their_own() -> None:
    """Records at 0.049999 are those of `amplitude 0.05`; factors are stored as of another relaxation, 0.7 of this one."""
    cell, resonance = 20.0, 2 * np.pi * 52
    mass, damping = 1e3 * cell / resonance**2, 2 * 0.005 * cell / resonance
    shown = {
        **fit(), **POLYACRYLATE.models[2].row(), "method": "forward", "clamp_mass_kg": mass / 1e3, "load_cell_stiffness_n_per_mm": cell,
        "load_cell_damping_n_s_per_mm": damping,
        "spread": json.dumps({"gains": {"amplitude 0.05": 0.7 * 1.1, "amplitude 0.15": 0.7 * 0.9}}),
    }  # fmt: skip
    rig = curves.rig(shown, {})
    assert rig is not None
    random, parts = np.random.default_rng(seed=5), {}
    for name, gain in (("a", 1.1), ("b", 0.9)):
        value = gain * rig.recorded(curves.stiffness(shown, F), F)
        noise = 1e-3 * (random.normal(size=F.size) + 1j * random.normal(size=F.size))
        every = np.ones(F.size)
        parts["measured", name] = Lines(F, value + noise, 1e-3 * np.sqrt(2) * every, every > 0, every)
    found = evidence.Measured(parts, None, {"a": 0.049999, "b": 0.150002})
    left = evidence._recorded_residual(shown, found, {})
    assert left is not None
    assert left.rms == pytest.approx(1.0, rel=0.15)


def test_band_against_random_draws() -> None:
    random = np.random.default_rng(seed=4)
    base = np.log([1.0, 1.5, 2.0, 0.03, 0.004])
    names = ["log k0", "log k1", "log k2", "log tau1", "log tau2"]
    root = random.normal(scale=0.004, size=(5, 5))
    matrix = root @ root.T

    def stored(theta: np.ndarray) -> dict[str, object]:
        k0, k1, k2, t1, t2 = np.exp(theta)
        return fit(k0_n_per_mm=k0, k1_n_per_mm=k1, c1_n_s_per_mm=k1 * t1, k2_n_per_mm=k2, c2_n_s_per_mm=k2 * t2)

    draws = [curves.stiffness(stored(base + root @ random.normal(size=5)), F) for _ in range(4000)]
    centre = curves.stiffness(stored(base), F)
    covariance = json.dumps({"names": [*names, "log clamp_mass_kg"], "matrix": np.pad(matrix, (0, 1)).tolist()})
    band = curves.band({**stored(base), "covariance": covariance}, F)
    assert band is not None
    np.testing.assert_allclose(band[0], np.std(np.abs(draws), axis=0), rtol=0.08)
    np.testing.assert_allclose(band[1], np.std(np.angle(draws / centre), axis=0), rtol=0.08)
    sd = curves.relaxation_time_sd({**stored(base), "covariance": covariance}, 1)
    assert sd == pytest.approx(0.03 * np.sqrt(matrix[3, 3]))


@pytest.mark.parametrize("text", [None, "", "{", "[]", "{}", '{"names": ["log k0"], "matrix": [[1, 2]]}'])
def test_no_band_without_a_usable_covariance(text: str | None) -> None:
    assert curves.band({**row(RelaxationModel(1.0, (1.0,), (1.0,))), "covariance": text}, F) is None


def test_an_unresolved_relaxation_time_has_no_sd() -> None:
    stored = row(RelaxationModel(1.0, (1.0,), (1.0,)))
    stored["covariance"] = json.dumps({"names": ["log tau1"], "matrix": [[9.0]]})
    assert curves.relaxation_time_sd(stored, 1) is None


def test_fitted_constants_come_before_stated_ones() -> None:
    stated = {"clamp_mass_kg": "0.2", "load_cell_stiffness_n_per_mm": "20.0"}
    found = curves.rig(fit(load_cell_stiffness_n_per_mm=21.0), stated)
    assert found == curves.Rig(0.2, 21.0, 0.0)
    assert curves.rig({}, {"load_cell_stiffness_n_per_mm": "soft"}) is None


@pytest.mark.parametrize(("lines", "order"), [(20, 1), (60, 3), (400, 3)])
def test_noise_limit_is_the_99_percent_point(lines: int, order: int) -> None:
    freedom = 2 * lines - (2 * order + 1)
    limit = evidence.noise_limit(fit(frequency_lines=lines, model_order=order))
    assert limit == pytest.approx(stats.chi2.ppf(0.99, freedom) / freedom, rel=2e-3)


def test_choice_prefers_the_mechanical_forward_fit() -> None:
    def candidate(loading: str, method: str, **more: object) -> dict[str, object]:
        return fit(loading=loading, method=method, selected=True, **more)

    best = candidate("mechanical", "forward", model_order=3)
    fits = [
        candidate("electrical", "forward"), candidate("mechanical", "corrected"), best, candidate("joint", "forward"),
        candidate("mechanical", "forward", extension="slack"),
    ]  # fmt: skip
    assert evidence.choice(fits) is best
    assert evidence.choice([]) is None


@pytest.mark.parametrize(
    ("count", "total", "low", "high"), [(0, 10, 0.0, 0.3085), (10, 10, 0.6915, 1.0), (7, 20, 0.1539, 0.5922)]
)
def test_exact_limits_of_a_share(count: int, total: int, low: float, high: float) -> None:
    assert clopper_pearson(count, total) == pytest.approx((low, high), abs=1e-4)


def test_which_film_of_the_literature() -> None:
    assert reference("VHB 4910", {"layers": "10"}) is STACK
    assert reference("polyacrylate", {}) is POLYACRYLATE
    assert reference("PlatSil 7315", {"layers": "x"}) is SILICONE
    assert reference("PET", {}) is None
    assert reference(None, {}) is None
