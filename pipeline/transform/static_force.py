"""Static force of an actuator under voltage, with the drift of its pre-stretch fitted before, during and after at once.

A film that was just stretched goes on relaxing; under voltage most of the force comes at once and a part slowly. The level before
alone would book the drift as force: 5 % of it and more. What the drift looks like, whether there is a slow part and how noise goes
together is not known beforehand: every form that is plausible counts by how probable it makes the record. Does not belong here: one
form (`static_force_form`), edges of the voltage, and means of repeats.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.transform.static_force_form import (
    FormFit,
    Searched,
    Whitener,
    Windows,
    course_covariance,
    fit_form,
    noise_covariance,
)
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

_WINDOWS, _ALL_WINDOWS, _LEAST_WINDOWS = 30, 300, 6
"""Means into which each part of the record, before, during and after, is taken together, and all parts; drift and creep are slow."""
_FEWEST_SAMPLES = 4
_WANDERS: Float = np.concatenate([[0.0], np.geomspace(1e-2, 1e10, 25)])
"""Variance of the course's second derivative over a record's length, in units of the variance of a window's noise, that is tried."""
_NO_WANDER = float(np.log(_WANDERS.size - 1))
"""Log of the prior probability that the drift is a logarithm of time, over that of each wander: as much as all of them together, as a slow part
of the force is as probable as none. Were each as probable, wanders that no record needs would widen the intervals."""
_MEMORIES: Float = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0])
"""Times for which noise remembers, in lengths of a window, that are tried."""
_COARSE = (0, 6, 10, 14, 18, 22)
"""Places of `_WANDERS` at which searches begin everywhere; all others begin where their neighbour ended."""
_COUNTS = 6.0
"""Log probability below the best form from which neighbours are no longer tried: less than 1/400."""


@dataclass(frozen=True)
class StaticForce:
    """Drops of tension under voltage, corrected for drift.

    Parameters
    ----------
    force_n : (C,) N, positive
        What each time of voltage comes to in the end.
    force_sd_n : (C,) N
        Standard deviation, with what drift, slow part and noise leave open, and their forms.
    degrees_of_freedom : int
        Of these standard deviations.
    """

    force_n: Float
    force_sd_n: Float
    degrees_of_freedom: int


def fit_static_force(time: Float, force: Float, cycles: Sequence[tuple[float, float]], settle_s: float) -> StaticForce:
    """Static force of every time of voltage of a record.

    Parameters
    ----------
    time : (n,) s, ascending
    force : (n,) N, tension
    cycles : pairs of s
        When the voltage came on and went off, in the order of time.
    settle_s : float
        Time after every edge that is left out: the voltage on its way, the ringing of the clamp.

    Returns
    -------
    StaticForce

    Raises
    ------
    NotIdentifiableError
        Where a time of voltage or the rest before the first has fewer than four samples.

    Notes
    -----
    Samples are taken together to means over windows. Forms differ in whether a part of the force comes slowly, how much the drift
    wanders off a logarithm of time, and how long noise remembers; that it does not wander is as probable beforehand as that it does. The force is the mean over all forms by their probability, its
    variance that within forms and that between them (nested Laplace approximations: Rue, Martino and Chopin 2009).
    """
    windows = _take_windows(time, force, cycles, settle_s)
    forms = _Forms(windows)
    found = [fit for slow in (False, True) for fit in forms.fit_around_best(Searched.of(windows, slow=slow))]
    return _average(found, windows.time.size - len(cycles) - 3)


def _take_windows(time: Float, force: Float, cycles: Sequence[tuple[float, float]], settle_s: float) -> Windows:
    edges = [float(time[0]) - settle_s, *(edge for cycle in cycles for edge in cycle), float(time[-1])]
    interval = float(np.median(np.diff(time)))
    windows = int(np.clip(_ALL_WINDOWS // (len(edges) - 1), _LEAST_WINDOWS, _WINDOWS))
    means: list[tuple[float, float, float]] = []
    for number, (begin, end) in enumerate(itertools.pairwise(edges)):
        inside = np.flatnonzero((time >= begin + settle_s) & (time < end))
        if inside.size < _FEWEST_SAMPLES:
            if number == 0 or number % 2:
                when = "before the voltage" if number == 0 else "while the voltage is on"
                raise NotIdentifiableError(
                    f"{inside.size} samples of force {when}",
                    expected=f"at least {_FEWEST_SAMPLES} after it has settled",
                )
            continue
        for part in np.array_split(inside, min(windows, inside.size)):
            means.append((float(time[part].mean()), float(force[part].mean()), interval * part.size))
    at, value, length = (np.array(column, dtype=float) for column in zip(*means, strict=True))
    return Windows(at, value, length, float(time[0]), float(time[-1] - time[0]), tuple(cycles))


@dataclass
class _Forms:
    """Forms of one record on a grid of `_WANDERS` and `_MEMORIES`; whiteners are kept, for all searches share them."""

    windows: Windows
    whiteners: dict[tuple[int, int], Whitener] = field(default_factory=dict)

    def __post_init__(self) -> None:
        length = float(np.median(self.windows.length_s))
        self.course = course_covariance(self.windows)
        self.noise = [noise_covariance(self.windows, float(memory) * length) for memory in _MEMORIES]

    def fit_around_best(self, searched: Searched) -> list[FormFit]:
        """Fits of all places of the grid that count, from the best one outwards."""
        coarse = {(place, 0): self._fit((place, 0), searched, searched.spread_starts()) for place in _COARSE}
        best = max(coarse, key=lambda place: coarse[place].log_probability)
        found, waiting = {best: coarse[best]}, [best]
        while waiting:
            here = waiting.pop(0)
            if found[here].log_probability < max(fit.log_probability for fit in found.values()) - _COUNTS:
                continue
            for place in self._neighbours(here):
                if place not in found:
                    starts = [found[here].searched, *([coarse[place].searched] if place in coarse else [])]
                    found[place] = self._fit(place, searched, starts)
                    waiting.append(place)
        return list(found.values())

    def _fit(self, place: tuple[int, int], searched: Searched, starts: Iterable[Float]) -> FormFit:
        if place not in self.whiteners:
            wander, memory = place
            self.whiteners[place] = Whitener.of(self.noise[memory] + _WANDERS[wander] * self.course)
        fits = (fit_form(self.windows, self.whiteners[place], searched, start) for start in starts)
        best = max(fits, key=lambda fit: fit.log_probability)
        prior = _NO_WANDER if place[0] == 0 else 0.0
        return replace(best, log_probability=best.log_probability + prior)

    def _neighbours(self, place: tuple[int, int]) -> list[tuple[int, int]]:
        wander, memory = place
        beside = [(wander + 1, memory), (wander - 1, memory), (wander, memory + 1), (wander, memory - 1)]
        return [(w, m) for w, m in beside if 0 <= w < _WANDERS.size and 0 <= m < _MEMORIES.size]


def _average(found: Sequence[FormFit], freedom: int) -> StaticForce:
    """Means over forms by their probability, with variances within and between them."""
    log_probability = np.array([fit.log_probability for fit in found])
    share = np.exp(log_probability - log_probability.max())
    share /= share.sum()
    force, variance = np.array([fit.force_n for fit in found]), np.array([fit.variance for fit in found])
    mean = share @ force
    return StaticForce(mean, np.sqrt(share @ (variance + (force - mean) ** 2)), freedom)
