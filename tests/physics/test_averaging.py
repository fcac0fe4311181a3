"""Averages of recordings: complex, weighted, with the spread between amplitudes kept."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.transform.averaging import average
from pipeline.transform.response import STIFFNESS, FrequencyResponse

F = np.geomspace(1, 100, 60)
TRUE = 2.0 * (1j * F) ** 0.3


def made(value, sd, *, f=F, amplitude=None, name=None, usable=None, systematic=None) -> FrequencyResponse:
    return FrequencyResponse(
        frequency_hz=f,
        value=value,
        variance=np.broadcast_to(np.asarray(sd, dtype=float) ** 2, f.shape).copy(),
        usable=np.ones(f.shape, dtype=bool) if usable is None else usable,
        quantity=STIFFNESS,
        loading="mechanical",
        amplitude=amplitude,
        recording_id=name,
        specimen_id="film-1",
        systematic=systematic,
    )


def noise(rng, sd, n=F.size):
    return sd * (rng.normal(size=n) + 1j * rng.normal(size=n)) / np.sqrt(2)


def test_repeats_of_one_amplitude_average_down() -> None:
    rng = np.random.default_rng(seed=0)
    ratios = []
    for _ in range(20):
        sds = (0.01, 0.02, 0.05)
        result = average([made(TRUE + noise(rng, s), s, amplitude=0.05, name=str(s)) for s in sds])
        ratios.append(np.abs(result.value - TRUE) ** 2 / result.variance)
    # A spread that cannot be negative leaves the error a little wide where there is none.
    assert 0.7 < np.mean(ratios) < 1.1
    assert result.amplitude == pytest.approx(0.05)
    assert result.recording_id is None
    assert result.repeats == 3
    best = 1 / sum(1 / s**2 for s in sds)
    assert best <= np.median(result.variance) < 1.5 * best


def test_spread_between_strains_is_found_and_widens_the_error() -> None:
    rng = np.random.default_rng(seed=1)
    spread, sd, found, ratios = 0.1, 0.02, [], []
    for _ in range(30):
        strains = [0.05, 0.1, 0.15, 0.2, 0.25, 0.3]
        factors = 1 + spread * rng.normal(size=6) / np.abs(TRUE).mean()
        result = average(
            [made(TRUE * g + noise(rng, sd), sd, amplitude=a) for a, g in zip(strains, factors, strict=True)]
        )
        relative = result.between_spread * np.abs(TRUE).mean() / np.abs(TRUE)
        found.append(np.mean(relative**2))
        ratios.append(np.mean(np.abs(result.value - TRUE) ** 2 / result.variance))
    assert np.sqrt(np.mean(found)) == pytest.approx(spread, rel=0.15)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.4)
    assert result.amplitude is None
    assert result.details["amplitudes"] == strains


def test_an_amplitude_measured_often_does_not_outweigh_the_others() -> None:
    rng = np.random.default_rng(seed=2)
    several = [made(TRUE * 0.8 + noise(rng, 0.01), 0.01, amplitude=0.1) for _ in range(8)]
    result = average([made(TRUE * 1.2 + noise(rng, 0.01), 0.01, amplitude=0.05), *several])
    np.testing.assert_allclose(result.value / TRUE, 1.0, atol=0.03)
    assert result.details["recordings_per_amplitude"] == [1, 8]


def test_complex_average_is_not_that_of_magnitude_and_phase() -> None:
    rotated = [made(TRUE * np.exp(1j * angle), 0.01, amplitude=a) for angle, a in ((1.0, 0.1), (-1.0, 0.2))]
    result = average(rotated)
    np.testing.assert_allclose(np.abs(result.value), np.cos(1.0) * np.abs(TRUE), rtol=1e-6)


def test_grids_that_differ_meet_within_one_percent() -> None:
    shifted = F * 1.004
    result = average(
        [made(TRUE, 0.001, amplitude=0.1), made(2.0 * (1j * shifted) ** 0.3, 0.001, f=shifted, amplitude=0.2)]
    )
    np.testing.assert_array_equal(result.frequency_hz, F)
    # Brought along its own slope: without that the second would be 0.12 % high.
    assert np.abs(result.value / TRUE - 1).max() < 2e-4
    low = np.geomspace(0.01, 0.5, 10)
    joined = average([made(TRUE, 0.01, amplitude=0.1), made(2.0 * (1j * low) ** 0.3, 0.01, f=low, amplitude=0.2)])
    assert joined.frequency_hz.size == 70
    assert np.all(np.diff(joined.frequency_hz) > 0)
    assert np.isnan(joined.between_spread).all()


def test_full_multisine_lines_stay_apart() -> None:
    lines = np.arange(1.0, 101.0)
    value = np.exp(1j * lines)
    result = average([made(value, 0.1, f=lines, amplitude=a) for a in (1.0, 2.0)])
    np.testing.assert_array_equal(result.frequency_hz, lines)
    np.testing.assert_allclose(result.value, value)


def test_unusable_lines_do_not_count() -> None:
    good = np.ones(F.size, dtype=bool)
    good[:10] = False
    wrong = np.where(good, TRUE, 100.0)
    first = made(wrong, 0.01, amplitude=0.1, usable=good).mark(~good, "resonance")
    result = average([first, made(TRUE, 0.01, amplitude=0.2)])
    np.testing.assert_allclose(result.value, TRUE)
    assert result.usable.all()
    both = average([first, made(wrong, 0.01, amplitude=0.2, usable=good)])
    assert not both.usable[:10].any()
    assert both.unusable_because[0] == "resonance"
    assert np.isnan(both.variance[:10]).all()


def test_what_recordings_share_does_not_average_down() -> None:
    systematic = (0.03 * TRUE)[:, None]
    result = average([made(TRUE, 0.01, amplitude=a, systematic=systematic) for a in (0.1, 0.1, 0.2, 0.3)])
    np.testing.assert_allclose(result.systematic, systematic)


def test_kinds_are_not_mixed() -> None:
    with pytest.raises(ValueError, match="no responses"):
        average([])
    with pytest.raises(ValueError, match="several kinds"):
        average([made(TRUE, 0.1), FrequencyResponse(F, TRUE, F, F > 0, "output_per_input", "other")])


@given(order=st.permutations(range(5)), scale=st.floats(1e-3, 1e3))
@settings(max_examples=25, deadline=None)
def test_order_and_unit_do_not_matter(order, scale) -> None:
    rng = np.random.default_rng(seed=7)
    several = [(TRUE * (1 + 0.05 * i) + noise(rng, 0.02), 0.05 * (1 + i % 3)) for i in range(5)]
    base = average([made(v, 0.02, amplitude=a) for v, a in several])
    other = average([made(scale * several[i][0], scale * 0.02, amplitude=several[i][1]) for i in order])
    np.testing.assert_allclose(other.value, scale * base.value, rtol=1e-9)
    np.testing.assert_allclose(other.variance, scale**2 * base.variance, rtol=1e-6)
    np.testing.assert_allclose(other.between_spread, scale * base.between_spread, rtol=1e-6, atol=1e-12 * scale)
