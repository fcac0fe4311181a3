"""Large cycles: recursion against adaptive integration, recovery of branches, refusals."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pipeline.analyse.cycle import Cycle, cycle_fits, cycle_tables
from pipeline.analyse.model_fits import model_fits_table
from pipeline.fit.relaxation.time_domain import fit_cycle
from pipeline.physics.film import integrate_arms
from pipeline.physics.hyperelastic import LAWS, NEO_HOOKEAN, NON_AFFINE, OGDEN, Law
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording
from tests.physics.rig_truth import recording

TIME = np.unique(np.concatenate([np.arange(0, 12, 0.02), [6.01, 6.03]]))
STRETCH = 1 + np.where(TIME < 6, 0.5 * TIME, 3 - 0.5 * (TIME - 6) * 0.9)


def overstress(tau: float) -> np.ndarray:
    """dQ/dt + Q/τ = dλ/dt by adaptive integration on each straight piece."""

    def rate(t: float, q: np.ndarray) -> np.ndarray:
        return (0.5 if t < 6 else -0.45) - q / tau

    up = solve_ivp(rate, (0, 6), [0.0], rtol=1e-10, atol=1e-12, max_step=0.05, dense_output=True)
    down = solve_ivp(rate, (6, 13), up.y[:, -1], rtol=1e-10, atol=1e-12, max_step=0.05, dense_output=True)
    return np.where(TIME <= 6, up.sol(np.minimum(TIME, 6))[0], down.sol(np.maximum(TIME, 6))[0])


@pytest.mark.parametrize("tau", [0.05, 1.0, 20.0])
def test_recursion_is_exact_on_uneven_samples(tau: float) -> None:
    assert np.allclose(integrate_arms(TIME, STRETCH, np.array([tau]))[:, 0], overstress(tau), atol=1e-7)


def test_arms_side_by_side_know_nothing_of_each_other() -> None:
    times = np.array([20.0, 0.05, 1.0])
    alone = [integrate_arms(TIME, STRETCH, tau[None])[:, 0] for tau in times]
    assert np.array_equal(integrate_arms(TIME, STRETCH, times), np.transpose(alone))


@pytest.mark.parametrize("law", list(LAWS.values()), ids=list(LAWS))
def test_laws_are_at_rest_at_stretch_one_and_stiffen_with_their_moduli(law: object) -> None:
    moduli = dict.fromkeys(law.moduli, 10.0) | dict.fromkeys(law.signed, 0.0)  # type: ignore[attr-defined]
    parameters = moduli | ({law.shape: 5.0} if law.shape else {})  # type: ignore[attr-defined]
    stress = law.stress(np.array([1.0, 1.01, 2.0]), parameters)  # type: ignore[attr-defined]
    assert stress[0] == pytest.approx(0.0, abs=1e-12)
    assert np.all(np.diff(stress) > 0)


@pytest.mark.parametrize("law", list(LAWS.values()), ids=list(LAWS))
def test_a_law_of_several_parameters_at_once_is_that_of_each(law: Law) -> None:
    stretch = np.linspace(0.9, 3.0, 7)
    entries = np.array([[10.0, 20.0, 4.0], [7.0, 30.0, 2.5]])[:, -len(law.names) :]
    alone = [law.stress(stretch, dict(zip(law.names, one, strict=True))) for one in entries.tolist()]
    assert np.allclose(law.stress_of(stretch, entries), alone, rtol=1e-14)


def test_ogden_with_exponent_two_is_neo_hookean() -> None:
    stretch = np.linspace(0.7, 4, 20)
    ogden = OGDEN.stress(stretch, {"shear_modulus": 3.0, "exponent": 2.0})
    assert np.allclose(ogden, NEO_HOOKEAN.stress(stretch, {"shear_modulus": 3.0}))


def test_two_branches_and_the_law_are_recovered() -> None:
    rng = np.random.default_rng(seed=0)
    base = 12.0 * (STRETCH - STRETCH**-2)
    stress = base + 30 * overstress(8.0) + 60 * overstress(0.4) + 0.02 * rng.normal(size=TIME.size)
    fits = fit_cycle(TIME, STRETCH, stress, law=NEO_HOOKEAN, specimen_id="s")
    assert fits.selected_order == 2
    two = fits.selected
    assert two.gamma == (pytest.approx(30, rel=0.03), pytest.approx(60, rel=0.03))
    assert two.tau == (pytest.approx(8.0, rel=0.05), pytest.approx(0.4, rel=0.05))
    assert two.equilibrium["shear_modulus"] == pytest.approx(12.0, rel=0.02)
    assert two.correlation < 0.2
    assert two.rmse == pytest.approx(0.02, rel=0.1)
    one = fits.fits[0]
    assert one.correlation > 0.9
    assert any("discrepancy" in w for w in one.warnings)
    row = model_fits_table([], [fits]).to_pylist()[1]
    assert row["method"] == "time_domain"
    assert row["selected"]
    assert row["k1_n_per_mm"] == pytest.approx(0.030, rel=0.03)
    assert row["c2_n_s_per_mm"] == pytest.approx(0.024, rel=0.05)
    assert row["k0_n_per_mm"] == pytest.approx(0.036, rel=0.02)  # slope 3 μ at stretch 1


@pytest.mark.slow
def test_orders_are_tried_on_until_none_predicts_better() -> None:
    """Four branches, a decade apart: a third order would be the highest of the usual ones, and not enough."""
    time = np.unique(np.concatenate([np.geomspace(1e-3, 60, 500), 60 + np.geomspace(1e-3, 55, 500)]))
    stretch = 1 + 0.05 * (60 - np.abs(60 - time))
    branches = integrate_arms(time, stretch, np.array([0.1, 1.0, 8.0, 60.0])) @ np.array([400.0, 120.0, 50.0, 30.0])
    stress = 12.0 * (stretch - stretch**-2) + branches
    fits = fit_cycle(time, stretch, stress, law=NEO_HOOKEAN, equilibrium={"shear_modulus": 12.0})
    assert fits.selected_order >= 4
    best = min(fit.held_out_rmse for fit in fits.fits)
    assert fits.selected.held_out_rmse < 1.2 * best
    (few,) = (fit_cycle(time, stretch, stress, law=NEO_HOOKEAN, equilibrium={"shear_modulus": 12.0}, orders=(1, 2)),)
    assert any("none above it was tried" in warning for warning in few.warnings)


def test_given_law_is_not_fitted() -> None:
    given = {"crosslink_modulus": 8.0, "entanglement_modulus": 18.0, "largest_stretch": 4.8}
    stress = NON_AFFINE.stress(STRETCH, given) + 30 * overstress(5.0)
    fits = fit_cycle(TIME, STRETCH, stress, equilibrium=given, orders=(1,))
    assert fits.fixed
    assert fits.selected.equilibrium == given
    assert fits.selected.tau[0] == pytest.approx(5.0, rel=1e-3)


@pytest.mark.slow
def test_a_ramp_gives_no_negative_moduli_and_says_what_it_cannot_tell() -> None:
    """Loading alone: equilibrium and slow branches look alike, and what comes after is anybody's guess."""
    rng = np.random.default_rng(seed=1)
    time = np.arange(0, 6, 0.1)
    stretch = 1 + 0.5 * time
    stress = 40 * (1 - np.exp(-(stretch - 1) / 0.4)) + 0.5 * rng.normal(size=time.size)
    fits = fit_cycle(time, stretch, stress)
    for fit in fits.fits:
        assert fit.equilibrium["crosslink_modulus"] >= 0
        assert fit.equilibrium["entanglement_modulus"] >= 0
        assert fit.held_out_rmse < 1e3
    assert any("at its bound 0" in w for fit in fits.fits for w in fit.warnings)
    missed = fit_cycle(
        time, stretch, np.where(time < 4.2, 20 * (stretch - 1), -80.0) + 0.1 * rng.normal(size=time.size)
    )
    assert any("left out is missed by more than its own size" in w for w in missed.selected.warnings)


def test_all_orders_on_the_same_cycle_reach_the_tables() -> None:
    stress = 12.0 * (STRETCH - STRETCH**-2) + 30 * overstress(5.0)
    fits = fit_cycle(TIME, STRETCH, stress, law=NEO_HOOKEAN, orders=(1, 2), recording_id="r", specimen_id="s")
    tables = cycle_tables(Cycle(TIME + 5.0, STRETCH, stress, (fits,)))
    rows, curves = (tables[name].to_pylist() for name in ("cycle_fits", "cycle_curves"))
    assert [(r["recording_id"], r["law_given"], r["model_order"]) for r in rows] == [("r", False, 1), ("r", False, 2)]
    assert sum(r["selected"] for r in rows) == 1
    branches = json.loads(rows[0]["branches"])
    assert branches[0]["gamma_kpa"] * branches[0]["tau_s"] == pytest.approx(branches[0]["eta_kpa_s"])
    assert rows[0]["held_out_from_s"] == pytest.approx(5 + 0.7 * TIME[-1])
    first = [c for c in curves if c["model_order"] == 1]
    assert len(first) <= 400
    assert first[0]["time_s"] == 5.0
    off = np.array([c["modelled_kpa"] - c["measured_kpa"] for c in first])
    assert np.sqrt(np.mean(off**2)) == pytest.approx(rows[0]["rmse_kpa"], rel=0.3, abs=1e-6)


def cycle_recording(**keys: float) -> Recording:
    about = RecordingMetadata(
        recording_id="c", protocol="cycle", loading="mechanical", specimen_id="s",
        started_at=datetime(2024, 3, 4, tzinfo=UTC), **keys,
    )  # fmt: skip
    stamps = np.rint(TIME * 1e9).astype(np.int64)
    given = {"crosslink_modulus": 8.0, "entanglement_modulus": 18.0, "largest_stretch": 4.8}
    noise = 0.05 * np.random.default_rng(seed=2).normal(size=TIME.size)
    stress = NON_AFFINE.stress(STRETCH, given) + 30 * overstress(5.0) + noise
    channels = {"stretch": Channel("stretch", stamps, STRETCH), "stress": Channel("stress", stamps, stress)}
    return Recording(about, RigConstants(), channels)


@pytest.mark.slow
def test_a_law_that_the_recording_gives_stands_beside_the_fitted_one() -> None:
    law = {"crosslink_modulus_kpa": 8.0, "entanglement_modulus_kpa": 18.0, "largest_stretch": 4.8}
    given, fitted = cycle_fits(cycle_recording(**law)).fits
    assert given.fixed
    assert not fitted.fixed
    assert given.fits[0].tau[0] == pytest.approx(5.0, rel=0.01)
    (alone,) = cycle_fits(cycle_recording()).fits
    assert not alone.fixed
    with pytest.raises(NotIdentifiableError, match="only crosslink_modulus is given"):
        cycle_fits(cycle_recording(crosslink_modulus_kpa=8.0))


def test_offset_and_gap_are_noticed() -> None:
    keep = (TIME < 2) | (TIME > 2.1)
    stress = 12 * (STRETCH - STRETCH**-2) + 30 * overstress(1.0) + 3.0
    fits = fit_cycle(TIME[keep], STRETCH[keep], stress[keep], law=NEO_HOOKEAN, orders=(1,))
    assert any("offset" in w for w in fits.warnings)
    assert any("one\N{NO-BREAK SPACE}gap" in w for w in fits.warnings)


@pytest.mark.parametrize(
    ("time", "stretch", "words"),
    [
        (TIME[:5], STRETCH[:5], "5 samples"),
        (TIME[::-1], STRETCH, "do not rise"),
        (TIME, np.full(TIME.size, 1.2), "stretch from"),
    ],
)
def test_what_is_no_cycle_is_refused(time: np.ndarray, stretch: np.ndarray, words: str) -> None:
    with pytest.raises(NotIdentifiableError, match=words):
        fit_cycle(time, stretch, np.ones(time.size))


def test_a_film_of_known_size_has_its_own_stiffness() -> None:
    """E w t/L: a film of 50 × 20 × 0.2 mm has 0.08 N/mm for each MPa, a cube of 1 mm has 1 N/mm."""
    given = {"crosslink_modulus": 8.0, "entanglement_modulus": 18.0, "largest_stretch": 4.8}
    stress = NON_AFFINE.stress(STRETCH, given) + 30 * overstress(5.0)
    rows = []
    for ratio in (None, 20 * 0.2 / 50):
        fits = fit_cycle(TIME, STRETCH, stress, equilibrium=given, orders=(1,), section_over_length_mm=ratio)
        rows += model_fits_table([], [fits]).to_pylist()
    cube, film = rows
    for name in ("k0_n_per_mm", "k1_n_per_mm", "c1_n_s_per_mm", "k1_n_per_mm_sd"):
        assert film[name] == pytest.approx(0.08 * cube[name], rel=1e-9)
    assert "1 mm cube" in cube["warnings"]
    assert "section over length is 0.08 mm" in film["warnings"]


@pytest.mark.long_after(2)
@pytest.mark.parametrize(
    "sizes",
    [
        {"film_length_mm": 50},
        {"film_width_mm": 20, "film_thickness_mm": 0.2},
        {"film_length_mm": 50, "film_width_mm": 20},
    ],
)
def test_sizes_that_are_not_known_do_not_change_the_stiffness_that_was_measured(sizes: dict[str, float]) -> None:
    """Force over displacement is that of the film in N/mm, whichever cross-section is assumed between them."""
    given = {"crosslink_modulus": 8.0, "entanglement_modulus": 18.0, "largest_stretch": 4.8}
    force = 1e-3 * 4 * NON_AFFINE.stress(STRETCH, given)  # of 50 × 20 × 0.2 mm
    length = sizes.get("film_length_mm", 1.0)
    ns = np.rint(TIME * 1e9).astype(np.int64)
    channels = {
        "displacement": Channel("displacement", ns, (STRETCH - 1) * length),
        "force": Channel("force", ns, force),
    }
    about = {
        "recording_id": "c", "protocol": "cycle", "loading": "mechanical", "specimen_id": "S", "stretch_1": 1,
        "started_at": "1970-01-01T00:00:00Z",
    }  # fmt: skip
    recording = Recording(RecordingMetadata.parse({**about, **sizes}), RigConstants.parse({}), channels)
    (fits,) = cycle_fits(recording).fits
    slope = np.diff(NON_AFFINE.stress(np.array([1 - 1e-5, 1 + 1e-5]), given))[0] / 2e-5
    selected = next(row for row in model_fits_table([], [fits]).to_pylist() if row["selected"])
    assert selected["k0_n_per_mm"] == pytest.approx(1e-3 * 4 * slope / length, rel=0.02)


@pytest.mark.parametrize("start_mm", [-3.0, 0.0, 20.0])
def test_a_cycle_of_a_film_of_unknown_length_has_the_stiffness_of_its_force(start_mm: float) -> None:
    """Its stretch is not known, so that no law of stretch can hold: a spring about wherever it began."""
    rng = np.random.default_rng(8)
    time = np.arange(0, 48, 0.02)
    moved = 6.0 * (1 - np.abs(2 * (time / 8 % 1) - 1))
    arms = integrate_arms(time, moved, np.array([1.5, 20.0])) @ np.array([0.1, 0.06])
    force = 3.36 + 0.18 * moved + arms + rng.normal(0, 2e-3, time.size)
    made = recording({"displacement": start_mm + moved, "force": force}, 50.0, protocol="cycle")
    (group,) = cycle_fits(made).fits
    fit = group.selected
    assert group.law == "linear"
    assert group.slope_at_rest(fit) * group.n_per_mm_of_kpa == pytest.approx(0.18, rel=0.02)
    assert np.array(fit.gamma[:2]) * group.n_per_mm_of_kpa == pytest.approx([0.06, 0.1], rel=0.05)
    assert not any("bound" in warning or "offset" in warning for warning in fit.warnings + group.warnings)
