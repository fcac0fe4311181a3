"""A film as an actuator against the requirement of a tremor."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.fit.force.specification import Drive, bandwidth, specify
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


def test_sheet_of_a_film_with_known_numbers() -> None:
    sheet = {r.quantity: r for r in specify(Drive(2e-3, 2e-5, 7.0), fitted(FILM), 40.0, 40 / 70, 100.0)}
    force = sheet["force"]
    assert force.value == pytest.approx(0.098)
    assert force.value_lower == pytest.approx(0.098 * np.exp(-0.0196), rel=1e-4)
    assert (force.meets, force.multiplied, force.multiple) == (False, "layers", 9)  # 0.4 N at half of 0.0961 N each
    assert sheet["stroke at rest"].value == pytest.approx(0.098, rel=1e-4)
    k10 = abs(FILM.stiffness(np.array([10.0]))[0])
    assert sheet["stroke"].value == pytest.approx(0.098 / k10)
    assert sheet["stroke"].multiple == int(np.ceil(2 / sheet["stroke"].value_lower))
    assert sheet["efficiency"].value == pytest.approx(0.098 / k10 / 80 * 40 / 70)
    assert not sheet["bandwidth"].meets


def test_bandwidth_is_where_the_stiffness_has_risen_by_the_root_of_two() -> None:
    found = bandwidth(fitted(FILM))
    assert found is not None
    k = abs(FILM.stiffness(np.array([found[0]]))[0])
    assert k == pytest.approx(np.sqrt(2), rel=1e-6)
    rng = np.random.default_rng(seed=1)
    moved = []
    for _ in range(200):
        e = np.exp(0.01 * rng.normal(size=3))
        other = bandwidth(fitted(RelaxationModel(e[0], (4 * e[1],), (0.025 * e[2],))))
        assert other is not None
        moved.append(np.log(other[0]))
    assert np.std(moved) == pytest.approx(found[1], rel=0.15)


def test_a_film_that_hardly_stiffens_has_no_bandwidth_and_one_without_model_only_a_force() -> None:
    assert bandwidth(fitted(RelaxationModel(1.0, (0.2,), (0.01,)))) is None
    (force,) = specify(Drive(1e-2, 1e-5, 8.0), None, None, 1.0, 0.0)
    assert (force.meets, force.multiple) == (True, 2)
