"""Warming of a film where its temperature was recorded, was not, and was from the middle of the session on."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from pipeline.diagnose.mechanisms import make_effect
from pipeline.diagnose.simulation.effects import Film, Scale, View
from pipeline.diagnose.simulation.families import film_at
from pipeline.diagnose.simulation.parameters import Physical, Several
from pipeline.physics.film import RelaxationModel
from pipeline.physics.rig import Rig

WARM = {"per_kelvin": 0.02, "rise_k": 5.0, "time_constant_s": 500.0}


def stiffness(session_s: float, temperature_k: float, first_temperature_s: float, variant: str = "recorded") -> float:
    """Share of the stiffness that a warming film keeps."""
    numbers = {f.name: np.zeros((1, 1)) for f in fields(View) if f.name not in ("scale", "test", "k0", "shifted")}
    known = {"session_s": session_s, "temperature_k": temperature_k, "first_temperature_s": first_temperature_s}
    view = View(
        **numbers | {name: np.full((1, 1), value) for name, value in known.items()},
        scale=Scale(0.1, 5.0, 100.0, 4000.0, 30.0),
        test="sweep",
    )
    film = Film(np.ones((1, 1), dtype=complex), np.ones((1, 1), dtype=complex))
    for softer in make_effect("thermal_softening", WARM, variant).film:
        film = softer(film, view)
    return float(film.k[0, 0].real)


def test_a_temperature_recorded_from_the_first_recording_on_is_taken_as_it_is() -> None:
    assert stiffness(900.0, 4.0, 0.0) == pytest.approx(np.exp(-0.02 * 4.0))


def test_without_a_temperature_the_film_warms_with_the_time_of_the_session() -> None:
    assert stiffness(500.0, np.nan, np.nan) == pytest.approx(np.exp(-0.02 * 5.0 * (1 - np.exp(-1.0))))


def test_a_temperature_recorded_later_counts_from_what_was_supposed_until_then() -> None:
    """The film does not jump back where the first thermometer is read."""
    until = stiffness(700.0, np.nan, 700.0)
    assert stiffness(700.0, 0.0, 700.0) == pytest.approx(until)
    assert stiffness(4000.0, 10.0, 700.0) == pytest.approx(until * np.exp(-0.02 * 10.0))


def test_a_film_apart_from_the_recorded_temperature_warms_with_the_time_of_the_session() -> None:
    """A thermometer in the air shows the room."""
    assert stiffness(500.0, 0.3, 0.0, "apart") == pytest.approx(stiffness(500.0, np.nan, np.nan))


def test_a_warmer_film_relaxes_faster() -> None:
    """Time–temperature superposition: k(jω a) e^{−βΔT}, for one film and for several at once."""
    view = View(
        **{f.name: np.zeros((1, 1)) for f in fields(View) if f.name not in ("scale", "test", "k0", "shifted", "frequency_hz")}
        | {"temperature_k": np.array([[0.0], [6.0]])},
        frequency_hz=np.geomspace(0.1, 100.0, 7)[None, :],
        scale=Scale(0.1, 5.0, 100.0, 4000.0, 30.0),
        test="multisine",
    )  # fmt: skip
    effect = make_effect("thermal_softening", WARM | {"self_heating_k": 1e-3, "shift": 8.0})
    films = [RelaxationModel(1.0, (0.5, 0.7), (0.8, tau)) for tau in (0.02, 0.03)]
    several = Several.of([Physical(film, (Rig(0.1, 20.0, 0.0),), 1.0, (), 0.0, 0.0, "") for film in films])
    found = film_at(several, effect, view).k
    for film, k in zip(films, found, strict=True):
        faster = RelaxationModel(film.k0, film.k, tuple(t * np.exp(-0.02 * 6.0 * 8.0) for t in film.tau))
        assert k[0] == pytest.approx(film.stiffness(view.frequency_hz[0]), rel=1e-9)
        assert k[1] == pytest.approx(np.exp(-0.02 * 6.0) * faster.stiffness(view.frequency_hz[0]), rel=1e-9)


def heated(test: str, frequency_hz: np.ndarray, strain: np.ndarray, elapsed: np.ndarray, loss: float) -> np.ndarray:
    """(S, J) rise of a film by its own dissipation, K, from what it softens by: β of a per cent, a kelvin for a cycle."""
    shape = np.broadcast_shapes(frequency_hz.shape, strain.shape, elapsed.shape)
    numbers = {f.name: np.zeros(shape) for f in fields(View) if f.name not in ("scale", "test", "k0", "shifted")}
    numbers |= {"frequency_hz": np.broadcast_to(frequency_hz, shape), "strain": np.broadcast_to(strain, shape)}
    numbers |= {"elapsed": np.broadcast_to(elapsed, shape), "temperature_k": np.zeros(shape)}
    view = View(**numbers, scale=Scale(0.1, 5.0, 100.0, 4000.0, 30.0), test=test, k0=2.0)
    film = Film(np.full(shape, 2.0 + 2.0j * loss), np.ones(shape, dtype=complex))
    (softer,) = make_effect("thermal_softening", WARM | {"per_kelvin": 0.01, "self_heating_k": 1.0}).film
    return np.asarray(-np.log(np.abs(softer(film, view).k / film.k)) / 0.01)


def test_cycles_heat_a_film_by_their_loss_and_the_square_of_their_strain() -> None:
    """Each leaves π e² Im k: a kelvin in a cycle of the largest strain with a loss as large as k0."""
    cycles, half = np.array([[0.5], [4.0], [9.5]]), np.array([[0.05]])
    whole = heated("cyclic", np.array([[1.0]]), np.array([[0.1]]), cycles, loss=1.0)
    assert whole == pytest.approx(cycles)
    assert heated("cyclic", np.array([[1.0]]), half, cycles, loss=0.3) == pytest.approx(0.3 / 4 * cycles)
    assert heated("step", np.array([[1.0]]), half, cycles, loss=1.0) == pytest.approx(np.zeros((3, 1)))


@pytest.mark.parametrize("falling", [False, True])
def test_a_sweep_heats_a_film_along_its_course_and_the_next_goes_on_from_there(falling: bool) -> None:
    frequency, passed = np.geomspace(1.0, 100.0, 400)[None, :], np.linspace(0.0, 120.0, 400)
    passed = passed[::-1] if falling else passed
    elapsed = np.stack([passed, passed + 120.0])
    rise = heated("sweep", frequency, np.full((1, 400), 0.1), elapsed, loss=0.5)
    assert rise == pytest.approx(0.5 * elapsed)


def test_a_film_that_has_lost_its_main_spring_warms_by_a_finite_amount() -> None:
    """Chirps alone do not tell the main spring: the plain model may have lost it, and heat is reckoned over it."""
    cycles = np.array([[0.5], [9.5]])
    rise = heated("cyclic", np.array([[1.0]]), np.array([[0.1]]), cycles, loss=1e12)
    assert np.isfinite(rise).all()
    assert rise[1] >= rise[0]
