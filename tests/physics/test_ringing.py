"""The frequency and the damping of what rings after a blow, and signals that do not ring."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.transform.ringing import damped_sinusoid

INTERVAL = 1e-3


@pytest.mark.parametrize(("frequency", "damping"), [(20.0, 0.01), (50.0, 0.05)])
def test_a_ring_has_its_frequency_and_damping(frequency: float, damping: float) -> None:
    t = np.arange(4000) * INTERVAL
    w0 = 2 * np.pi * frequency
    ring = np.exp(-damping * w0 * t) * np.cos(w0 * np.sqrt(1 - damping**2) * t + 0.4)
    noise = np.random.default_rng(seed=1).normal(scale=1e-3, size=t.size)
    found = damped_sinusoid(0.2 + ring + noise, INTERVAL)
    assert found is not None
    f, f_sd, zeta, zeta_sd = found
    assert abs(f - frequency) < 5 * f_sd < 0.05
    assert abs(zeta - damping) < 5 * zeta_sd < 0.005


def beating(cycles: int) -> np.ndarray:
    """A ring whose frequency creeps, beside another one: no damped sinusoid, and searches for one go far off."""
    t = np.arange(cycles) * 0.5e-3
    creeping = np.exp(-0.0352 * 2 * np.pi * 160.4 * t) * np.cos(2 * np.pi * 160.4 * t * (1 - 0.2 * t))
    return np.asarray(creeping + 0.5 * np.exp(-0.00185 * 2 * np.pi * 404.9 * t) * np.cos(2 * np.pi * 404.9 * t))


@pytest.mark.parametrize("cycles", range(300, 1500, 25))
def test_a_beat_ends_no_recording(cycles: int) -> None:
    found = damped_sinusoid(beating(cycles), 0.5e-3)
    assert found is None or (np.isfinite(found).all() and found[2] > 0)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    size=st.integers(64, 600),
    blow=st.integers(0, 63),
    height=st.floats(0.0, 1e6),
    decay=st.floats(0.5, 500.0),
    colour=st.sampled_from(["white", "walk", "none"]),
)
def test_what_does_not_ring_is_none_or_finite(
    seed: int, size: int, blow: int, height: float, decay: float, colour: str
) -> None:
    """Blows, creeping levels and noise of any colour: a search that sends the decay off ended in no number at all, and the recording with it."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=size) if colour != "none" else np.zeros(size)
    force = np.cumsum(noise) if colour == "walk" else noise
    after = np.maximum(np.arange(size) - blow, 0)
    force = force + height * (np.arange(size) >= blow) * np.exp(-after / decay)
    found = damped_sinusoid(force, INTERVAL)
    assert found is None or np.isfinite(found).all()
