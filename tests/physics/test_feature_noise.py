"""Noise of features: its covariance against simulated noise, laws of channels, mains."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.diagnose.features.functionals import Component, Functionals
from pipeline.diagnose.features.kinds import REST_HUM, SPHS_RESPONSE, NoiseSample
from pipeline.diagnose.features.noise_density import NoiseLaw, noise_law, noise_sample
from pipeline.diagnose.features.records import thin, thinned_gain
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.simulation.mains import HUM_HZ, mains_components, mains_of
from pipeline.diagnose.simulation.session import make_session
from tests.helpers.truth_rig import Effect
from tests.helpers.truth_rig import make_session as true_session
from tests.helpers.truth_rig.material import random_specimen

HUMMING, STEPPING, SILENT = 104, 105, 106
"""Seeds of sessions: specimen, pauses and noise follow from them."""

Float = NDArray[np.float64]


def pink(samples: int, interval_s: float, rng: np.random.Generator, runs: int) -> Float:
    """(runs, samples) noise of density 1 Hz/f per Hz, out of a much longer record: frequencies below 1/T are in it."""
    size = 8 * samples
    f = np.fft.rfftfreq(size, interval_s)
    spectrum = rng.normal(size=(runs, f.size)) + 1j * rng.normal(size=(runs, f.size))
    spectrum[:, 0] = 0.0
    spectrum[:, 1:] *= np.sqrt(size / 2 / f[1:] / interval_s)
    return np.fft.irfft(spectrum, size, axis=1)[:, :samples]


def windows(*edges: tuple[int, int], rest: int, samples: int) -> Float:
    rows = np.zeros((len(edges), samples))
    for row, (a, b) in zip(rows, edges, strict=True):
        row[a:b] = 1 / (b - a)
        row[:rest] -= 1 / rest
    return rows


@pytest.mark.parametrize("stretch", [150, 400, 1000], ids=["start", "part", "whole"])
def test_pink_noise_moves_means_as_predicted(stretch: int) -> None:
    """Windows soon after the rest see noise that is slow against the stretch, late ones noise slower than the record."""
    samples, interval_s, runs = 1000, 0.01, 800
    kernels = windows((55, 90), (stretch - 60, stretch), rest=50, samples=stretch)
    predicted = Functionals(kernels, 0, samples, interval_s).covariances([Component("force", 1)])[0]
    seen = pink(samples, interval_s, np.random.default_rng(seed=3), runs)[:, :stretch] @ kernels.T
    spread = np.diag(np.cov(seen.T)) / np.diag(predicted)
    assert np.all(np.abs(spread - 1) < 4 * np.sqrt(2 / runs) + 0.03), spread


def test_pink_noise_between_windows_is_correlated_as_predicted() -> None:
    kernels = windows((60, 200), (200, 500), (500, 1000), rest=50, samples=1000)
    predicted = Functionals(kernels, 0, 1000, 0.01).covariances([Component("force", 1)])[0]
    seen = pink(1000, 0.01, np.random.default_rng(seed=4), 1000) @ kernels.T
    scale = np.sqrt(np.diag(predicted))
    assert np.cov(seen.T) / np.outer(scale, scale) == pytest.approx(predicted / np.outer(scale, scale), abs=0.12)


@pytest.mark.parametrize("samples", [1000, 1300, 5000])
def test_noise_of_any_frequency_is_counted_once(samples: int) -> None:
    """White noise through a gain of one is summed over frequencies: fine ones, then coarse ones, and nothing lost between them."""
    length, cycles = 1000, np.arange(2.0, 60.0, 0.25)
    window = np.hanning(length)
    kernels = window * np.cos(2 * np.pi * cycles[:, None] * np.arange(length) / length)
    seen = Functionals(kernels, 0, samples, 0.01)
    summed, exact = seen.covariances([Component("force", 0, np.ones_like), Component("force", 0)])
    assert np.diag(summed) == pytest.approx(np.diag(exact), rel=0.003)


@pytest.mark.parametrize("line_hz", HUM_HZ)
def test_a_hum_of_any_phase_adds_its_component(line_hz: float) -> None:
    rng = np.random.default_rng(seed=5)
    kernels = rng.normal(size=(3, 400))
    t = np.arange(400) * 1e-3
    predicted = Functionals(kernels, 0, 400, 1e-3).covariances([Component("mains", 0, None, line_hz)])[0]
    phase = rng.uniform(0, 2 * np.pi, 4000)
    seen = np.cos(2 * np.pi * line_hz * t + phase[:, None]) @ kernels.T
    assert np.cov(seen.T) == pytest.approx(predicted, abs=0.06 * np.abs(predicted).max())


def test_mains_that_thinning_takes_off_are_in_no_block() -> None:
    assert {c.name for c in mains_of()} == {"mains50/0", "mains100/0", "mains60/0", "mains120/0"}
    assert mains_of(lambda f: thinned_gain(f * 1e-3, 100)) == ()


@given(factor=st.integers(2, 12), cycles=st.floats(0.001, 0.45))
def test_thinning_passes_a_sinusoid_as_it_says(factor: int, cycles: float) -> None:
    t = np.arange(4000)
    wave = np.array([thin(np.cos(2 * np.pi * cycles * t + p), factor) for p in (0.0, np.pi / 2)])
    size = np.hypot(*wave)[30:-30]
    assert np.sqrt(np.mean(size**2)) == pytest.approx(float(thinned_gain(np.array(cycles), factor)), abs=2e-3)


def test_coefficients_of_mains_are_squares_of_amplitudes() -> None:
    assert mains_components({50.0: 0.004, 100.0: 0.001}) == pytest.approx({"mains50": 1.6e-5, "mains100": 1e-6})
    with pytest.raises(KeyError):
        mains_components({55.0: 0.004})


@pytest.mark.slow
def test_named_mains_leave_nothing_but_noise() -> None:
    """Until the hum is named its blocks are far above the noise; with its coefficients they are noise, and clean ones stay."""
    designs = (
        {"protocol": "chirp"},
        {"protocol": "step", "loading": "electrical", "drive_kv": 5.0},
        {"protocol": "sphs", "drive_kv": 5.5},
    )
    hum = Effect("mains_hum", 5e-3)
    loud = make_session([reduce(r) for r in true_session(HUMMING, designs, (hum,)).recordings])
    calm = make_session([reduce(r) for r in true_session(HUMMING, designs, ()).recordings])
    named = mains_components({50.0: 5e-3, 100.0: 5e-3 * hum.number("second")})
    laws = {(0, q): NoiseLaw(np.full(len(designs), c), 0.0, 0.0) for q, c in named.items()}
    quiet, told = replace(loud, laws=calm.laws), replace(loud, laws=calm.laws | laws)
    change = loud.value - calm.value
    change[loud.kind == REST_HUM] = 0.0
    before, after = quiet.whiten(change), told.whiten(change)
    assert before @ before > 3 * loud.size
    assert after @ after < 0.1 * loud.size
    # Mains and the noise of the line beside it: a rest tells how strong they are.
    of_rest = loud.kind == REST_HUM
    hums = np.isin(loud.covariate("frequency_hz"), (50.0, 100.0))
    assert loud.value[of_rest & hums].min() > 20
    assert np.abs(loud.value[of_rest & ~hums]).max() < 4
    # The noise beside them is read as without them.
    for law in ("white", "pink"):
        assert getattr(loud.laws[(0, "force")], law) == pytest.approx(getattr(calm.laws[(0, "force")], law), rel=0.25)


def test_a_rest_without_noise_says_nothing_of_mains() -> None:
    """There is no neighbourhood to hold them against, and no warning of a division by zero."""
    (recording,) = true_session(HUMMING, ({"protocol": "chirp"},), ()).recordings
    force, moved = recording.channels["force"], recording.channels["displacement"]
    rest = moved.time_ns < recording.start_ns + 1_000_000_000
    still = replace(recording, channels=dict(recording.channels))
    for channel in (force, moved):
        still.channels[channel.quantity] = replace(channel, values=np.where(rest, 0.3, channel.values))
    assert any(b.kind == REST_HUM for b in reduce(recording).blocks)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not any(b.kind == REST_HUM for b in reduce(still).blocks)


def samples_of(values: list[Float], interval_s: float = 1e-2) -> tuple[tuple[int, NoiseSample], ...]:
    found = [noise_sample("force", v, interval_s) for v in values]
    return tuple((i, s) for i, s in enumerate(found) if s is not None)


@pytest.mark.parametrize("level", [0.0, 1e-160, 1e-12, 1.0, 1e12])
def test_a_channel_of_any_level_has_a_law(level: float) -> None:
    """Channels that stand still (a command at zero) and such in odd units: finite laws, no overflow on the way."""
    rng = np.random.default_rng(seed=1)
    values = [level * rng.normal(size=400) for _ in range(3)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        law = noise_law(samples_of(values), 3)
    assert np.all(np.isfinite(law.white))
    assert np.isfinite([law.pink, law.red]).all()
    if level > 1e-100:
        assert law.white == pytest.approx(np.full(3, level**2), rel=0.3)


def test_one_still_recording_among_others_keeps_its_silence() -> None:
    rng = np.random.default_rng(seed=2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        law = noise_law(samples_of([rng.normal(size=800), np.zeros(800), rng.normal(size=800)]), 3)
    assert law.white[0] == pytest.approx(1.0, rel=0.2)
    assert law.white[1] < 1e-6


def test_residuals_of_slow_noise_have_variance_one_on_average() -> None:
    """A law from short rests is wrong by a factor of two either way: 1/s must be right on average."""
    rng = np.random.default_rng(seed=7)
    count, runs = 120, 60
    ratio = []
    for _ in range(runs):
        law = noise_law(samples_of(list(pink(count, 0.01, rng, 2)), 0.01), 2)
        ratio.append(1 / law.pink)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.25)


def test_what_rests_leave_open_of_slow_noise_is_its_doubt() -> None:
    """Short rests say little of it and know that; long ones know it well. Nothing is a discrepancy that noise may well be."""
    rng = np.random.default_rng(seed=8)
    laws = [noise_law(samples_of(list(pink(120, 0.01, rng, 2)), 0.01), 2) for _ in range(40)]
    off = [(1 - law.pink) / (law.pink * law.pink_doubt) for law in laws]
    assert np.mean(np.abs(off) < 2) > 0.85
    long = noise_law(samples_of(list(pink(12_000, 0.01, rng, 2)), 0.01), 2)
    assert long.pink_doubt < 0.5 * min(law.pink_doubt for law in laws)
    white = noise_law(samples_of([rng.normal(size=200)], 0.01), 1)
    assert white.red_doubt > 1, "no rest shows it"


def test_plateaus_of_steps_show_noise_that_is_slower_than_the_rest() -> None:
    """Of what is still there: not of the force, for the clamp rings."""
    designs = ({"protocol": "step", "loading": "electrical", "drive_kv": 5.0},)
    found = reduce(true_session(STEPPING, designs, ()).recordings[0])
    slowest = {
        q: min(s.frequency_hz.min() for s in found.noise if s.quantity == q)
        for q in ("voltage", "command", "capacitance", "force")
    }
    assert slowest.pop("force") > 1.9
    assert max(slowest.values()) < 1.5
    law = make_session([found]).laws[(0, "capacitance")]
    assert law.pink == pytest.approx(0.25 * 0.002**2 / 20, rel=2.0)


def test_a_clamp_that_rings_longer_than_the_file_says_is_not_in_the_early_periods() -> None:
    """Damping stated 2.5 times too high, two standard deviations: the start has died away where the first period begins."""
    specimen = random_specimen(np.random.default_rng(seed=5), kind="silicone")
    light = 2 * 0.0042 * float(np.sqrt(specimen.rig.stiffness * specimen.rig.mass))
    stated = {"load_cell_damping_n_s_per_mm": 2.5 * light, "load_cell_damping_n_s_per_mm_sd": 0.75 * light}
    rig = replace(specimen.rig, damping=light)
    specimen = replace(specimen, rig=rig, rig_file={**specimen.rig_file, **stated})
    silent = true_session(SILENT, ({"protocol": "sphs", "drive_kv": 8.0},), (), material=specimen).noise_free[0]
    early, late = (b.value for b in reduce(silent).blocks if b.kind == SPHS_RESPONSE)
    assert np.abs(early - late).max() < 3e-4 * np.abs(late).max()
