"""Linear systems of several resonances, without noise and without misfit: what a diagnosis must not say of them.

Truths are closed forms: sums of resonances under a periodic multisine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pipeline.analyse.diagnosis_tables import comparison_tables
from pipeline.diagnose.results import NONE, UNKNOWN
from pipeline.diagnose.single.oscillator import SystemRecord
from pipeline.diagnose.single.system_diagnosis import diagnose_system
from schemas.errors import NotIdentifiableError
from schemas.mechanisms import candidate

INTERVAL_S, SAMPLES, HIGHEST_HZ = 1e-3, 600, 200.0
Resonance = tuple[float, float, float]
"""Hz, damping ratio, static gain."""
ONE: Resonance = (60.0, 0.2, 1.0)


def _record(resonances: Sequence[Resonance], noise: float = 0.002, cube: float = 0.0, seed: int = 1) -> SystemRecord:
    """One steady period of a multisine through resonances side by side; `cube` bends the reading afterwards."""
    rng = np.random.default_rng(seed)
    period = SAMPLES * INTERVAL_S
    omega = 2 * np.pi * np.arange(1, int(HIGHEST_HZ * period), 3) / period
    phase = rng.uniform(0, 2 * np.pi, omega.size)
    waves = np.exp(1j * (np.outer(np.arange(SAMPLES) * INTERVAL_S, omega) + phase)) / np.sqrt(omega.size)
    response = np.zeros(omega.size, dtype=complex)
    for hertz, ratio, gain in resonances:
        own = 2 * np.pi * hertz
        response += gain * own**2 / (own**2 - omega**2 + 2j * ratio * own * omega)
    y = (waves @ response).real
    y = y + cube * y**2 * np.sign(np.sin(7 * np.arange(SAMPLES))) + noise * y.std() * rng.standard_normal(SAMPLES)
    return SystemRecord("record", waves.sum(axis=1).real, y, INTERVAL_S, periodic=True)


@pytest.mark.slow
def test_two_resonances_are_no_fault_of_a_simulation() -> None:
    """A linear simulation with one resonance is wrong by half of the output; one with two is right, and asked for nothing."""
    found, comparison = diagnose_system("S", [_record([ONE, (120.0, 0.15, -0.5)])], ["noise"], "V")
    assert found.verdict == NONE
    assert found.p_value > 0.01
    assert not found.discrepancies
    assert any("2 resonances" in text for text in found.could_not_ask)
    assert found.held_out is None
    for row in comparison_tables(found, comparison)["diagnosis_candidates"].to_pylist():
        assert row["gain"] is row["gain_lower"] is row["gain_upper"] is row["explained"] is None


def test_no_cause_stands_beside_unknown() -> None:
    """A reading that is bent at random is in no list."""
    found, comparison = diagnose_system("S", [_record([ONE], cube=0.2)], ["noise"], "1")
    assert found.verdict == UNKNOWN
    assert found.mechanism is None
    assert found.mechanisms == ()
    assert found.extension is None
    tables = comparison_tables(found, comparison)
    row = tables["diagnoses"].to_pylist()[0]
    assert row["severity"] is row["gain"] is row["chi2_extended"] is None
    parameters = {r["mechanism"]: r["parameter"] for r in tables["diagnosis_candidates"].to_pylist()}
    assert parameters["sensor_saturation"] == "overload"
    (assumed,) = tables["assumptions"].to_pylist()
    assert (assumed["recording_id"], assumed["value"]) == ("record", "is band-limited")
    assert "no better" in assumed["because"]
    assert "N" not in candidate("sensor_saturation", 0.3, 0.1, "overload")
    assert " 1," not in " ".join((*found.could_not_ask, *found.unexplained))


def test_a_record_without_noise_is_told_from_arithmetic() -> None:
    """What a simulation in steps cannot resolve is no discrepancy, and nothing smaller is called detectable."""
    found, _ = diagnose_system("S", [_record([ONE], noise=0.0)], ["noise"], "V")
    assert found.verdict == NONE
    for of_one in found.smallest_detectable.values():
        for size in of_one.values():
            assert math.isfinite(size)
            assert abs(size) > 1e-9


@pytest.mark.parametrize(
    ("quantity", "value", "why"), [("input", 0.0, "does not change"), ("output", 1e300, "as large as")]
)
def test_values_that_no_resonance_can_have_are_refused_with_the_reason(quantity: str, value: float, why: str) -> None:
    """They ended in an error of the solver: LinAlgError, OverflowError."""
    record = _record([ONE])
    spoilt = replace(record, **{quantity: getattr(record, quantity) * value + 1.0})
    with pytest.raises(NotIdentifiableError, match=why):
        diagnose_system("S", [spoilt], ["noise"], "V")


def test_a_pure_gain_is_no_matter_of_spikes() -> None:
    """Its best resonance lies beyond what is sampled, and the message sent people to look for spikes."""
    rng = np.random.default_rng(1)
    given = rng.standard_normal(600)
    record = SystemRecord("record", given, 2.5 * given + 0.05 * rng.standard_normal(600), INTERVAL_S)
    with pytest.raises(NotIdentifiableError, match="follows the input at once") as refused:
        diagnose_system("S", [record], ["noise"], "V")
    assert "spikes" not in str(refused.value)
