"""Leakage through the film: what it leaves of the voltage, before the monitor or behind it."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.diagnose.mechanisms.drive import LEAKAGE
from pipeline.diagnose.simulation.effects import Effect, Scale, View, Wave

SCALE = Scale(strain=0.1, voltage_kv=5.0, exposure_kv2_s=100.0, duration_s=100.0, length_mm=10.0)
BEFORE, BEHIND = LEAKAGE.variants
VALUES = {"droop": 0.2, "build_up_s": 0.4, "ohmic": 0.3, "at_once": 0.25, "field_power": 2.0}


def view(frequency_hz: np.ndarray, kv: float) -> View:
    zero = np.zeros((1, 1))
    return View(
        frequency_hz[None], zero, zero, zero, zero + 1, zero, zero, zero, zero + kv, zero, zero, zero, zero, zero, SCALE, "step"
    )  # fmt: skip


def leak(variant: str, **values: float) -> Effect:
    return LEAKAGE.effect(VALUES | values, variant)


def test_behind_the_monitor_the_force_sags_as_the_square_of_the_voltage() -> None:
    """The factor of a step's response at ω is jω ∫ g(t) e^(−jωt) dt of what acts over time g, here (1 − s b(t))²."""
    frequency, kv, tau = np.array([0.05, 0.3, 2.0]), 4.0, VALUES["build_up_s"]
    [edge] = leak(BEHIND).film_edges
    sag = 0.2 * (0.3 + 0.7 * (kv / 5.0) ** 2)
    t = np.linspace(0, 60 * tau, 600_001)
    built = 1 - 0.75 * np.exp(-t / tau)
    omega = 2 * np.pi * frequency
    # What is left at the end goes on for ever.
    left = (1 - sag * built) ** 2 - (1 - sag) ** 2
    expected = [(1 - sag) ** 2 + 1j * w * np.trapezoid(left * np.exp(-1j * w * t), t) for w in omega]
    np.testing.assert_allclose(np.ravel(edge(view(frequency, kv), 1.0)), expected, rtol=1e-5)
    np.testing.assert_allclose(np.ravel(edge(view(frequency, kv), -1.0)), (1 - sag) ** 2)


def test_a_current_that_flows_at_once_sags_everywhere_alike() -> None:
    kv = 5.0 * np.sin(2 * np.pi * np.arange(200) / 200)[None]
    given = Wave(kv, kv**2, 0.005, SCALE)
    quick = leak(BEHIND, build_up_s=1e-9, at_once=0.0).film_voltage[0](given).film_kv
    at_once = leak(BEHIND, at_once=1.0).film_voltage[0](given).film_kv
    np.testing.assert_allclose(quick, at_once, rtol=1e-6)
    slow = leak(BEHIND, build_up_s=1e6, at_once=0.0).film_voltage[0](given).film_kv
    assert np.abs(kv - slow).max() == pytest.approx(np.abs(kv - at_once).max() * np.abs(kv).mean() / 5.0, rel=1e-5)


@pytest.mark.parametrize(("variant", "monitored"), [(BEFORE, True), (BEHIND, False)])
def test_only_before_the_monitor_it_is_measured(variant: str, monitored: bool) -> None:
    effect = leak(variant)
    assert bool(effect.monitor_wave) == bool(effect.monitor_edges) == monitored
    assert bool(effect.film_voltage) == bool(effect.film_edges) == (not monitored)
