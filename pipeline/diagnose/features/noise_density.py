"""Colour of the noise of channels, from stretches without signal.

s(f) = white + pink (1 Hz/f) + red (1 Hz/f)², fitted to periodograms (Whittle 1953). The white part belongs to a recording, the
coloured ones, per Hz, to the sensor: they are common to the recordings of a session, whose lowest frequencies few show.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import minimize

from pipeline.diagnose.features.kinds import NoiseSample
from pipeline.diagnose.rules import RULES
from schemas.arrays import Float, Int

_PER_OCTAVE = 40
"""Ordinates of a periodogram per octave that are kept, as means."""
MAINS_HZ = (50.0, 100.0, 150.0)
"""Frequencies of the mains and of their first harmonics, Hz."""
_MAINS_WIDTH_HZ = 1.5
"""Half width about the mains that is left out of the noise, Hz."""

_MOST_DOUBT = 1.0
"""Largest variance of a logarithm that is allowed for: what the stretches leave open altogether is not noise."""
_RANGE, _RED_STEP = (16.0, 6.0), 1.0
"""How far coloured densities at 1 Hz may be below and above the white one, and steps of the red one, as logarithms."""
_LEAST_POWER = 1e-12
"""Share of the middle power below which an ordinate is no noise: a channel that stands still."""
_ALIKE = 0.3
"""Standard deviation of the logarithm of a sample's white variance between settings of one converter."""


@dataclass(frozen=True)
class NoiseLaw:
    """Coefficients of a channel: `white` (recordings,) variance of a sample, `pink` and `red` per Hz at 1 Hz.

    Coloured ones are such that residuals have variance 1 on average over what the stretches leave open about them: an
    estimate that is too small raises 1/s more than one that is too large lowers it. `pink_doubt` and `red_doubt` are their relative
    standard deviations.
    """

    white: Float
    pink: float
    red: float
    pink_doubt: float = 0.0
    red_doubt: float = 0.0

    def coefficient(self, recording: int, exponent: int) -> float:
        return (float(self.white[recording]), self.pink, self.red)[exponent]

    def doubt(self, exponent: int) -> float:
        """Relative standard deviation of a coefficient."""
        return (0.0, self.pink_doubt, self.red_doubt)[exponent]


def noise_sample(
    quantity: str,
    residual: Float,
    interval_s: float,
    *,
    degree: int = 1,
    above_hz: float = 0.0,
    below_hz: float = np.inf,
    setting: tuple[float, float] = (0.0, 0.0),
) -> NoiseSample | None:
    """Hann periodogram of a stretch of noise (n,) without its polynomial of that degree; None below 16 samples.

    The lowest bins, of which the polynomial takes a part, those outside `above_hz` to `below_hz` and those near the mains are
    left out.
    """
    n = residual.size
    if n < RULES.features.noise_samples:
        return None
    s = np.linspace(-1, 1, n)
    e = residual - np.polynomial.legendre.legval(s, np.polynomial.legendre.legfit(s, residual, degree))
    window = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
    power = np.abs(np.fft.rfft(e * window)) ** 2 / np.sum(window**2)
    frequency = np.arange(power.size) / (n * interval_s)
    kept = np.arange(power.size) >= 2 + degree // 2
    kept &= (frequency >= above_hz) & (frequency <= below_hz)
    kept[-1] = False
    for mains in MAINS_HZ:
        kept &= np.abs(frequency - mains) > max(_MAINS_WIDTH_HZ, 2.5 / (n * interval_s))
    # Neighbouring ordinates of a Hann window share data: two thirds of their number are independent.
    weight = np.full(int(kept.sum()), 2 / 3)
    return thinned(quantity, interval_s, frequency[kept], power[kept], weight, setting=setting)


def thinned(
    quantity: str,
    interval_s: float,
    f: Float,
    power: Float,
    weight: Float,
    *,
    setting: tuple[float, float] = (0.0, 0.0),
) -> NoiseSample | None:
    """Means over neighbouring ordinates, at most 40 per octave: the likelihood of a smooth law hardly changes."""
    if f.size == 0:
        return None
    order = np.argsort(f)
    f, power, weight = f[order], power[order], weight[order]
    cell = np.floor(np.log2(f) * _PER_OCTAVE).astype(np.int64)
    first = np.flatnonzero(np.diff(cell, prepend=cell[0] - 1))
    total = np.add.reduceat(weight, first)
    return NoiseSample(
        quantity,
        interval_s,
        np.add.reduceat(weight * f, first) / total,
        np.add.reduceat(weight * power, first) / total,
        total,
        setting,
    )


@lru_cache(maxsize=64)
def noise_law(samples: tuple[tuple[int, NoiseSample], ...], recordings: int) -> NoiseLaw:
    """Law of one channel of a session from (recording, sample) pairs. Remembered: a diagnosis asks for the same samples again and again.

    Recordings of one setting share the density of their white part, except those whose own periodograms clearly differ;
    recordings without any sample take the median one. At other rates with the same step of the converter the white variance of
    a sample is much the same: few low frequencies tell white from coloured noise only so.
    """
    groups = sorted({s.setting for _, s in samples})
    pool = _Pool.of(samples, groups)
    group = np.concatenate([np.full(s.power.size, groups.index(s.setting)) for _, s in samples])
    found, (pink, red), doubt = pool.fit(group)
    expected = pool.density(np.append(found, np.log([pink, red])), group)
    # Recordings that miss the common law where white noise rules get a white part of their own.
    ruled = pool.weight * np.exp(found)[group] * pool.rate / expected
    separate = group.copy()
    for r in np.unique(pool.recording):
        own = pool.recording == r
        count = float(ruled[own].sum())
        if count < RULES.features.own_noise_count:
            continue
        ratio = float(np.sum(ruled[own] * pool.power[own] / expected[own])) / count
        if abs(ratio - 1) * np.sqrt(count) > RULES.features.own_noise * max(ratio, 1.0):
            separate[own] = separate.max() + 1
    if separate.max() > group.max():
        separate = np.unique(separate, return_inverse=True)[1]
        found, (pink, red), doubt = pool.fit(separate)
    density = np.exp(found)
    white = np.full(recordings, np.nan)
    for r in np.unique(pool.recording):
        first = int(np.flatnonzero(pool.recording == r)[0])
        white[r] = density[separate[first]] * pool.rate[first]
    white[np.isnan(white)] = np.nanmedian(white)
    white = white * pool.unit
    white.flags.writeable = False  # who asks next gets the same
    return NoiseLaw(white, pink * pool.unit, red * pool.unit, *doubt)


@dataclass(frozen=True)
class _Pool:
    """All ordinates of a channel, (n,) each; `power` in the `unit` of the middle one, `rate` 1/s of the samples.

    `alike`: pairs of groups and logarithms of their converter's interval, of those that share its step.
    """

    recording: Int
    frequency: Float
    power: Float
    weight: Float
    rate: Float
    unit: float
    alike: tuple[tuple[Int, Float], ...]

    @classmethod
    def of(cls, samples: Sequence[tuple[int, NoiseSample]], groups: Sequence[tuple[float, float]]) -> _Pool:
        power = np.concatenate([s.power for _, s in samples])
        moving = power[power > np.finfo(float).tiny]
        unit = float(np.median(moving)) if moving.size else float(np.finfo(float).tiny)
        return cls(
            np.concatenate([np.full(s.power.size, r) for r, s in samples]),
            np.concatenate([s.frequency_hz for _, s in samples]),
            np.maximum(power / unit, _LEAST_POWER),
            np.concatenate([s.weight for _, s in samples]),
            np.concatenate([np.full(s.power.size, 1 / s.interval_s) for _, s in samples]),
            unit,
            tuple(_same_step(groups)),
        )

    def density(self, x: Float, group: Int) -> Float:
        """Expected power at x = log of white densities per Hz by group, of pink and of red."""
        white, pink, red = np.exp(x[:-2])[group], np.exp(x[-2]), np.exp(x[-1])
        return np.asarray(self.rate * (white + pink / self.frequency + red / self.frequency**2))

    def doubt(self, x: Float, group: Int) -> Float:
        """Variances of the logarithms of pink and red, from the information of the ordinates (each weighs one)."""
        expected = self.density(x, group)
        parts = np.zeros((expected.size, x.size))
        parts[np.arange(expected.size), group] = np.exp(x[:-2])[group]
        parts[:, -2], parts[:, -1] = np.exp(x[-2]) / self.frequency, np.exp(x[-1]) / self.frequency**2
        parts *= (self.rate / expected)[:, None]
        information = parts.T @ (self.weight[:, None] * parts) + np.eye(x.size) * _LEAST_POWER
        return np.asarray(np.diag(np.linalg.inv(information))[-2:])

    def fit(self, group: Int) -> tuple[Float, tuple[float, float], tuple[float, float]]:
        """Logarithms of the white densities, the expected pink and red ones, and relative standard deviations of these two.

        Whittle's likelihood, with every logarithm of the red density as likely beforehand: rests are too short to say how
        much red noise there is, and what they leave open is expected of longer records.
        """
        level = self._levels(group)
        middle = float(np.log(np.median(level)))
        start = np.concatenate([np.log(0.7 * level), [middle + np.log(0.1)]])
        bounds = [(np.log(v) - 8, np.log(v) + 3) for v in level] + [(middle - _RANGE[0], middle + _RANGE[1])]
        reds = np.arange(middle - _RANGE[0], middle + _RANGE[1] + 0.5, _RED_STEP)
        costs, ends, pinks, spreads = [], [], [], []
        for red in reds:
            found = minimize(
                lambda x, red=red: self._cost_without_red(x, red, group),
                start,
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
            )
            start = found.x
            ends.append(found.x)
            costs.append(float(found.fun))
            doubt = min(self.doubt(np.append(found.x, red), group)[0], _MOST_DOUBT)
            pinks.append(float(np.exp(found.x[-1] + doubt / 2)))
            spreads.append(float(np.expm1(doubt)))
        share = np.exp(-(np.array(costs) - min(costs)))
        share /= share.sum()
        pink, red = (_average(share, np.array(level)) for level in (pinks, np.exp(reds)))
        within = float(share @ (np.array(spreads) * np.array(pinks) ** 2)) / pink[0] ** 2
        return ends[int(np.argmin(costs))][:-1], (pink[0], red[0]), (float(np.hypot(pink[1], np.sqrt(within))), red[1])

    def _cost_without_red(self, x: Float, red: float, group: Int) -> tuple[float, Float]:
        total, gradient = self._cost(np.append(x, red), group)
        return total, gradient[:-1]

    def _levels(self, group: Int) -> Float:
        """Mean density per Hz of each group."""
        count = int(group.max()) + 1
        return np.asarray(
            np.bincount(group, self.weight * self.power / self.rate, count) / np.bincount(group, self.weight, count)
        )

    def _cost(self, x: Float, group: Int) -> tuple[float, Float]:
        """Whittle's negative log likelihood at the logarithms x, and its gradient."""
        s = self.density(x, group)
        slope = self.weight * (1 - self.power / s) / s * self.rate
        white, pink, red = np.exp(x[:-2]), np.exp(x[-2]), np.exp(x[-1])
        gradient = np.concatenate(
            [
                np.bincount(group, slope, white.size) * white,
                [float(np.sum(slope / self.frequency)) * pink, float(np.sum(slope / self.frequency**2)) * red],
            ]
        )
        total = float(self.weight @ (np.log(s) + self.power / s))
        for groups, log_interval in self.alike:
            variance = x[groups] - log_interval
            off = variance - variance.mean()
            total += float(off @ off) / (2 * _ALIKE**2)
            gradient[groups] += off / _ALIKE**2
        return total, gradient


def _average(share: Float, values: Float) -> tuple[float, float]:
    """Mean and relative standard deviation of values with their probabilities."""
    mean = float(share @ values)
    return mean, float(np.sqrt(share @ (values / mean - 1) ** 2))


def _same_step(settings: Sequence[tuple[float, float]]) -> Iterator[tuple[Int, Float]]:
    """Groups with the same step of the converter, where there are several, and logarithms of its intervals."""
    for step in sorted({step for _, step in settings}):
        groups = np.array(
            [i for i, (interval, own) in enumerate(settings) if own == step and interval > 0 and step > 0]
        )
        if groups.size > 1:
            yield groups, np.log([settings[i][0] for i in groups])
