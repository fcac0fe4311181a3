"""The force, or the way of a load, under a voltage that goes up and down slowly: its drop over the squared voltage, rest and drift beside it.

    F(t) = F0 + d t − c V²        and, to see whether it is the square, F0 + d t − c V^p

Of a displacement F stands for the way, in mm. The monitor's reading before the voltage first rises is its zero, where it is still there.

Belongs here: one record of triangles or slow sinusoids. Does not belong here: steps (`pipeline.transform.step`), responses over frequency
(`pipeline.transform.sphs`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.optimize import minimize_scalar
from scipy.signal import find_peaks

from pipeline.transform.sampling import seconds
from schemas.arrays import Bool, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording

_FEWEST = 20
"""Samples of a record, from which three numbers and their spread can be told."""
_PROMINENCE = 0.5
"""Share of the largest voltage by which a top stands out: less is noise, or a pause on the way."""
_CLEARLY, _PER_DIFFERENCE = 10.0, 1.4826 / math.sqrt(2)
"""Standard deviations of its noise that a voltage has to reach, and of one sample for the median difference of neighbours. A voltage that is
sampled ten times on its way up moves no more than a tenth of its peak from sample to sample."""
_FOLLOWS = 1e-3
"""Probability that a force which does not depend on the voltage gives what is seen, above which nothing is said of its power."""
_POWERS = 0.5, 4.0
_REST, _OFF, _SURE = 0.02, 0.05, 4.0
"""Share of a record that is looked at for a rest at its beginning, share of the peak below which a voltage is off, and standard errors from
which its reading there is a zero that is off."""
_NEAR = 0.9
"""Share of the peak from which samples tell what is measured there."""
_SQUARE = 0.1
"""Distance of the power of V from 2 beyond which the force is not proportional to V²: a film that softens or yields, or an offset of a
monitor of some per cent of the range."""


@dataclass(frozen=True)
class SlowVoltage:
    """What one record tells.

    Parameters
    ----------
    peak_kv : largest voltage as recorded, `cycles` how often it was reached
    drop_n_per_kv2 : drop of the force over V², positive where the tension falls; `lower`, `upper` its 95 % limits by the scatter from cycle
        to cycle, NaN for one cycle
    exponent : power of the voltage that the force follows, NaN where it does not follow it beyond its noise
    rest_n, drift_n_per_min : force without voltage at the start of the record, and its drift
    misfit_n : root mean square of what is left
    rising, falling : drop over V² on the way up and on the way down alone; they differ where the film follows slowly
    positive, negative : drop over V² under voltages of one sign alone; NaN where there are none
    top_kv : largest voltage without the noise of its samples
    peak_drop : drop at `top_kv` as measured around it, whatever its law; `peak_drop_sd` by the scatter from cycle to cycle
    time_s, voltage_kv, force_n, modelled_n : (n,) samples of the voltage that were used, s since the start of the recording
    """

    peak_kv: float
    cycles: int
    drop_n_per_kv2: float
    lower: float
    upper: float
    exponent: float
    rest_n: float
    drift_n_per_min: float
    misfit_n: float
    time_s: Float
    voltage_kv: Float
    force_n: Float
    modelled_n: Float
    rising: float
    falling: float
    positive: float
    negative: float
    top_kv: float
    peak_drop: float
    peak_drop_sd: float
    warnings: tuple[str, ...] = ()


def measure_slow_voltage(recording: Recording, answer: str = "force") -> SlowVoltage:
    """Drop of a channel, force or displacement, over squared voltage.

    Raises `NotIdentifiableError` where the voltage does not change, or nothing is measured with it.
    """
    where = recording.metadata.recording_id
    time, voltage = seconds(recording.channels["voltage"], recording.start_ns)
    force_time, force = seconds(recording.channels[answer], recording.start_ns)
    seen = np.isfinite(force)
    if seen.sum() < _FEWEST:
        raise NotIdentifiableError(
            f"{int(seen.sum())} samples of {answer}", where=where, expected=f"at least {_FEWEST}"
        )
    force = np.interp(time, force_time[seen], force[seen], left=np.nan, right=np.nan)
    good = np.isfinite(voltage) & np.isfinite(force)
    time, voltage, force = time[good], voltage[good], force[good]
    zero = _find_zero(voltage)
    voltage = voltage - zero
    size = np.abs(voltage)
    peak = float(np.quantile(size, 0.999)) if size.size else 0.0
    noise = float(np.median(np.abs(np.diff(voltage)))) * _PER_DIFFERENCE if voltage.size > 1 else 0.0
    if size.size < _FEWEST or float(np.ptp(voltage)) < _PROMINENCE * peak or peak <= _CLEARLY * noise:
        raise NotIdentifiableError(
            f"the voltage does not go up and down where the {answer} is recorded",
            where=where,
            expected="a voltage that goes from near 0 to its peak and back, at least once",
        )
    values, modelled = _fit(time, size**2, force)
    exponent = _find_power(time, size / peak, force)
    parts = _cycles(size, peak)
    each = np.array([-_fit(time[part], size[part] ** 2, force[part])[0][2] for part in parts])
    spread = math.nan
    if each.size > 1:
        spread = float(stats.t.ppf(0.975, each.size - 1) * each.std(ddof=1) / math.sqrt(each.size))
    warnings = []
    if not _follows(time, size / peak, force, exponent):
        exponent = math.nan
        warnings.append(f"the {answer} does not follow the voltage beyond its noise: no power of the voltage is told")
    elif abs(exponent - 2) > _SQUARE:
        warnings.append(f"the {answer} goes with the power {exponent:.3g} of the voltage, not with its square")
    if zero:
        warnings.append(f"the voltage's channel reads {zero:.3g} kV before the voltage rises: taken off as its zero")
    drop = -float(values[2])
    up, down = _branches(size, peak)
    top = float(_smoothed(size).max())
    moved = force - values[0] - values[1] * time
    peaks = [-_at_peak(size[part], moved[part], top) for part in parts]
    return SlowVoltage(
        peak_kv=peak,
        cycles=len(parts),
        drop_n_per_kv2=drop,
        lower=drop - spread,
        upper=drop + spread,
        exponent=exponent,
        rest_n=float(values[0]),
        drift_n_per_min=60 * float(values[1]),
        misfit_n=float(np.sqrt(np.mean((force - modelled) ** 2))),
        time_s=time,
        voltage_kv=voltage,
        force_n=force,
        modelled_n=modelled,
        rising=_drop_of(up, size, moved),
        falling=_drop_of(down, size, moved),
        positive=_drop_of(voltage >= 0, size, moved) if (voltage < -_PROMINENCE * peak).any() else math.nan,
        negative=_drop_of(voltage <= 0, size, moved) if (voltage < -_PROMINENCE * peak).any() else math.nan,
        top_kv=top,
        peak_drop=float(np.mean(peaks)) if peaks else math.nan,
        peak_drop_sd=float(np.std(peaks, ddof=1) / math.sqrt(len(peaks))) if len(peaks) > 1 else math.nan,
        warnings=tuple(warnings),
    )


def _find_zero(voltage: Float) -> float:
    """What the channel of the voltage reads before it first rises; 0 where the record begins with the rise, or nothing is off."""
    peak = float(np.max(np.abs(voltage))) if voltage.size else 0.0
    rest = voltage[: max(int(voltage.size * _REST), 1)]
    if rest.size < _FEWEST or np.max(np.abs(rest)) > _OFF * peak:
        return 0.0
    half = rest.size // 2
    noise = float(np.std(rest))
    error = noise / math.sqrt(rest.size)
    moves = abs(float(rest[half:].mean() - rest[:half].mean()))
    level = float(rest.mean())
    return level if moves < _SURE * 2 * error and abs(level) > _SURE * error else 0.0


def _smoothed(size: Float) -> Float:
    """(n,) means over a four hundredth of the record, of whole records and of their ends alike."""
    width = max(1, size.size // 800)
    return np.asarray(np.convolve(np.pad(size, width, "edge"), np.ones(2 * width + 1) / (2 * width + 1), "valid"))


def _branches(size: Float, peak: float) -> tuple[Bool, Bool]:
    """(n,) samples on the way up and on the way down."""
    smooth = _smoothed(size)
    slope = np.gradient(smooth)
    moves = np.abs(slope) > 0.2 * np.quantile(np.abs(slope), 0.9)
    return moves & (slope > 0) & (size > _OFF * peak), moves & (slope < 0) & (size > _OFF * peak)


def _drop_of(part: Bool, size: Float, moved: Float) -> float:
    """Drop over V² of some samples alone, from the rest and the drift of the whole record; NaN for few."""
    square = size[part] ** 2
    return -float(np.dot(square, moved[part]) / np.dot(square, square)) if part.sum() >= _FEWEST else math.nan


def _at_peak(size: Float, moved: Float, peak: float) -> float:
    """What is measured at the largest voltage, by a straight line over V² near it; NaN for few samples."""
    near = size > _NEAR * peak
    if near.sum() < _FEWEST // 4:
        return math.nan
    slope, at_zero = np.polyfit(size[near] ** 2, moved[near], 1)
    return float(at_zero + slope * peak**2)


def _fit(time: Float, drive: Float, force: Float) -> tuple[Float, Float]:
    """Force at time 0, its drift per s and its change per unit of the drive; and the force by them."""
    columns = np.column_stack([np.ones_like(time), time, drive])
    values: Float = np.asarray(np.linalg.lstsq(columns, force, rcond=None)[0], dtype=np.float64)
    return values, np.asarray(columns @ values, dtype=np.float64)


def _find_power(time: Float, size: Float, force: Float) -> float:
    def misfit(power: float) -> float:
        return float(np.sum((force - _fit(time, size**power, force)[1]) ** 2))

    return float(minimize_scalar(misfit, bounds=_POWERS, method="bounded", options={"xatol": 1e-4}).x)


def _follows(time: Float, size: Float, force: Float, power: float) -> bool:
    """Whether the force depends on the voltage (n,) over its peak, by an F test for the amount and the power of a dependence."""
    still = float(np.sum((force - _fit(time, np.zeros_like(size), force)[1]) ** 2))
    left = float(np.sum((force - _fit(time, size**power, force)[1]) ** 2))
    freedom = size.size - 4
    if left <= np.finfo(float).eps * still or freedom < 1:
        return still > 0
    return bool(stats.f.sf((still - left) / 2 / (left / freedom), 2, freedom) < _FOLLOWS)


def _cycles(size: Float, peak: float) -> list[slice]:
    """Samples of each cycle, from one lowest voltage to the next; rests before and after belong to the outer ones."""
    width = max(1, size.size // 2000)
    smooth = np.convolve(np.pad(size, width, "edge"), np.ones(2 * width + 1) / (2 * width + 1), "valid")
    tops: Int = find_peaks(np.pad(smooth, 1), prominence=_PROMINENCE * peak)[0] - 1
    between = [int(a + np.argmin(smooth[a:b])) for a, b in itertools.pairwise(tops)]
    low = [place for place in between if smooth[place] < (1 - _PROMINENCE) * peak]  # tops of equal height are one
    ends = [0, *low, size.size]
    return [slice(a, b) for a, b in itertools.pairwise(ends) if b - a >= _FEWEST]
