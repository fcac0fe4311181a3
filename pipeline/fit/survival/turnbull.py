"""Survival curve of one group from lives of any censoring: Turnbull's estimate.

It is Kaplan–Meier's curve where all lives are exact or right-censored. Where failures were found at inspections the curve
is only known to fall somewhere within each of its intervals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.fit.survival.kaplan_meier import Estimate, Z
from pipeline.fit.survival.lifetime_distributions import Lives
from schemas.arrays import Bool, Float, Int
from schemas.errors import NotIdentifiableError

_ROUNDS = 20_000
_GAP = 1e-7
"""The likelihood is at its maximum when no interval's gradient exceeds this share of a specimen each …"""
_SHIFT = 1e-11
"""… nor, weighted with its probability, this one: what an interval that should be empty still holds."""
_LEAST_MASS = 1e-9
_MOST_FOR_ERRORS = 400
"""Up to so many intervals there are standard errors: they need the inverse of a matrix of that size."""


@dataclass(frozen=True)
class Turnbull:
    """S(t) of a group, falling within m intervals.

    Parameters
    ----------
    begins, ends : (m,) s, the curve falls between them; equal where a failure is known exactly
    mass : (m,) probability to fail within
    survival : (m,) probability to live longer than `ends`
    standard_error : (m,) of `survival`, from the observed information; NaN where there are too many intervals
    lower, upper : (m,) log–log 95 % band; NaN where S is 1 or 0
    at_risk : (m,) specimens under watch that may still live at `begins`
    log_likelihood : Σ ln P(life within its limits | it was longer than at entry)
    specimens, failed : how many there are
    """

    begins: Float
    ends: Float
    mass: Float
    survival: Float
    standard_error: Float
    lower: Float
    upper: Float
    at_risk: Int
    log_likelihood: float
    specimens: int
    failed: int

    def survival_at(self, times: Float) -> Float:
        """S at `times` in s; NaN within an interval in which it falls, and beyond the last where somebody lives."""
        t = np.asarray(times, dtype=np.float64)
        place = np.searchsorted(self.ends, t, side="right")
        known = np.concatenate(([1.0], self.survival))[place]
        following = np.minimum(place, self.begins.size - 1)
        falling = (place < self.begins.size) & (self.begins[following] < t) & (t < self.ends[following])
        beyond = (place == self.begins.size) & (self.survival[-1] > 1e-12)
        return np.where(falling | beyond, np.nan, known)

    def at(self, time: float) -> Estimate:
        """S at one time in s with its 95 % limits; NaN where it is not known, limits NaN where it is 1 or 0."""
        value = float(self.survival_at(np.array(time)))
        row = int(np.searchsorted(self.ends, time, side="right")) - 1
        if np.isnan(value) or row < 0:
            return Estimate(value)
        return Estimate(value, float(self.lower[row]), float(self.upper[row]))

    def median(self) -> Estimate:
        """Where S has fallen to 1/2, the end of that interval, with the band inverted; NaN for what is not reached."""
        return Estimate(*(_first(self.ends, curve <= 0.5 + 1e-9) for curve in (self.survival, self.lower, self.upper)))


def _first(time: Float, reached: Bool) -> float:
    return float(time[np.argmax(reached)]) if reached.any() else float("nan")


def estimate_turnbull(lives: Lives) -> Turnbull:
    """Turnbull's estimate of the survival curve.

    Parameters
    ----------
    lives : n lives, exact, censored in any way or come under watch late

    Returns
    -------
    Turnbull
        The intervals with a probability above 0.

    Raises
    ------
    NotIdentifiableError
        Nobody failed.

    Notes
    -----
    B. W. Turnbull, J. R. Stat. Soc. B 38 (1976) 290; the intervals after H. Frydman, ibid. 56 (1994) 71, where
    specimens came under watch late. The self-consistent equations are iterated with the acceleration of R. Varadhan and
    C. Roland, Scand. J. Stat. 35 (2008) 335 until no interval's gradient exceeds the number of specimens.
    """
    if lives.failures == 0:
        raise NotIdentifiableError("nobody failed: no curve", expected="at least one failure")
    begins, ends = _innermost(lives)
    # A life lies in (lower, upper], an exact one at its time: of the intervals those from `first` up to `past`.
    exact = lives.exact
    first = np.where(exact, np.searchsorted(ends, lives.lower, "left"), np.searchsorted(begins, lives.lower, "left"))
    past = np.searchsorted(ends, lives.upper, "right")
    point = begins == ends  # a failure known to the end of an open interval's beginning is before it
    first = np.where(exact, first, _skip_points(begins, point, lives.lower, first))
    entry = np.zeros(exact.size) if lives.entered is None else lives.entered
    start = np.where(entry > 0, _skip_points(begins, point, entry, np.searchsorted(begins, entry, "left")), 0)
    rows, count = np.unique(np.stack((first, past, start)), axis=1, return_counts=True)
    ranges = _Ranges(rows[0], rows[1], rows[2], count.astype(np.float64))
    mass = _maximise(ranges, begins.size)
    return _curve(lives, begins, ends, mass, mass > _LEAST_MASS, ranges)


def _skip_points(begins: Float, point: Bool, at: Float, place: Int) -> Int:
    """The first interval behind `at` when the one that begins there is a single point, which the life has outlived."""
    inside = np.minimum(place, begins.size - 1)
    return np.asarray(place + ((place < begins.size) & point[inside] & (begins[inside] == at)))


def _innermost(lives: Lives) -> tuple[Float, Float]:
    """Beginnings and ends of the intervals that can have probability: a beginning that an end follows at once."""
    exact = lives.exact
    # At one time a point begins (0), what is closed there ends (1), and what is open there begins (2).
    left = np.concatenate((lives.lower[~exact], lives.lower[exact]))
    opening = np.concatenate((np.full(int((~exact).sum()), 2), np.zeros(int(exact.sum()), dtype=int)))
    right = lives.upper
    if lives.entered is not None:
        right = np.concatenate((right, lives.entered[lives.entered > 0]))
    value = np.concatenate((left, right))
    kind = np.concatenate((opening, np.ones(right.size, dtype=int)))
    order = np.lexsort((kind, value))
    value, kind = value[order], kind[order]
    found = np.flatnonzero((kind[:-1] != 1) & (kind[1:] == 1))
    return value[found], value[found + 1]


@dataclass(frozen=True)
class _Ranges:
    """Of r different kinds of lives: the intervals `first` to before `past`, watched from `start`, and how many there are."""

    first: Int
    past: Int
    start: Int
    count: Float

    def inside(self, mass: Float) -> tuple[Float, Float]:
        """(r,) probability of each kind of life, and that of living to its entry."""
        sums = np.concatenate(([0.0], np.cumsum(mass)))
        return sums[self.past] - sums[self.first], sums[-1] - sums[self.start]

    def log_likelihood(self, mass: Float) -> float:
        life, watched = self.inside(mass)
        return float(self.count @ (np.log(np.maximum(life, 1e-300)) - np.log(np.maximum(watched, 1e-300))))

    def gradient(self, mass: Float) -> Float:
        """(m,) of the log-likelihood; weighted with the masses it adds up to 0."""
        life, watched = self.inside(mass)
        steps = np.zeros(mass.size + 1)
        np.add.at(steps, self.first, self.count / np.maximum(life, 1e-300))
        np.add.at(steps, self.past, -self.count / np.maximum(life, 1e-300))
        np.add.at(steps, self.start, -self.count / np.maximum(watched, 1e-300))
        steps[-1] = 0.0
        return np.asarray(np.cumsum(steps)[:-1])

    def members(self, intervals: int) -> tuple[Float, Float]:
        """(r, m) of ones where a kind of life, and the time after its entry, has an interval."""
        at = np.arange(intervals)
        life = (self.first[:, None] <= at) & (at < self.past[:, None])
        return life.astype(np.float64), (self.start[:, None] <= at).astype(np.float64)


def _maximise(ranges: _Ranges, intervals: int) -> Float:
    total = float(ranges.count.sum())

    def improve(mass: Float) -> Float:
        _, watched = ranges.inside(mass)
        seen_and_unseen = float((ranges.count / np.maximum(watched, 1e-300)).sum())
        better = mass * (ranges.gradient(mass) + seen_and_unseen)
        return np.asarray(better / better.sum())

    mass = np.full(intervals, 1.0 / intervals)
    value = ranges.log_likelihood(mass)
    for _ in range(_ROUNDS):
        once = improve(mass)
        twice = improve(once)
        step, bend = once - mass, twice - 2 * once + mass
        size = float(np.sqrt(bend @ bend))
        length = max(float(np.sqrt(step @ step)) / size, 1.0) if size > 0 else 1.0
        # No interval is emptied by a leap: one without probability never gets any again.
        trial = np.maximum(mass + 2 * length * step + length**2 * bend, 0.1 * twice)
        trial = improve(trial / trial.sum())
        reached = ranges.log_likelihood(trial)
        if not reached >= value:
            trial, reached = twice, ranges.log_likelihood(twice)
        mass, value = trial, reached
        gradient = ranges.gradient(mass)
        if gradient.max() <= total * _GAP and np.abs(mass * gradient).max() <= total * _SHIFT:
            break
    return mass


def _curve(lives: Lives, begins: Float, ends: Float, mass: Float, kept: Bool, ranges: _Ranges) -> Turnbull:
    probability = mass[kept] / mass[kept].sum()
    survival = np.maximum(1 - np.cumsum(probability), 0.0)
    survival[survival < 1e-12] = 0.0
    error = _standard_errors(ranges, mass, kept) if kept.sum() <= _MOST_FOR_ERRORS else np.full(survival.size, np.nan)
    lower, upper = np.full(survival.size, np.nan), np.full(survival.size, np.nan)
    inside = (survival > 0) & (survival < 1)
    log_survival = np.log(survival[inside])
    factor = np.exp(Z * error[inside] / (survival[inside] * -log_survival))
    lower[inside], upper[inside] = np.exp(log_survival * factor), np.exp(log_survival / factor)
    closed = np.isfinite(ends[kept])
    value = ranges.log_likelihood(mass)
    return Turnbull(
        begins[kept][closed],
        ends[kept][closed],
        probability[closed],
        survival[closed],
        error[closed],
        lower[closed],
        upper[closed],
        _at_risk(lives, begins[kept], ends[kept])[closed],
        value,
        lives.lower.size,
        lives.failures,
    )


def _at_risk(lives: Lives, begins: Float, ends: Float) -> Int:
    """(m,) specimens that are under watch and may live where each interval begins (of a point: that live until then)."""
    last = np.where(np.isinf(lives.upper), lives.lower, lives.upper)
    entry = np.zeros(lives.lower.size) if lives.entered is None else lives.entered
    reached = np.where(begins == ends, np.nextafter(begins, -np.inf), begins)
    gone = np.searchsorted(np.sort(last), reached, side="right")
    return np.asarray(np.searchsorted(np.sort(entry), reached, side="right") - gone)


def _standard_errors(ranges: _Ranges, mass: Float, kept: Bool) -> Float:
    """(m,) standard errors of S from the observed information of the masses, which add up to one."""
    life, watched = (part[:, kept] for part in ranges.members(mass.size))
    inside, later = ranges.inside(mass)
    information = (life / inside[:, None]).T @ (ranges.count[:, None] * life / inside[:, None])
    information -= (watched / later[:, None]).T @ (ranges.count[:, None] * watched / later[:, None])
    m = information.shape[0]
    if m == 1:
        return np.zeros(1)
    free = np.vstack((np.eye(m - 1), -np.ones(m - 1)))
    covariance = free @ np.linalg.pinv(free.T @ information @ free) @ free.T
    sums = np.tril(np.ones((m, m)))
    return np.asarray(np.sqrt(np.maximum(np.diag(sums @ covariance @ sums.T), 0.0)))
