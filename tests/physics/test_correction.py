"""Clamp and load cell taken out: against the published tables, finite differences and drawn constants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics.rig import RigPrior
from pipeline.transform.correction import (
    blocked_force,
    calibrated,
    correct_mechanical,
    judged_machine,
    resonance_free,
)
from pipeline.transform.response import FORCE_PER_VOLTAGE_SQUARED, STIFFNESS, FrequencyResponse
from schemas.errors import NotIdentifiableError
from tests.physics.rig_truth import POLYACRYLATE, Truth

FREQUENCIES = np.array([10.0, 40.0, 52.0, 60.0, 90.0])
PER_VOLTAGE = 2.1e-3


def polar(magnitude: float, degrees: float) -> complex:
    return magnitude * np.exp(1j * np.radians(degrees))


def response(
    frequency: np.ndarray, value: np.ndarray, *, electrical: bool = False, relative: float = 0.001
) -> FrequencyResponse:
    return FrequencyResponse(
        frequency_hz=frequency,
        value=value,
        variance=(relative * np.abs(value)) ** 2,
        usable=np.ones(frequency.shape, dtype=bool),
        quantity=FORCE_PER_VOLTAGE_SQUARED if electrical else STIFFNESS,
        loading="electrical" if electrical else "mechanical",
    )


# f_c = 52 Hz, ζ = 0.5 %, kL = 5.34 N/mm, film of table 4.3, from an integration in time: k, printed 4.21, raw G
MECHANICAL = [
    (10.0, (3.945, 44.0), (4.248, 43.8), (2.495, 25.0)),
    (40.0, (7.638, 48.9), (29.77, 47.8), (4.410, 10.1)),
    (60.0, (9.854, 51.4), (69.3, -127.0), (5.900, -9.2)),
    (90.0, (13.165, 51.7), (26.4, -128.0), (6.562, -51.8)),
]
# raw F/F_A, printed 4.22, kL/(kL + k)
ELECTRICAL = [
    (10.0, (0.632, -19.0), (0.671, -19.5), (0.619, -18.6)),
    (40.0, (0.577, -38.8), (1.202, -55.1), (0.450, -29.2)),
    (52.0, (0.593, -50.9), (1.526, -87.2), (0.409, -32.4)),
    (60.0, (0.599, -60.6), (1.511, -109.4), (0.385, -34.1)),
    (90.0, (0.498, -103.4), (1.006, -150.6), (0.313, -37.6)),
]


@pytest.mark.parametrize(("frequency", "true", "printed", "raw"), MECHANICAL)
def test_mechanical_table(frequency, true, printed, raw) -> None:
    truth = Truth()
    measured = response(np.array([frequency]), np.array([polar(*raw)]))
    # The table's raw values have four digits; the inversion of the exact ones is held by the next test.
    assert truth.measured(np.array([frequency]))[0] == pytest.approx(polar(*raw), rel=2e-3)
    exact = response(np.array([frequency]), truth.measured(np.array([frequency])))
    assert correct_mechanical(exact, truth.constants()).value[0] == pytest.approx(polar(*true), rel=2e-3)
    wrong = correct_mechanical(exact, truth.constants(), thesis_sign=True).value[0]
    assert abs(wrong) == pytest.approx(printed[0], rel=5e-3)
    assert np.degrees(np.angle(wrong)) == pytest.approx(printed[1], abs=0.6)
    assert measured.usable.all()


def test_at_the_clamp_frequency_nothing_is_left() -> None:
    truth = Truth()
    at = np.array([52.0])
    exact = response(at, truth.measured(at))
    assert correct_mechanical(exact, truth.constants()).value[0] == pytest.approx(polar(8.961, 50.7), rel=2e-3)
    assert not correct_mechanical(exact, truth.constants()).usable[0]
    printed = correct_mechanical(exact, truth.constants(), thesis_sign=True).value[0]
    assert abs(printed) == pytest.approx(1792, rel=0.01)
    assert np.degrees(np.angle(printed)) == pytest.approx(-39, abs=1)


@pytest.mark.parametrize(("frequency", "raw", "printed", "free"), ELECTRICAL)
def test_electrical_table(frequency, raw, printed, free) -> None:
    truth, at = Truth(), np.array([frequency])
    ratio = truth.ratio(at)
    assert ratio[0] == pytest.approx(polar(*raw), rel=2e-3)
    wrong = resonance_free(ratio, at, truth.constants(), thesis_sign=True)[0]
    assert wrong == pytest.approx(polar(*printed), rel=4e-3)
    # The table keeps the damper of the load cell in: kL/(kL + k + jωcL).
    undamped = truth.constants(load_cell_damping_n_s_per_mm=0.0)
    assert resonance_free(ratio, at, undamped)[0] == pytest.approx(polar(*free), rel=4e-3)
    expected = truth.load_cell / (truth.load_cell + truth.stiffness(at))
    assert resonance_free(ratio, at, truth.constants())[0] == pytest.approx(expected[0], rel=1e-12)


def test_blocked_force_is_flat_for_the_right_stiffness() -> None:
    truth, f = Truth(), np.linspace(1, 100, 60)
    run = response(f, PER_VOLTAGE * truth.ratio(f), electrical=True)
    blocked = blocked_force(run, truth.stiffness(f), truth.constants())
    np.testing.assert_allclose(blocked.value, PER_VOLTAGE, rtol=1e-12)
    np.testing.assert_allclose(blocked.amplification, 1.0)
    np.testing.assert_allclose(blocked.standard_error / np.abs(blocked.value), 0.001, rtol=1e-12)
    # The error of the clamp's mass bends it near the resonance; the prior says so.
    heavy = blocked_force(run, truth.stiffness(f), truth.constants(clamp_mass_kg=truth.mass * 1.03e3))
    spread = np.sqrt((np.abs(blocked.systematic) ** 2).sum(axis=1))
    assert np.abs(heavy.value - PER_VOLTAGE).max() > 0.04 * PER_VOLTAGE
    assert np.all(np.abs(heavy.value - PER_VOLTAGE) <= 1.001 * spread)


def test_an_elastic_film_comes_out_flat_with_the_derived_sign_only() -> None:
    truth, f = Truth(film=(3.0, (), ())), np.array([1, 10, 30, 45, 60, 80, 100.0])
    run = response(f, truth.measured(f))
    np.testing.assert_allclose(correct_mechanical(run, truth.constants()).value, 3.0, rtol=1e-9)
    printed = correct_mechanical(run, truth.constants(), thesis_sign=True).value.real
    assert printed.max() > 10
    assert printed.min() < -3


# kL, amplification at 5, 40, 50, 51, 60, 100 Hz, and what 1 % of the mass costs at 50 and 51 Hz
AMPLIFICATION = [
    (5.3, (1.42, 4.23, 22.4, 44.2, 5.01, 0.86)),
    (35.0, (1.06, 1.41, 4.0, 7.3, 0.81, 0.91)),
]


@pytest.mark.parametrize(("load_cell", "table"), AMPLIFICATION)
def test_amplification_table(load_cell, table) -> None:
    truth = Truth(load_cell=load_cell, damping_ratio=0.0)
    f = np.array([5, 40, 50, 51, 60, 100.0])
    corrected = correct_mechanical(response(f, truth.measured(f)), truth.constants())
    np.testing.assert_allclose(corrected.amplification, table, rtol=0.02)
    np.testing.assert_allclose(
        corrected.standard_error / np.abs(corrected.value), 0.001 * corrected.amplification, rtol=1e-9
    )
    heavier = correct_mechanical(response(f, truth.measured(f)), truth.constants(clamp_mass_kg=1.01e3 * truth.mass))
    cost = np.abs(heavier.value / corrected.value - 1)
    assert cost[2] == pytest.approx(0.12, abs=0.01)
    assert cost[3] == pytest.approx(0.25, abs=0.02)
    assert list(corrected.usable[corrected.amplification > 5]) == [False] * int((corrected.amplification > 5).sum())
    assert all("resonance" in why for why, a in zip(corrected.unusable_because, table, strict=True) if a > 5.01)


@pytest.mark.study
def test_variance_of_the_noise_against_draws() -> None:
    truth, f, rng = Truth(load_cell=20.0), np.array([5, 30, 45, 60, 90.0]), np.random.default_rng(seed=3)
    clean = truth.measured(f)
    run = response(f, clean, relative=0.01)
    noise = (rng.normal(size=(4000, 5)) + 1j * rng.normal(size=(4000, 5))) * 0.01 * np.abs(clean) / np.sqrt(2)
    drawn = np.array([correct_mechanical(replace(run, value=clean + e), truth.constants()).value for e in noise])
    expected = correct_mechanical(run, truth.constants()).variance
    np.testing.assert_allclose(np.mean(np.abs(drawn - truth.stiffness(f)) ** 2, axis=0), expected, rtol=0.08)


def test_systematic_covariance_against_drawn_constants() -> None:
    truth, f, rng = Truth(load_cell=20.0), np.array([5, 30, 44, 60, 90.0]), np.random.default_rng(seed=4)
    sd = {
        "clamp_mass_kg_sd": 2e-3 * truth.mass * 1e3,
        "load_cell_stiffness_n_per_mm_sd": 1e-3 * truth.load_cell,
        "load_cell_damping_n_s_per_mm_sd": 0.2 * truth.damping,
    }
    run = response(f, truth.measured(f))
    corrected = correct_mechanical(run, truth.constants(**sd))
    covariance = corrected.systematic @ corrected.systematic.conj().T
    assert np.linalg.matrix_rank(covariance, tol=1e-12) <= 3
    drawn = np.array(
        [
            correct_mechanical(
                run,
                truth.constants(
                    clamp_mass_kg=truth.mass * 1e3 + sd["clamp_mass_kg_sd"] * a,
                    load_cell_stiffness_n_per_mm=truth.load_cell + sd["load_cell_stiffness_n_per_mm_sd"] * b,
                    load_cell_damping_n_s_per_mm=truth.damping + sd["load_cell_damping_n_s_per_mm_sd"] * c,
                ),
            ).value
            for a, b, c in rng.normal(size=(3000, 3))
        ]
    )
    error = drawn - drawn.mean(axis=0)
    found = error.T @ error.conj() / len(drawn)
    scale = np.sqrt(np.outer(np.diag(covariance).real, np.diag(covariance).real))
    assert np.abs((found - covariance) / scale).max() < 0.08


def test_a_measured_clamp_frequency_ties_mass_and_stiffness() -> None:
    truth, f = Truth(load_cell=20.0), np.array([40.0, 48.0, 56.0])
    run = response(f, truth.measured(f))
    damped = {"load_cell_damping_n_s_per_mm_sd": 0.1 * truth.damping}
    loose = correct_mechanical(run, truth.constants(**damped))
    tied = correct_mechanical(run, truth.constants(clamp_frequency_hz=52.0, clamp_frequency_hz_sd=0.03, **damped))
    before = np.sqrt((np.abs(loose.systematic) ** 2).sum(axis=1))
    after = np.sqrt((np.abs(tied.systematic) ** 2).sum(axis=1))
    assert np.all(after < 0.85 * before)
    # Mass and stiffness that move together leave the clamp's own frequency where it is.
    prior = RigPrior.of(truth.constants(clamp_frequency_hz=52.0, clamp_frequency_hz_sd=0.03))
    ratio = np.array([-1 / prior.rig.mass, 1 / prior.rig.stiffness, 0.0, 0.0])
    assert np.linalg.norm(ratio @ prior.factor) == pytest.approx(2 * 0.03 / 52.0, rel=1e-3)


def test_a_machine_that_gives_way_more_than_the_specimen_is_not_believed() -> None:
    """A specimen of k = kT r e^{jδ} in series with the transducer kT: amplification |1 + r e^{jδ}|, unusable beyond r = 1."""
    ratio = np.array([0.01, 0.5, 0.999, 1.2, 2.91])
    value = 90.0 * ratio * np.exp(0.2j)
    frequency = np.arange(1.0, 6.0)
    given = FrequencyResponse(frequency, value, np.full(5, np.nan), np.ones(5, bool), STIFFNESS, "mechanical")
    found = judged_machine(given, ratio)
    assert found.amplification == pytest.approx(np.abs(1 + ratio * np.exp(0.2j)))
    assert found.usable.tolist() == [True, True, True, False, False]
    assert found.unusable_because[4] == "the transducer deforms 2.9 times as much as the specimen"
    # what a phase error ψ of the transducer makes of the specimen: 1/k = 1/G − e^{jψ}/kT, loss off by r ψ of the storage
    wrong = 1 / (1 / value + 1 / 90 - np.exp(0.02j) / 90)
    assert (wrong - value).imag / value.real == pytest.approx(0.02 * ratio, rel=0.15)
    unknown = judged_machine(given, np.array([0.1, np.nan, 0.1, np.nan, 2.0]))
    assert np.isnan(unknown.amplification).tolist() == [False, True, False, True, False]
    assert unknown.usable.tolist() == [True, True, True, True, False]


def test_a_negative_loss_is_no_films() -> None:
    value = np.array([2 + 1j, 2 - 0.001j, 2 - 0.5j])

    def judged(sd: float) -> list[bool]:
        given = FrequencyResponse(
            np.arange(1.0, 4.0), value, np.full(3, sd**2), np.ones(3, bool), STIFFNESS, "mechanical"
        )
        found = judged_machine(given, None)
        assert found.amplification is None
        assert all(
            "negative loss" in why for why, good in zip(found.unusable_because, found.usable, strict=True) if not good
        )
        return [bool(good) for good in found.usable]

    assert judged(np.nan) == [True, False, False]
    assert judged(0.01) == [True, True, False]


@pytest.mark.parametrize("key", ["clamp_mass_kg", "load_cell_stiffness_n_per_mm"])
def test_missing_constants_are_named(key) -> None:
    truth, f = Truth(), FREQUENCIES
    with pytest.raises(NotIdentifiableError, match=key):
        correct_mechanical(response(f, truth.measured(f)), truth.constants(**{key: None}))
    with pytest.raises(NotIdentifiableError, match=key):
        blocked_force(response(f, truth.ratio(f), electrical=True), truth.stiffness(f), truth.constants(**{key: None}))


def test_missing_deviations_and_damping_are_said() -> None:
    truth = Truth()
    corrected = correct_mechanical(
        response(FREQUENCIES, truth.measured(FREQUENCIES)), truth.constants(load_cell_damping_n_s_per_mm=None)
    )
    assert any("damping" in text for text in corrected.details["assumed"])
    assert any("mass" in text for text in corrected.details["assumed"])


def test_the_force_gain_is_taken_out_once() -> None:
    truth, f = Truth(), np.array([5.0, 20.0])
    run = response(f, 1.05 * truth.measured(f))
    rig = truth.constants(force_gain=1.05, force_gain_sd=0.001)
    once = calibrated(run, rig)
    np.testing.assert_allclose(once.value, truth.measured(f), rtol=1e-12)
    assert calibrated(once, rig) is once
    corrected = correct_mechanical(once, rig)
    np.testing.assert_allclose(corrected.value, truth.stiffness(f), rtol=1e-9)
    assert corrected.systematic.shape == (2, 4)


@given(
    load_cell=st.floats(2, 200),
    clamp=st.floats(20, 300),
    zeta=st.floats(0, 0.05),
    k0=st.floats(0.05, 10),
    k1=st.floats(0, 50),
    tau=st.floats(1e-4, 1),
)
@settings(max_examples=60, deadline=None)
def test_forward_and_inverse_undo_each_other(load_cell, clamp, zeta, k0, k1, tau) -> None:
    truth = Truth((k0, (k1,), (k1 * tau,)) if k1 > 1e-3 else (k0, (), ()), load_cell, clamp, zeta)
    f = np.geomspace(0.5, 150, 30)
    f = f[np.abs(f / clamp - 1) > 0.02]
    rig = RigPrior.of(truth.constants()).rig
    k, clamp = truth.stiffness(f), rig.clamp(2 * np.pi * f)
    np.testing.assert_allclose(rig.mechanical(k, clamp), truth.measured(f), rtol=1e-9)
    np.testing.assert_allclose(rig.electrical(k, clamp), truth.ratio(f), rtol=1e-9)
    corrected = correct_mechanical(response(f, truth.measured(f)), truth.constants())
    np.testing.assert_allclose(corrected.value, truth.stiffness(f), rtol=1e-6)
    np.testing.assert_allclose(corrected.amplification, np.abs(1 + k / (rig.stiffness * clamp)), rtol=1e-6)


def test_table_4_3_film_is_the_one_meant() -> None:
    assert Truth(film=POLYACRYLATE).stiffness(np.array([10.0]))[0] == pytest.approx(polar(3.945, 44.0), rel=1e-3)
