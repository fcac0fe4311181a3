"""Master curves: shifts and laws against a truth in closed form, what does not superpose is said with numbers."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.transform.shift_laws import ARRHENIUS, WLF, fit_shift_laws
from pipeline.transform.superposition import Superposition, superpose
from pipeline.transform.superposition_fit import Isotherm
from schemas.errors import NotIdentifiableError
from tests.helpers.viscoelastic_truth import (
    C1,
    C2,
    REFERENCE,
    TEMPERATURES,
    cole_cole,
    frequency_isotherms,
    log_shift,
    relaxation_isotherms,
)


@pytest.fixture(scope="module")
def master() -> Superposition:
    return superpose(frequency_isotherms(np.random.default_rng(1)), reference_c=REFERENCE)


def test_shifts_are_those_of_the_truth(master: Superposition) -> None:
    assert [s.temperature_c for s in master.shifts] == list(TEMPERATURES)
    for s in master.shifts:
        assert abs(s.log_a - log_shift(s.temperature_c)) <= 4 * max(s.log_a_sd, 1e-12)
        assert s.fixed is (s.temperature_c == REFERENCE)
    assert max(s.log_a_sd for s in master.shifts) < 0.02
    assert not master.warnings
    assert master.magnitude_noise == pytest.approx(0.01, rel=0.3)
    assert master.phase_noise_deg == pytest.approx(np.degrees(0.003), rel=0.3)


def test_the_curve_is_the_films_at_the_reference(master: Superposition) -> None:
    frequency = np.geomspace(0.01, 500.0, 40)
    assert np.abs(master.stiffness(frequency) / cole_cole(2 * np.pi * frequency, REFERENCE) - 1).max() < 0.02


def test_constants_of_the_law(master: Superposition) -> None:
    best, other = fit_shift_laws(master)
    assert (best.law, other.law) == (WLF, ARRHENIUS)
    assert best.c1 is not None
    assert best.c2_k is not None
    assert best.c1.lower < C1 < best.c1.upper
    assert best.c2_k.lower < C2 < best.c2_k.upper
    assert best.p_value > 0.001 > other.p_value
    assert best.log_a(np.array([0.0, 60.0])) == pytest.approx([log_shift(0.0), log_shift(60.0)], abs=0.03)


def test_noise_that_is_stated_is_used_and_not_found_anew() -> None:
    exact = frequency_isotherms(np.random.default_rng(2))
    stated = [
        Isotherm(one.temperature_c, one.axis, one.value, (0.03 * np.abs(one.value)) ** 2, recording_id=one.recording_id)
        for one in exact
    ]
    wide, narrow = (superpose(given, reference_c=REFERENCE) for given in (stated, exact))
    assert wide.shifts[0].log_a_sd > 1.5 * narrow.shifts[0].log_a_sd


def test_relaxations_superpose_as_well() -> None:
    found = superpose(relaxation_isotherms(np.random.default_rng(3)), reference_c=REFERENCE)
    for s in found.shifts:
        assert abs(s.log_a - log_shift(s.temperature_c)) <= 4 * max(s.log_a_sd, 1e-12)
        assert np.isnan(s.phase_misfit_deg)
    assert np.isnan(found.phase_noise_deg)
    assert not found.warnings


def test_a_process_that_does_not_move_with_temperature_is_told_with_numbers() -> None:
    found = superpose(frequency_isotherms(np.random.default_rng(4), second=0.3), reference_c=REFERENCE)
    worst = max(found.shifts, key=lambda s: s.van_gurp_palmen_sd)
    assert found.p_value < 1e-6
    assert worst.van_gurp_palmen_sd > 3
    assert "leaves more than noise at" in found.warnings[0]
    assert "van Gurp-Palmen" in found.warnings[0]
    assert f"{100 * found.magnitude_noise:.2g} %" in found.warnings[0]


def test_vertical_shifts_are_asked_for_and_found() -> None:
    given = frequency_isotherms(np.random.default_rng(5), vertical=0.3)
    without, with_b = (superpose(given, reference_c=REFERENCE, vertical=free) for free in (False, True))
    assert without.vertical_p < 1e-6
    assert "vertical_shift" in without.warnings[-1]
    for s in with_b.shifts:
        assert s.b_lower <= np.exp(0.3 * (s.temperature_c - REFERENCE) / 100) * 1.005
        assert s.b_upper >= np.exp(0.3 * (s.temperature_c - REFERENCE) / 100) * 0.995
        assert abs(s.log_a - log_shift(s.temperature_c)) <= 4 * max(s.log_a_sd, 1e-12)
    assert not with_b.warnings


def test_limits_are_missing_where_nothing_limits_a_constant() -> None:
    """Two shifts alone, exactly those of an exponential: C₂ may be as large as it likes."""
    given = frequency_isotherms(np.random.default_rng(6), temperatures=(20.0, 25.0, 30.0), magnitude_noise=0.03)
    wlf = next(law for law in fit_shift_laws(superpose(given, reference_c=25.0)) if law.law == WLF)
    assert wlf.c2_k is not None
    assert np.isnan(wlf.c2_k.upper)
    assert wlf.c2_k.lower > 5


def test_one_temperature_is_no_master_curve() -> None:
    one = frequency_isotherms(np.random.default_rng(7), temperatures=(25.0,))
    for given in (one, [*one, *one]):
        with pytest.raises(NotIdentifiableError, match="one temperature"):
            superpose(given)


def test_a_law_with_a_constant_more_has_to_be_better() -> None:
    """Shifts after Arrhenius: WLF follows them as well, over seventy kelvins, and says no more."""
    lead = []
    for seed in range(24):
        rng = np.random.default_rng(100 + seed)
        frequency = np.geomspace(0.1, 50.0, 9)
        isotherms = []
        for celsius in (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0):
            a = np.exp(90e3 / 8.314462618 * (1 / (celsius + 273.15) - 1 / 303.15))
            exact = cole_cole(2 * np.pi * frequency * a, REFERENCE)
            noise = 0.004 * (rng.standard_normal(9) + 1j * rng.standard_normal(9))
            isotherms.append(Isotherm(celsius, frequency, exact * (1 + noise), np.full(9, np.nan)))
        laws = fit_shift_laws(superpose(isotherms, reference_c=30.0))
        (arrhenius,), (wlf,) = ([law for law in laws if law.law == name] for name in (ARRHENIUS, WLF))
        lead.append(arrhenius.chi2 - wlf.chi2 - np.log(6))
        assert laws[0] is (wlf if lead[-1] > 2 else arrhenius)
    assert any(0 < one < 2 for one in lead), "some draws have to ask"
