"""A self-sensing film as a plant for controllers, and the films that its measurements leave possible.

How the film relaxes is that of the mechanical fit; how much capacitance and tension a voltage moves is that of recorded
steps, which the film is taken through from the first to the last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.fit.weighted import weighted_mean
from pipeline.physics.film import RelaxationModel, Shape
from pipeline.physics.sensed_film import SensedFilms, sense_films
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

POSSIBLE = 40
"""Films that are drawn from what the measurements leave open."""
_WIDEST_LOG = 1.5
"""Largest deviation of a logarithm that is drawn: of an arm that is hardly resolved the covariance says little."""
_FEWEST_STEPS = 3


@dataclass(frozen=True)
class SensedStep:
    """A step of the voltage as it was recorded: from and to in s, kV, drop of tension and change of capacitance against
    the film at rest, with their standard deviations.
    """

    start_s: float
    end_s: float
    voltage_kv: float
    force_step_n: float
    force_step_sd_n: float
    capacitance_step_pf: float
    capacitance_step_sd_pf: float


@dataclass(frozen=True)
class Plant:
    """What controllers are designed for.

    Parameters
    ----------
    film : as fitted; one
    possible : films that the fit and the scatter of the steps leave possible
    gain_sd, force_sd : standard deviations of the logarithms of both gains, without those of the fit
    largest_kv : largest voltage of the steps
    steps : how many the gains rest on
    """

    film: SensedFilms
    possible: SensedFilms
    gain_sd: float
    force_sd: float
    largest_kv: float
    steps: int


def identify_plant(
    model: RelaxationModel,
    shape: Shape,
    covariance: Float,
    recordings: Sequence[Sequence[SensedStep]],
    *,
    count: int = POSSIBLE,
    seed: int = 0,
) -> Plant:
    """The plant of one specimen.

    Parameters
    ----------
    model, shape, covariance : the mechanical fit; of the covariance (p, p) the material's parameters come first
    recordings : steps of each recording with open loop, in time order, each from the film at rest
    count, seed : of the possible films

    Raises
    ------
    NotIdentifiableError
        The film has no main spring, or fewer than three steps with a capacitance.
    """
    steps = [step for recording in recordings for step in recording]
    if len(steps) < _FEWEST_STEPS:
        raise NotIdentifiableError(
            f"{len(steps)} steps with a capacitance and open loop", expected=f"{_FEWEST_STEPS} or more"
        )
    if not shape.spring or model.k0 <= 0:
        raise NotIdentifiableError(
            "the film has no main spring: under a voltage it never comes to rest",
            expected="sweeps or a relaxation that reach low enough frequencies",
        )
    film = sense_films([model], np.ones(1), np.ones(1))
    rng = np.random.default_rng(seed)
    p = shape.size
    open_ = rng.multivariate_normal(np.zeros(p), covariance[:p, :p], count, check_valid="ignore", method="eigh")
    theta = shape.theta(model) + np.clip(open_, -_WIDEST_LOG, _WIDEST_LOG)
    drawn = sense_films([shape.model(one) for one in theta], np.ones(count), np.ones(count))
    all_films = SensedFilms(*(np.concatenate(pair) for pair in zip(_parts(film), _parts(drawn), strict=True)))

    extensions = np.concatenate([_follow(all_films, recording) for recording in recordings if recording])
    changes, noise = _columns(steps, "capacitance_step_pf", "capacitance_step_sd_pf")
    means = [weighted_mean(changes / e, noise / e) for e in extensions.T]
    gains = np.array([m.value for m in means])
    gain_sd = abs(means[0].sd / means[0].value)
    squared = np.array([step.voltage_kv for step in steps]) ** 2
    forces, force_noise = _columns(steps, "force_step_n", "force_step_sd_n")
    force = weighted_mean(forces / squared, force_noise / squared)
    force_sd = abs(force.sd / force.value)
    scatter = np.exp(rng.normal(size=(2, count)) * np.array([[gain_sd], [force_sd]]))
    return Plant(
        SensedFilms(film.springs, film.tau_s, gains[:1], np.array([force.value])),
        SensedFilms(drawn.springs, drawn.tau_s, gains[1:] * scatter[0], force.value * scatter[1]),
        gain_sd,
        force_sd,
        float(np.sqrt(squared.max())),
        len(steps),
    )


def _follow(films: SensedFilms, steps: Sequence[SensedStep]) -> Float:
    """(steps, n) extensions of the films at the end of each step."""
    points, before, found = np.zeros_like(films.springs), steps[0].start_s, []
    for step in steps:
        for until, squared in ((step.start_s, 0.0), (step.end_s, step.voltage_kv**2)):
            advance, gather = films.propagate(max(until - before, 0.0))
            points = np.einsum("nij,nj->ni", advance, points) + gather * squared
            before = until
        found.append(films.extend(points, np.full(len(films), step.voltage_kv**2)))
    return np.array(found)


def _parts(films: SensedFilms) -> tuple[Float, Float, Float, Float]:
    return films.springs, films.tau_s, films.gain_pf_per_kv2, films.force_n_per_kv2


def _columns(steps: Sequence[SensedStep], value: str, sd: str) -> tuple[Float, Float]:
    found, noise = (np.array([getattr(step, name) for step in steps]) for name in (value, sd))
    return found, np.maximum(noise, 1e-6 * np.abs(found).max())
