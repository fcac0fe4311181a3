"""Sizes for a requirement: each design held against the specification, the front against every pair."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pipeline.fit.actuator.known import Driven, KnownFilm, Scatter, drive_design
from pipeline.fit.actuator.search import Space, fewest_films, find_front, nearest_limit, search_designs
from pipeline.fit.actuator.specification import NORMAL_90, Asked
from pipeline.fit.relaxation.stored import StoredFit
from pipeline.physics.actuator import Sizes
from pipeline.physics.film import RelaxationModel, Shape

TREMOR = Asked(0.4, 1.0, 10.0)
MODEL = RelaxationModel(0.3, (0.3, 0.5), (0.05, 0.004))
SHAPE = Shape(2)
FILM = KnownFilm(StoredFit(MODEL, SHAPE, SHAPE.names, 0.02**2 * np.eye(5)), 0.4, 1.3, None, 4.7, 0.03, 1e-6)
MASS_G = 2.0


def build(thickness_mm: float, voltage_kv: float, layers: int = 1, strips: int = 1, mass_g: float = MASS_G) -> Driven:
    sizes = Sizes(50.0, 40.0, thickness_mm / 1.3**0.5, 50.0, 40.0, layers=layers, strips=strips, mass_g=mass_g)
    return drive_design(FILM, sizes, (1.3, None), voltage_kv, scatter=Scatter(0.03, 0.02))


def left_at(driven: Driven, stroke_mm: float, hz: float) -> tuple[float, float]:
    """Force left at a stroke with its standard deviation, by differences of everything that is uncertain."""

    def left(x: np.ndarray) -> float:
        model = SHAPE.model(SHAPE.theta(MODEL) + x[:5])
        force = driven.force_n * np.exp(x[5] - x[7])
        inertia = 1e-6 * driven.mass_g * (2 * np.pi * hz) ** 2
        k = driven.ratio * np.exp(x[6] + x[7]) * model.stiffness(np.array([hz]))[0] - inertia
        return float(force - abs(k) * stroke_mm)

    slopes = [(left(e) - left(-e)) / 2e-5 for e in 1e-5 * np.eye(8)]
    sds = [0.02] * 5 + [0.03, 0.03, 0.02]
    return left(np.zeros(8)), float(np.linalg.norm(np.multiply(slopes, sds)))


def test_every_design_found_meets_the_requirement_when_it_is_built() -> None:
    found = search_designs(lambda z, v: build(z, v), Space((0.25, 0.5), 12.0), TREMOR)
    assert len(found.front) > 3
    assert found.tried > found.met > len(found.front)
    assert found.unsafe > 0
    for design in found.front:
        driven = build(design.thickness_mm, design.voltage_kv, design.layers, design.strips)
        value, sd = left_at(driven, 1.0, 10.0)
        assert design.force_n == pytest.approx(value, rel=1e-6)
        assert design.force_n_lower == pytest.approx(value - NORMAL_90 * sd, rel=1e-4)
        assert design.force_n_lower >= 0.4
        margin, lower, name = nearest_limit(driven)
        assert (design.margin, design.margin_lower, design.limited_by) == (margin, lower, name)
        assert lower is not None
        assert lower >= 1
        assert left_at(driven, design.stroke_mm, 10.0)[0] == pytest.approx(0.4)


def test_fewest_films_are_those_of_a_full_count() -> None:
    one = build(0.5, 9.0, mass_g=0.0)
    best = fewest_films(one, TREMOR)
    assert best is not None
    every = []
    for m in range(1, 60):
        for n in range(1, best[0] * best[1] // m + 1):  # no more films than were found
            value, sd = left_at(build(0.5, 9.0, n, m, 0.0), 1.0, 10.0)
            if value - NORMAL_90 * sd >= 0.4:
                every.append(n * m)
                break
    assert best[0] * best[1] == min(every)
    assert fewest_films(build(0.5, 0.01), TREMOR) is None


def test_what_no_number_of_films_can_do_has_an_empty_front() -> None:
    found = search_designs(lambda z, v: build(z, v), Space((0.5,), 0.2, 20, 20), TREMOR)
    assert (found.front, found.met) == ((), 0)


@settings(deadline=None)
@given(arrays.arrays(int, st.tuples(st.integers(1, 30), st.integers(1, 4)), elements=st.integers(0, 4)))
def test_a_front_has_what_no_other_betters_and_nothing_else(values: np.ndarray) -> None:
    front = find_front(values.astype(float))
    bettered = [any((a >= b).all() and (a > b).any() for a in values) for b in values]
    assert front.tolist() == [not b for b in bettered]
