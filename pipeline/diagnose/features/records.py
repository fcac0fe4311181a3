"""A recording's input and output on one clock, thinned to what its features need, with rest and noise found in it.

Belongs here: what all protocols share before their functionals are formed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.diagnose.features.functionals import Component
from pipeline.diagnose.features.kinds import NoiseSample
from pipeline.diagnose.features.noise_density import noise_sample
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.mains import mains_of
from pipeline.physics.rig import rig_prior
from pipeline.transform.sampling import Sampled, runs, sample
from schemas.arrays import Bool, Complex, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from schemas.recording import Channel, Recording

_PASSED = 0.7
"""Share of half the sample rate below which thinning leaves a spectrum as it is."""
_CLEARLY_AWAY, _FIRST_LEVEL, _LEAVING, _LEAST_OF_STEP = 6.0, 40, 0.2, 0.25
"""Standard deviations from its level at which an input has clearly left its rest; share of the record, and of a
cycle, before that in which it may have begun to; and least noise over the step of the converter."""
_RARER = 1.5
"""Times the clock's interval from which a channel's samples are so much rarer that they were interpolated."""
CLEAR_OF_HARMONICS = 3.5
"""Times the highest frequency of a sweep above which neither it nor its harmonics show, but the noise."""
_WHOLE = 0.02
"""Samples by which a period may miss a whole number."""
_NORMAL_MEDIAN = 0.6745
"""Median of the size of a standard normal number."""
_HIDES = 0.8
"""Share of the scatter of a converter's rounding up to which what scatters may be rounding alone."""
_WHOLE_STEPS = 0.05
"""Steps of a converter by which a change may miss a whole number of them."""
_ARITHMETIC = 1e-7
"""Share of a channel's largest value below which what scatters is arithmetic, in single precision: no instrument is as quiet."""


@dataclass(frozen=True)
class Record:
    """Channels on one clock.

    Parameters
    ----------
    interval_s : s
    values : quantity → (n,) without NaN; gaps are bridged by straight lines and marked in `lost`
    lost : (n,) where a channel had no sample, and beside it
    sampled : the clock with the channels' start times and filters
    thinned : samples of the recording per sample here
    resolution : quantity → converter step, None where not known
    own_interval_s : quantity → interval of the channel's own samples, s; longer than the clock's where it was interpolated
    steps : quantity → step of which all changes of its samples are multiples, 0 where there is none
    """

    interval_s: float
    values: Mapping[str, Float]
    lost: Bool
    sampled: Sampled
    thinned: int
    resolution: Mapping[str, float | None]
    own_interval_s: Mapping[str, float]
    steps: Mapping[str, float]

    @property
    def count(self) -> int:
        return self.lost.size

    @property
    def slowed(self) -> bool:
        """Whether most of the clock's instants have no sample: a recording that is sampled ever more rarely."""
        return bool(self.lost.mean() > RULES.features.most_lost)

    @property
    def time_s(self) -> Float:
        return np.asarray(np.arange(self.count) * self.interval_s, dtype=np.float64)

    def channel_factor(self, output: str, input_: str) -> Callable[[Float], Complex]:
        """What start differences and filters do to the spectrum of `output` against that of `input_`."""
        return lambda frequency: np.asarray(1 / self.sampled.alignment(frequency, output, input_))

    @property
    def mains(self) -> tuple[Component, ...]:
        """Mains in a channel, as far as thinning leaves them; no part of the noise until a session says how strong they are."""
        return mains_of(lambda frequency: thinned_gain(frequency * self.interval_s / self.thinned, self.thinned))

    def noise(self, quantity: str, values: Float, *, degree: int = 1, below_hz: float = np.inf) -> NoiseSample | None:
        """Periodogram of a stretch (n,) of a channel without signal, or with one that a polynomial of that degree follows.

        Where the converter's step hides the noise it is that of the rounding; None where nothing scatters and there is no such step:
        next to an output without noise any model is wrong by thousands of times its noise.
        """
        passed_hz = _PASSED * 0.5 / self.interval_s if self.thinned > 1 else np.inf
        found = noise_sample(
            quantity,
            values,
            self.interval_s,
            degree=degree,
            below_hz=min(below_hz, passed_hz, self._sampled_hz(quantity)),
            setting=self.setting(quantity),
        )
        if found is None or not self._is_hidden(quantity, values):
            return found
        rounding = self.steps[quantity] ** 2 / 12 / self.thinned
        return replace(found, power=np.maximum(found.power, rounding)) if rounding > 0 else None

    def rounding(self, quantity: str, values: Float) -> float:
        """Variance of a sample's rounding where it hides the noise of a stretch (n,) of a channel, in its unit squared; 0 where it does not.

        Rounding is as good as white noise in what moves by many steps of the converter; in what hardly moves it does not average out.
        """
        return self.steps[quantity] ** 2 / 12 if self._is_hidden(quantity, values) else 0.0

    def _is_hidden(self, quantity: str, values: Float) -> bool:
        scatter = float(np.diff(values, 2).std()) / np.sqrt(6) if values.size > 2 else 0.0
        by_step = _HIDES * self.steps[quantity] / np.sqrt(12 * self.thinned)
        return bool(scatter <= max(by_step, _ARITHMETIC * self._find_largest(quantity)))

    def _find_largest(self, quantity: str) -> float:
        return float(np.abs(self.values[quantity]).max(initial=0.0))

    def noise_beyond(self, quantity: str, above_hz: float) -> NoiseSample | None:
        """Periodogram of a whole channel at its own samples above a frequency; None where there is nothing above that."""
        found = noise_sample(
            quantity,
            _bridged(self.sampled.values[quantity]),
            self.interval_s / self.thinned,
            above_hz=above_hz,
            below_hz=self._sampled_hz(quantity),
            setting=self.setting(quantity),
        )
        least = (_ARITHMETIC * self._find_largest(quantity)) ** 2
        return None if found is None or float(np.median(found.power)) <= least else found

    def _sampled_hz(self, quantity: str) -> float:
        """Frequency up to which a channel's own samples show its spectrum, where the clock's are more: they are interpolated."""
        own_s = self.own_interval_s[quantity]
        return _PASSED * 0.5 / own_s if own_s > _RARER * self.interval_s / self.thinned else np.inf

    def setting(self, quantity: str) -> tuple[float, float]:
        """Interval of the converter's samples in s and its step, to three digits."""
        interval_s, step = self.interval_s / self.thinned, self.resolution.get(quantity) or 0.0
        return float(f"{interval_s:.3e}"), float(f"{step:.2e}")


def record(
    channels: Mapping[str, Channel],
    recording: Recording,
    *,
    highest_hz: float,
    period_s: float | None = None,
    may_slow_down: bool = False,
) -> Record:
    """Channels on one clock with at least ten samples per cycle of `highest_hz`.

    Parameters
    ----------
    channels, recording : what was recorded
    highest_hz : highest frequency of interest, Hz
    period_s : a time that has a whole number of samples in the recording, and keeps one
    may_slow_down : whether a recording may be sampled ever more rarely; its samples are then taken as they are

    Raises
    ------
    NotIdentifiableError
        where channels have no common time or too much is lost
    """
    sampled = sample(channels, recording.start_ns)
    lost = ~sampled.finite
    factor = max(1, int(np.floor(1 / (10 * highest_hz * sampled.interval_s))))
    if period_s is not None:
        factor = _keep_whole(period_s / sampled.interval_s, factor)
    rare = lost.mean() > RULES.features.most_lost
    if rare and not (may_slow_down and factor == 1):
        raise NotIdentifiableError(
            f"{100 * lost.mean():.0f} % of the samples are lost", where=recording.metadata.recording_id
        )
    values = {q: _bridged(v) for q, v in sampled.values.items()}
    thinned = {q: thin(v, factor) for q, v in values.items()}
    count = next(iter(thinned.values())).size
    gone = np.zeros(count, dtype=bool)
    if rare:
        gone = lost
    else:
        for first, stop in runs(lost):
            gone[max(first // factor - 1, 0) : stop // factor + 2] = True
    return Record(
        sampled.interval_s * factor,
        thinned,
        gone,
        sampled,
        factor,
        {q: c.resolution for q, c in channels.items()},
        {q: float(np.median(np.diff(c.time_ns))) * 1e-9 for q, c in channels.items()},
        {q: find_converter_step(c.values) for q, c in channels.items()},
    )


def _keep_whole(samples: float, factor: int) -> int:
    """The largest factor up to the given by which that many samples are whole again; the given where they are not whole."""
    whole = round(samples)
    if abs(samples - whole) > _WHOLE:
        return factor
    return max(f for f in range(1, factor + 1) if whole % f == 0)


def thin(values: Float, factor: int) -> Float:
    """Every `factor`-th sample after a symmetric low pass: the same for every channel, so that ratios do not change."""
    if factor == 1:
        return values
    from scipy.signal import upfirdn  # half a second, which most recordings need not wait for

    taps = _low_pass(factor)
    half = 8 * factor
    padded = np.concatenate([np.full(half, values[0]), values, np.full(half, values[-1])])
    return np.asarray(upfirdn(taps, padded, 1, factor)[16:][: (values.size - 1) // factor + 1])


def _low_pass(factor: int) -> Float:
    from scipy.signal import firwin

    return np.asarray(firwin(16 * factor + 1, 0.8 / factor, window=("kaiser", 8.0)))


def thinned_gain(cycles: Float, factor: int) -> Float:
    """What thinning leaves of a sinusoid of that many cycles per sample before it."""
    if factor == 1:
        return np.ones_like(cycles)
    return np.asarray(
        np.abs(np.exp(-2j * np.pi * np.multiply.outer(cycles, np.arange(16 * factor + 1))) @ _low_pass(factor))
    )


def _bridged(values: Float) -> Float:
    bad = ~np.isfinite(values)
    if not bad.any():
        return values
    if bad.all():
        raise NotIdentifiableError("a channel has no finite sample")
    index = np.arange(values.size)
    return np.interp(index, index[~bad], values[~bad])


def rest_samples(input_: Float, *, back: int = 2, cycle: float | None = None) -> int:
    """Samples before the input leaves its rest for good, less `back`; 0 where there are hardly any.

    It has left after the last three samples in a row that are no further from its level than six times its noise, which is read
    off second differences: a slow start is no noise. `cycle` is the number of samples in a period of a sinusoid, which leaves its
    rest long before it shows, but not earlier than a fifth of that before a tenth of its way.
    """
    reach = float(np.abs(input_ - input_[0]).max())
    if reach == 0:
        return input_.size
    # A tenth of the way is motion beyond doubt; the first part of what lies before it is rest.
    certain = int((np.abs(input_ - np.median(input_[: max(8, input_.size // 500)])) > 0.1 * reach).argmax())
    head = input_[: max(8, certain // 2)]
    noise = max(float(np.sqrt(np.mean(np.diff(head, 2) ** 2) / 6)), _LEAST_OF_STEP * _step_of(head), 1e-9 * reach)
    first = certain // _FIRST_LEVEL if cycle is None else certain - int(_LEAVING * cycle)
    away = np.abs(input_ - np.median(input_[: max(8, first)])) > _CLEARLY_AWAY * noise
    still = np.flatnonzero(~(away[:-2] | away[1:-1] | away[2:])[: max(certain - 2, 1)])
    left = int(still[-1]) + 3 if still.size else 0
    # From rest 1 − cos φ grows as φ²/2; noise hides it a little longer.
    unseen = 0.0 if cycle is None else 1.2 * cycle * np.sqrt(4 * _CLEARLY_AWAY * noise / reach) / (2 * np.pi)
    return max(0, left - back - int(unseen))


@dataclass(frozen=True)
class Start:
    """How a record begins.

    Parameters
    ----------
    samples : int
        Samples at the beginning that are rest, the reference of all levels; 1 where the test begins with the record: a film is taken to
        be at rest when its recording starts.
    quiet : list of slice
        Stretches in which the input rests, long enough to read noise off: before the test, else after its parts; empty where it never does.
    """

    samples: int
    quiet: tuple[slice, ...]

    @property
    def rests(self) -> bool:
        """Whether the record begins with rest that noise can be read off."""
        return bool(self.quiet) and self.quiet[0].start == 0


def find_start(rest: int, fewest: int, quiet_later: Iterable[tuple[int, int]]) -> Start:
    """How a record begins that has `rest` samples of rest first.

    Parameters
    ----------
    rest : int
        Samples before the input leaves its rest.
    fewest : int
        Least number of samples that noise can be read off.
    quiet_later : pairs of int
        First sample and stop of stretches in which the input rests again, used where there is too little rest before.
    """
    if rest >= fewest:
        return Start(rest, (slice(0, rest),))
    return Start(1, tuple(slice(a, b) for a, b in quiet_later if b - a >= fewest))


def white_sd(values: Float, quiet: Sequence[slice]) -> float:
    """Standard deviation of one sample's noise: of the quiet stretches, else from second differences of the whole."""
    parts = [values[s] - values[s].mean() for s in quiet]
    if parts:
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
    return float(np.median(np.abs(np.diff(values, 2))) / (np.sqrt(6) * _NORMAL_MEDIAN)) if values.size > 2 else 0.0


def _step_of(values: Float) -> float:
    """Least change between neighbours; 0 where there is none. Of what a converter recorded at rest, its step."""
    changes = np.abs(np.diff(values))
    return float(changes[changes > 0].min(initial=np.inf)) if changes.any() else 0.0


def find_converter_step(values: Float) -> float:
    """The step of which all changes between neighbours are multiples, (n,) samples as they were recorded, NaN where one was lost; 0 where
    there is no such step."""
    known = values[np.isfinite(values)]
    step = _step_of(known)
    if step <= _ARITHMETIC * float(np.abs(known).max(initial=0.0)):
        return 0.0
    steps = np.diff(known) / step
    return step if bool((np.abs(steps - np.rint(steps)) <= _WHOLE_STEPS).all()) else 0.0


def split_runs(values: Float) -> Int:
    """(runs + 1,) first samples of the runs of one value in (n,) samples, and n."""
    return np.concatenate([[0], np.flatnonzero(np.diff(values) != 0) + 1, [values.size]])


def bode_gain(frequency_hz: float, value: complex) -> Callable[[Float], Float]:
    """|G| near one frequency from its value there: the slope of log |G| is the phase over 90° (Bode)."""
    slope = float(np.clip(np.angle(value) / (np.pi / 2), -1.0, 1.0))
    size = abs(value)
    return lambda f: np.asarray(size * (np.maximum(f, 1e-3 * frequency_hz) / frequency_hz) ** slope)


def clamp_hz(rig: RigConstants) -> float:
    """Clamp-alone frequency as the rig file has it; 50 Hz where it does not."""
    prior = rig_prior(rig)
    if prior is None or prior.nominal[0] <= 0:
        return 50.0
    return float(prior.rig.clamp_omega / (2 * np.pi))


def ringing_s(rig: RigConstants, interval_s: float) -> float:
    """Time after an edge until the clamp's ringing has fallen to a hundredth where samples are too rare to follow it, s; else 0.

    What happens between samples decides how strongly the clamp rings after an edge.
    """
    prior = rig_prior(rig)
    if prior is None or prior.nominal[0] <= 0 or clamp_hz(rig) * interval_s < 1 / RULES.features.per_turn:
        return 0.0
    ratio = max(float(prior.rig.damping / prior.rig.critical_damping), prior.lightest_ratio)
    return float(np.log(100) / (ratio * prior.rig.clamp_omega))


def read_band(recording: Recording) -> tuple[float, float]:
    """Lowest and highest frequency in Hz that a sweep is stated to have. Raises `NotIdentifiableError` where one is missing."""
    low, high = recording.metadata.frequency_start_hz, recording.metadata.frequency_stop_hz
    if low is None or high is None:
        raise NotIdentifiableError(
            "frequency_start_hz or frequency_stop_hz is missing", where=recording.metadata.recording_id
        )
    return min(low, high), max(low, high)


def strain_length_mm(recording: Recording) -> float:
    """Length that strains refer to; 1 mm where the metadata do not say (strains are then mm)."""
    return recording.metadata.stretched_length_mm or 1.0


def polynomials(count: int, degree: int) -> Float:
    """Orthonormal polynomials (degree + 1, count)."""
    s = np.linspace(-1, 1, count)
    q, _ = np.linalg.qr(np.polynomial.legendre.legvander(s, degree))
    return np.ascontiguousarray(q.T)
