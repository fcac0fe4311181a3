"""Causes of what one branch gets wrong of a large cycle. The truths are integrated by another method than the models."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pipeline.diagnose.results import Diagnosis
from pipeline.diagnose.single.comparison import Comparison
from pipeline.diagnose.single.cycle_diagnosis import diagnose_cycle, estimate_noise_sd
from pipeline.diagnose.single.cycle_model import CycleModel, list_mechanisms, make_cycle
from schemas.errors import NotIdentifiableError

Float = NDArray[np.float64]

RATE, UP_S, NOISE_KPA = 0.5, 8.0, 0.4
LAW = {"crosslink_modulus": 8.0, "entanglement_modulus": 18.0, "largest_stretch": 4.8}


def stretch_at(time: Float) -> Float:
    return 1 + RATE * (UP_S - np.abs(UP_S - np.asarray(time)))


def equilibrium(stretch: Float) -> Float:
    """The law of Davidson and Goulbourne (2013), written out."""
    first, limit = stretch**2 + 2 / stretch, 3 * LAW["largest_stretch"] ** 2
    crosslinks = LAW["crosslink_modulus"] * (stretch - stretch**-2) * (3 * limit - first) / (3 * (limit - first))
    return crosslinks + LAW["entanglement_modulus"] * (1 - stretch**-1.5 - stretch**-2 + stretch**-0.5)


def cycle(
    branches: tuple[tuple[float, float], ...], law: Callable[[Float], Float] = equilibrium, seed: int = 1
) -> tuple[Float, Float, Float]:
    """Time s, stretch, stress kPa of a triangle, branches (γ kPa, τ s) integrated by Runge and Kutta."""
    time = np.linspace(0.0, 1.95 * UP_S, 200)

    def change(t: float, q: Float) -> list[float]:
        rate = RATE if t < UP_S else -RATE
        return [gamma * rate - own / tau for own, (gamma, tau) in zip(q, branches, strict=True)]

    found = solve_ivp(change, (0, time[-1]), np.zeros(len(branches)), t_eval=time, max_step=0.01, rtol=1e-8)
    noise = np.random.default_rng(seed).normal(0.0, NOISE_KPA, time.size)
    return time, stretch_at(time), law(stretch_at(time)) + found.y.sum(axis=0) + noise


def diagnosed(data: tuple[Float, Float, Float]) -> tuple[Diagnosis, Comparison]:
    return diagnose_cycle(make_cycle(*data, LAW, "cycle", "film"))


@lru_cache(maxsize=1)
def two_branches() -> tuple[Diagnosis, Comparison]:
    return diagnosed(cycle(((30.0, 4.0), (60.0, 0.3))))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_cycle_that_one_branch_explains_has_nothing_wrong(seed: int) -> None:
    """Whatever follows the noise a little better is not named; the discrepancies are noise."""
    found, _ = diagnosed(cycle(((30.0, 4.0),), seed=seed))
    assert found.verdict == "none"
    assert found.mechanisms == found.also_possible == found.unexplained == ()
    assert found.extension is None
    assert found.p_value > 0.01
    assert all(d.p_value > 1e-4 for d in found.discrepancies)


@pytest.mark.slow
def test_a_second_branch_is_possible_and_predicts_the_unloading() -> None:
    found, comparison = two_branches()
    assert found.verdict in ("named", "ambiguous")
    assert "missing_relaxation" in {*found.mechanisms, *found.also_possible}
    second = next(p for p in comparison.ranked if p.model.variant == "a second branch")
    assert second.lower > 0.8
    assert second.explained > 0.95
    assert {"gain_error", "baseline_drift"}.isdisjoint({*found.mechanisms, *found.also_possible})
    assert found.p_value < 1e-6


@pytest.mark.slow
def test_a_law_that_stiffens_is_told_from_a_relaxation() -> None:
    """What follows the stretch, not the rate, does the same on the way back."""

    def stiffer(stretch: Float) -> Float:
        return equilibrium(stretch) * (1 + 0.4 * np.tanh((stretch - 1) / 3) ** 2)

    found, comparison = diagnosed(cycle(((30.0, 4.0),), stiffer))
    assert found.mechanisms == ("strain_stiffening",)
    assert comparison.ranked[0].lower > 0.5
    assert comparison.ranked[0].explained > 0.95
    relaxing = [p for p in comparison.ranked if p.model.mechanism == "missing_relaxation"]
    assert all(p.after > 3 * comparison.ranked[0].after for p in relaxing)


@pytest.mark.slow
def test_what_cannot_be_told_apart_gets_a_recording_that_would() -> None:
    found, _ = diagnosed(cycle(((30.0, 4.0), (25.0, 1.0))))
    if found.verdict == "ambiguous":
        assert found.next_recording is not None
        assert "held" in found.next_recording.text or "times" in found.next_recording.text
    assert set(found.smallest_detectable) >= {"missing_relaxation", "strain_stiffening", "gain_error"}


@pytest.mark.slow
def test_damage_that_does_not_show_while_loading_gains_nothing_there() -> None:
    _, comparison = two_branches()
    damage = next(p for p in comparison.ranked if p.model.mechanism == "cyclic_softening")
    assert damage.gain == pytest.approx(0.0, abs=1e-12)
    assert damage.lower == damage.upper == damage.gain


@pytest.mark.parametrize("law", [LAW, None], ids=["given", "fitted"])
def test_models_side_by_side_are_what_each_is_alone(law: dict[str, float] | None) -> None:
    data = make_cycle(*cycle(((30.0, 4.0),)), law, "cycle", "film")
    for mechanism in (None, *list_mechanisms(2 * UP_S, data.time_s[1])):
        model = CycleModel(data, mechanism)
        low, high = model.limits
        several = low + np.array([[0.3], [0.5], [0.6]]) * (high - low)
        for together, x in zip(model.stress(several), several, strict=True):
            alone = model.stress(x)
            assert alone.shape == data.stress.shape
            assert together == pytest.approx(alone, rel=1e-12)


def test_noise_of_neighbouring_samples() -> None:
    time, _, stress = cycle(((30.0, 4.0),))
    assert estimate_noise_sd(stress) == pytest.approx(NOISE_KPA, rel=0.15)
    assert estimate_noise_sd(np.where(time > UP_S, stress + 50, stress)) == pytest.approx(NOISE_KPA, rel=0.15)


def test_a_cycle_without_a_way_back_is_refused() -> None:
    time, stretch, stress = cycle(((30.0, 4.0),))
    up = time < UP_S
    with pytest.raises(NotIdentifiableError, match="no way back"):
        make_cycle(time[up], stretch[up], stress[up], LAW, "cycle", "film")
