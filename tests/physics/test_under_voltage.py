"""Models of each order against the force under voltage, and the permittivity that the force needs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.fit.force.permittivity import (
    from_blocked_force,
    from_force,
    from_steps,
    relaxed_stiffness,
    unit_force,
)
from pipeline.fit.relaxation.electrical import fit_electrical
from pipeline.fit.relaxation.identify import fit_specimen
from pipeline.fit.relaxation.under_voltage import compare_orders
from pipeline.physics.film import RelaxationModel
from pipeline.physics.rig import RigPrior
from pipeline.transform.response import FORCE_PER_VOLTAGE_SQUARED, STIFFNESS, FrequencyResponse
from schemas.metadata import RecordingMetadata, RigConstants

FILM = RelaxationModel(1.0, (1.5, 2.0, 30.0), (0.0333, 0.01, 6.67e-4))
RIG = RigConstants(
    rig_id="r", clamp_mass_kg=0.1874, clamp_mass_kg_sd=0.001, load_cell_stiffness_n_per_mm=20.0,
    load_cell_stiffness_n_per_mm_sd=0.1, load_cell_damping_n_s_per_mm=6e-4, load_cell_damping_n_s_per_mm_sd=1e-4,
)  # fmt: skip
FORCE = 1.76e-3
F = np.concatenate([np.arange(1.0, 40.0, 2.0), np.arange(41.0, 100.0, 4.0)])


def made(
    value: np.ndarray, quantity: str, name: str, rng: np.random.Generator, share: float = 2e-3
) -> FrequencyResponse:
    error = share * np.abs(value)
    return FrequencyResponse(
        frequency_hz=F,
        value=value + error * (rng.normal(size=F.size) + 1j * rng.normal(size=F.size)) / np.sqrt(2),
        variance=error**2,
        usable=np.ones(F.size, dtype=bool),
        quantity=quantity,
        loading="mechanical" if quantity == STIFFNESS else "electrical",
        recording_id=name,
        specimen_id="s",
    )


@pytest.fixture(scope="module")
def compared() -> Any:
    rng = np.random.default_rng(seed=5)
    own = RigPrior.of(RIG).rig
    clamp, k = own.clamp(2 * np.pi * F), FILM.stiffness(F)
    mechanical = fit_specimen([made(own.mechanical(k, clamp), STIFFNESS, "m", rng)], RIG, specimen_id="s")
    h = [made(FORCE * own.electrical(k, clamp), FORCE_PER_VOLTAGE_SQUARED, name, rng) for name in ("a", "b")]
    fits = fit_electrical(h, RIG, mechanical, specimen_id="s")
    return compare_orders(fits, h, [RIG, RIG], [3.0, 7.0])


def test_higher_orders_err_less_and_the_resonance_matters_more_than_any_order(compared: Any) -> None:
    found, _ = compared
    assert len(found) == 2 * 3 * 3
    left = {(o.form, o.model_order, o.voltage_kv): o for o in found}
    for volts in (3.0, 7.0):
        recorded = [left["recorded", order, volts].relative_error for order in (1, 2, 3)]
        assert recorded[0] > 3 * recorded[2]
        assert recorded[2] < 0.01
        assert left["resonance_ignored", 3, volts].relative_error > 20 * recorded[2]
        assert left["without_resonance", 3, volts].phase_error_deg < 1.0


def test_without_resonance_the_curve_falls_from_the_share_of_the_static_film(compared: Any) -> None:
    """kL/(kL + k): it falls and turns negative in phase because k grows, as figure 4-17 has it."""
    _, curves = compared
    measured = next(
        c for c in curves if c.model_order is None and c.form == "without_resonance" and c.recording_id == "b"
    )
    expected = FORCE / (1 + FILM.stiffness(F) / 20.0)
    np.testing.assert_allclose(measured.value, expected, rtol=0.05)
    assert (measured.standard_error > 0).all()
    assert sum(c.model_order is None for c in curves) == 4
    assert len(curves) == 2 * 2 * 4


ABOUT: dict[str, Any] = {
    "recording_id": "a", "protocol": "sphs", "loading": "electrical", "specimen_id": "s", "started_at": "2026-03-01T08:00:00Z",
    "film_length_mm": 50, "film_width_mm": 50, "film_thickness_mm": 1, "stretch_1": 1.4, "active_length_mm": 40,
    "active_width_mm": 40, "active_drawn": "stretched", "relative_permittivity": 4.7,
}  # fmt: skip


def test_unit_force_is_that_of_the_stretched_film_and_of_the_active_share() -> None:
    about = RecordingMetadata.parse(ABOUT)
    z = 1 / (1.4 * 1.4**-0.5)
    assert unit_force(about) == pytest.approx(8.8541878e-6 * 40 / z * 40 / 70)
    held = RecordingMetadata.parse({**ABOUT, "constrained_length_mm": 20})
    assert unit_force(held) == pytest.approx(8.8541878e-6 * 40 / z * 40 / 50)
    without = {key: value for key, value in ABOUT.items() if key != "active_length_mm"}
    assert unit_force(RecordingMetadata.parse(without)) is None


def test_permittivity_from_a_blocked_force_has_the_limits_of_noise_and_constants() -> None:
    about, rng = RecordingMetadata.parse(ABOUT), np.random.default_rng(seed=2)
    true = 4.7 * (unit_force(about) or 0.0)
    inside = 0
    for _ in range(200):
        noise = 0.02 * true * (rng.normal(size=F.size) + 1j * rng.normal(size=F.size)) / np.sqrt(2)
        common = 0.01 * true * np.ones((F.size, 1), dtype=complex)
        response = FrequencyResponse(
            frequency_hz=F, value=true + noise + common[:, 0] * rng.normal(), variance=np.full(F.size, (0.02 * true) ** 2),
            usable=np.ones(F.size, dtype=bool), quantity=FORCE_PER_VOLTAGE_SQUARED, loading="electrical", systematic=common,
        )  # fmt: skip
        found = from_blocked_force(response, about, 7.0)
        assert found is not None
        inside += found.relative_permittivity_lower < 4.7 < found.relative_permittivity_upper
    assert 180 <= inside <= 198
    assert found.relative_permittivity_upper - found.relative_permittivity_lower > 2 * 1.9 * 0.01 * 4.7


def test_static_permittivity_counts_what_the_load_cell_gives() -> None:
    about = RecordingMetadata.parse(ABOUT)
    unit = unit_force(about) or 0.0
    give = 1 + relaxed_stiffness(FILM, 2.0) / 20.0
    assert give == pytest.approx(1.05)
    drops = [4.7 * unit * 49 / give * s for s in (0.99, 1.0, 1.01)]
    found = from_steps(drops, [7.0] * 3, about, give)
    assert found is not None
    assert found.relative_permittivity == pytest.approx(4.7)
    assert found.relative_permittivity_upper - 4.7 == pytest.approx(4.303 * 0.047 / 3**0.5, rel=1e-3)
    assert from_steps(drops[:1], [7.0], about, give) is None
    both = from_force(4.7 * unit, 0.01 * unit, about, 50)
    assert both is not None
    assert both.relative_permittivity_upper - 4.7 == pytest.approx(0.0196, rel=1e-3)
