"""Warming of a film where its temperature was recorded, was not, and was from the middle of the session on."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from pipeline.diagnose.effects import Film, Scale, View
from pipeline.diagnose.mechanisms import effect_of

WARM = {"per_kelvin": 0.02, "rise_k": 5.0, "time_constant_s": 500.0}


def stiffness(session_s: float, temperature_k: float, first_temperature_s: float) -> float:
    """Share of the stiffness that a warming film keeps."""
    numbers = {f.name: np.zeros((1, 1)) for f in fields(View) if f.name not in ("scale", "test", "k0")}
    known = {"session_s": session_s, "temperature_k": temperature_k, "first_temperature_s": first_temperature_s}
    view = View(
        **numbers | {name: np.full((1, 1), value) for name, value in known.items()},
        scale=Scale(0.1, 5.0, 100.0, 4000.0, 30.0, 0.2),
        test="sweep",
    )
    film = Film(np.ones((1, 1), dtype=complex), np.ones((1, 1), dtype=complex))
    for softer in effect_of("thermal_softening", WARM).film:
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
