"""A film as an actuator against the requirement of a tremor."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pipeline.fit.actuator.known import Driven, KnownFilm, Limit, Scatter, drive_design
from pipeline.fit.actuator.specification import bandwidth, draw_force_stroke, specify, specify_force
from pipeline.physics.actuator import Sizes, nominal_tangent, pull_in_number
from pipeline.physics.film import RelaxationModel


def fitted(model: RelaxationModel, sd: float = 0.01) -> Any:
    """A fit whose parameters ln k0, ln ki, ln τi have one standard deviation, without correlation."""
    arms = len(model.k)

    def slopes(frequency_hz: np.ndarray) -> np.ndarray:
        s = 2j * np.pi * np.atleast_1d(frequency_hz)
        columns = [np.full(s.shape, complex(model.k0))]
        z = [s * tau for tau in model.tau]
        columns += [k * x / (1 + x) for k, x in zip(model.k, z, strict=True)]
        columns += [k * x / (1 + x) ** 2 for k, x in zip(model.k, z, strict=True)]
        return np.stack(columns, axis=1)

    return SimpleNamespace(model=model, slopes=slopes, covariance=sd**2 * np.eye(1 + 2 * arms))


FILM = RelaxationModel(1.0, (4.0,), (0.025,))
ACTIVE_MM, SHARE = 40.0, 40 / 70


def driven(model: RelaxationModel = FILM, **changes: Any) -> Driven:
    own: dict[str, Any] = {
        "fit": fitted(model), "ratio": 1.0, "ratio_sd": 0.0, "force_per_voltage_squared": 2e-3, "permittivity_sd": 0.01, "voltage_kv": 7.0, "lowest_hz": 1e-6,
        "capacitance_nf": 2e-3 / SHARE * ACTIVE_MM,
    }  # fmt: skip
    return Driven(**own | changes)


def test_sheet_of_a_film_with_known_numbers() -> None:
    sheet = {r.quantity: r for r in specify(driven(), 100.0)}
    force = sheet["force"]
    assert force.value == pytest.approx(0.098)
    assert force.value_lower == pytest.approx(0.098 * np.exp(-0.0196), rel=1e-4)
    assert force.value_lower_90 == pytest.approx(0.098 * np.exp(-0.016449), rel=1e-4)
    assert (force.meets, force.multiplied, force.multiple) == (False, "layers", 9)  # 0.4 N at half of 0.0961 N each
    assert sheet["slow stroke"].value == pytest.approx(0.098, rel=1e-4)
    k10 = abs(FILM.stiffness(np.array([10.0]))[0])
    assert sheet["stroke"].value == pytest.approx(0.098 / k10)
    assert sheet["stroke"].multiple == int(np.ceil(2 / sheet["stroke"].value_lower))
    assert sheet["efficiency"].value == pytest.approx(0.098 / k10 / 80 * SHARE)
    # 0.14 nF at 7 kV, a sinusoid between 0 and 7 kV at 10 Hz
    assert sheet["current"].value == pytest.approx(2 * np.pi * 10 * 0.14e-9 * 3500 * 1e6)
    assert not sheet["bandwidth"].meets


def test_bandwidth_is_where_the_stiffness_has_risen_by_the_root_of_two() -> None:
    found = bandwidth(driven())
    assert found is not None
    k = abs(FILM.stiffness(np.array([found[0]]))[0])
    assert k == pytest.approx(np.sqrt(2), rel=1e-6)
    rng = np.random.default_rng(seed=1)
    moved = []
    for _ in range(200):
        e = np.exp(0.01 * rng.normal(size=3))
        other = bandwidth(driven(RelaxationModel(e[0], (4 * e[1],), (0.025 * e[2],))))
        assert other is not None
        moved.append(np.log(other[0]))
    assert np.std(moved) == pytest.approx(found[1], rel=0.15)


def test_a_film_that_hardly_stiffens_has_no_bandwidth_and_one_without_model_only_a_force() -> None:
    assert bandwidth(driven(RelaxationModel(1.0, (0.2,), (0.01,)))) is None
    (force,) = specify_force(0.64, 1e-3, 8.0)
    assert (force.meets, force.multiple) == (True, 2)


@pytest.mark.long
def test_line_with_a_mass_is_that_of_a_film_integrated_in_time() -> None:
    """Free stroke at 10 Hz of a relaxing film that carries 5 g, as its equations of motion give it."""
    mass, omega = 5.0, 2 * np.pi * 10

    def rate(t: float, y: np.ndarray) -> list[float]:
        x, v, arm = y
        push = 0.098 * np.cos(omega * t)
        return [v, (push - FILM.k0 * x - arm) / (1e-6 * mass), FILM.k[0] * v - arm / FILM.tau[0]]

    t = np.linspace(0.4, 0.5, 2001)
    x = solve_ivp(rate, (0, 0.5), [0, 0, 0], t_eval=t, rtol=1e-7, atol=1e-10, method="Radau").y[0]
    line = draw_force_stroke(driven(mass_g=mass), 10.0)
    assert line[-1].stroke_mm == pytest.approx(2 * abs(np.mean((x * np.exp(-1j * omega * t))[:-1])), rel=0.01)
    assert line[0].force_n == pytest.approx(0.098)
    assert line[-1].force_n == pytest.approx(0.0, abs=1e-12)
    assert line[10].force_n_lower < line[10].force_n_lower_90 < line[10].force_n < line[10].force_n_upper_90


def test_limits_of_all_quantities_are_those_of_drawn_films() -> None:
    """Everything uncertain drawn at once, the quantities of each draw written out, against the stated limits."""
    own, sd = RelaxationModel(1.0, (4.0,), (0.025,)), 0.02
    known = KnownFilm(fitted(own, sd), 0.5, 1.2, None, 4.7, 0.03, 1e-6)
    sizes = Sizes(60.0, 30.0, 0.4, 50.0, 25.0, layers=3, strips=2, mass_g=1.0)
    scatter = Scatter(modulus_sd=0.04, thickness_sd=0.05)
    design = drive_design(known, sizes, (1.2, None), 5.0, scatter=scatter, breakdown=Limit(80.0, 0.1))
    sheet = {r.quantity: r for r in specify(design, 100.0)}
    assert design.pull_in is not None
    # The middle between two laws, each through the same modulus.
    number = np.sqrt(pull_in_number(1.2, None) * pull_in_number(1.2, None, 2.0))
    slope = np.sqrt(nominal_tangent(1.2, None) * nominal_tangent(1.2, None, 2.0))
    rng = np.random.default_rng(seed=2)
    drawn: dict[str, list[float]] = {name: [] for name in ("force", "stroke", "pull-in margin", "breakdown margin")}
    for _ in range(4000):
        k0, k1, tau = np.array([1.0, 4.0, 0.025]) * np.exp(sd * rng.normal(size=3))
        modulus, z = np.exp(0.04 * rng.normal()), 0.4 * np.exp(0.05 * rng.normal())
        permittivity = 8.8541878e-6 * 4.7 * np.exp(0.03 * rng.normal())
        s = 2j * np.pi * 10
        scale = modulus * 3 * 30 * z / (2 * 60) / 0.5
        force = permittivity * 3 * 25 / z * 50 / 60 * 25
        k = scale * (k0 + k1 * s * tau / (1 + s * tau)) - 1e-6 * (2 * np.pi * 10) ** 2
        drawn["force"].append(force)
        drawn["stroke"].append(force / abs(k))
        young = modulus * k0 / 0.5 / (1.2**2 * slope)
        thickness = z * 1.2**0.5
        law = np.exp(design.pull_in.sd * rng.normal())
        drawn["pull-in margin"].append(law * np.sqrt(number * young / permittivity) * thickness / 5.0)
        drawn["breakdown margin"].append(80 * np.exp(0.1 * rng.normal()) * z / 5.0)
    for name, values in drawn.items():
        row = sheet[name]
        assert row.value == pytest.approx(np.median(values), rel=0.01), name
        wide = np.log(row.value_upper_90 / row.value_lower_90)
        drawn_wide = np.log(np.quantile(values, 0.95) / np.quantile(values, 0.05))
        assert wide == pytest.approx(drawn_wide, rel=0.06), name
