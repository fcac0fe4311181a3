"""Calibrations of a rig: a tap of the clamp gives its frequency and damping, known masses the gain of the force channel.

Each with its interval, and both sharpen the constants of the rig file for the recordings made after them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import stdtrit

from pipeline.physics.rig import TONNES_PER_KG, RigPrior, tied_by_frequency
from pipeline.transform import quality
from pipeline.transform.ringing import damped_sinusoid, rings
from pipeline.transform.sampling import runs, sample, seconds
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from schemas.numbers import pm, significant, with_unit
from schemas.recording import Recording

GRAVITY_M_PER_S2 = 9.80665
_SPAN = (2.0, 98.0)
"""Percentiles of the force between which all masses lie, but no knock on the cell."""
_STEP = 0.3
"""Change of the force over that of the smallest mass, had all been hung together, from which it is moving."""
_FEWEST_PLATEAU_SAMPLES = 10
_REPEATABILITY = 5e-4
"""Relative: how well the clamp's frequency repeats when a film is mounted, whose own mass moves with the clamp."""


@dataclass(frozen=True)
class TapCalibration:
    """Clamp without film. `frequency_hz` is the undamped one, √(kL/M)/2π; standard deviations beside the values. `expected_hz` is
    that of the rig's file, NaN where it gives none."""

    frequency_hz: float
    frequency_sd: float
    damping_ratio: float
    damping_ratio_sd: float
    taps: int
    recording_id: str | None = None
    warnings: tuple[str, ...] = ()
    extra_mass_kg: float = 0.0
    """What was on the clamp beside its own mass."""
    expected_hz: float = float("nan")

    @property
    def contradicts_file(self) -> bool:
        """Whether something else rings than what the rig's file describes: constants may be wrong by a fifth, which is what a tap is for."""
        return np.isfinite(self.expected_hz) and not 2 / 3 < self.frequency_hz / self.expected_hz < 1.5


@dataclass(frozen=True)
class WeightCalibration:
    """Recorded force = `gain` × true force + `offset_n`. Standard deviations beside the values, 95 % limits of the gain."""

    gain: float
    gain_sd: float
    offset_n: float
    offset_sd: float
    gain_interval: tuple[float, float]
    plateaus: int
    recording_id: str | None = None
    warnings: tuple[str, ...] = ()


Calibration = TapCalibration | WeightCalibration


def calibrate(recording: Recording) -> Calibration:
    """Result of a `tap` or `weight` recording. Raises `NotIdentifiableError` where the record carries none."""
    return tap(recording) if recording.metadata.protocol == "tap" else weigh(recording)


def tap(recording: Recording) -> TapCalibration:
    """Frequency and damping of the ringing clamp, as `read_ring`.

    Raises `NotIdentifiableError` when nothing rings for at least five cycles, or something else than the rig's file describes.
    """
    found = read_ring(recording)
    if found.contradicts_file:
        raise NotIdentifiableError(
            describe_contradiction(found.frequency_hz, found.expected_hz),
            where=recording.metadata.recording_id,
            expected="the clamp without film",
            remedy="Check clamp_mass_kg (kg, not g) and load_cell_stiffness_n_per_mm, and what was tapped",
        )
    return found


def describe_contradiction(frequency_hz: float, expected_hz: float) -> str:
    """That something else rings than what the rig's file describes."""
    return f"what rings is at {frequency_hz:.4g} Hz, far from the {expected_hz:.4g} Hz of the clamp that the rig file describes"


def read_ring(recording: Recording) -> TapCalibration:
    """What rings after taps, whatever the rig's file says: a damped sinusoid per tap, fitted until it drowns in noise.

    Several taps are averaged; where they differ by more than their noise says, the scatter between them counts. Raises
    `NotIdentifiableError` when nothing rings for at least five cycles.
    """
    where = recording.metadata.recording_id
    channel = recording.channels["force"]
    sampled = sample({"force": channel}, recording.start_ns)
    force, interval = sampled.values["force"], sampled.interval_s
    extra_kg = recording.metadata.extra_clamp_mass_kg or 0.0
    rig = recording.rig.loaded(extra_kg)
    _refuse_slow_samples(rig, interval, where)
    clipped = quality.overloaded(replace(channel, values=force), rig.load_cell_range_n)
    fits, warnings = [], []
    for first, stop in runs(np.isfinite(force)):
        for a, b in rings(force[first:stop], where):
            start = first + a
            late = np.flatnonzero(clipped[start : first + b])
            begin = start + (int(late[-1]) + 1 if late.size else 0)
            fitted = damped_sinusoid(force[begin : first + b], interval)
            if fitted is not None:
                fits.append(fitted)
            if late.size:
                warnings.append("a tap overloaded the load cell; its ringing is used from where it is within the range")
    if not fits:
        raise NotIdentifiableError(
            "no tap rings for five cycles above the noise",
            where=where,
            expected="the clamp without film, tapped and left to ring",
            remedy="Tap harder, remove the film, sample faster than ten times the clamp's frequency",
        )
    f, f_sd = _pooled(np.array([x[0] for x in fits]), np.array([x[1] for x in fits]))
    expected, sd = _stated_frequency(rig) or (float("nan"), float("nan"))
    if abs(f - expected) > 3 * sd:
        warnings.append(
            f"the clamp rings at {with_unit(significant(f, 4), 'Hz')}, the rig file expects {pm(expected, sd, 'Hz')}"
        )
    z, z_sd = _pooled(np.array([x[2] for x in fits]), np.array([x[3] for x in fits]))
    return TapCalibration(f, f_sd, z, z_sd, len(fits), where, tuple(dict.fromkeys(warnings)), extra_kg, expected)


def _pooled(values: Float, errors: Float) -> tuple[float, float]:
    """Weighted mean and its standard deviation, with the scatter beyond the errors (DerSimonian and Laird)."""
    errors = np.maximum(errors, 1e-9 * np.abs(values) + np.finfo(float).tiny)
    w = 1 / errors**2
    mean = float((w * values).sum() / w.sum())
    if values.size > 1:
        q = float((w * (values - mean) ** 2).sum())
        between = max(0.0, (q - (values.size - 1)) / float(w.sum() - (w**2).sum() / w.sum()))
        w = 1 / (errors**2 + between)
        mean = float((w * values).sum() / w.sum())
    return mean, float(1 / np.sqrt(w.sum()))


def _refuse_slow_samples(rig: RigConstants, interval_s: float, where: str) -> None:
    """A clamp that rings faster than the samples show would appear at another frequency."""
    stated = _stated_frequency(rig)
    if stated is not None and stated[0] > 0.4 / interval_s:
        raise NotIdentifiableError(
            f"the clamp should ring at {stated[0]:.4g} Hz, beyond what {1 / interval_s:.4g} samples per second show",
            where=where,
            expected=f"at least {stated[0] / 0.4:.4g} samples per second",
        )


def _stated_frequency(rig: RigConstants) -> tuple[float, float] | None:
    """Clamp-alone frequency of the rig file and its standard deviation."""
    if rig.clamp_mass_kg is None or rig.load_cell_stiffness_n_per_mm is None or rig.clamp_mass_kg == 0:
        return None
    prior = RigPrior.of(rig)
    frequency = float(prior.rig.clamp_omega) / (2 * np.pi)
    return frequency, 0.5 * float(np.hypot(*prior.sd[:2] / prior.nominal[:2])) * frequency


def weigh(recording: Recording) -> WeightCalibration:
    """Gain and offset of the force channel from plateaus under `masses_kg`, in the order they were hung.

    The plateaus may include unloaded ones, and the masses may add up: the reading that fits by far best is taken. Raises
    `NotIdentifiableError` when masses are missing or plateaus and masses do not go together.
    """
    where = recording.metadata.recording_id
    masses = recording.metadata.masses_kg
    if not masses:
        raise NotIdentifiableError("masses_kg is missing", where=where, expected="the masses that were hung, in kg")
    _, force = seconds(recording.channels["force"], recording.start_ns)
    warnings: list[str] = []
    bad = quality.overloaded(recording.channels["force"], recording.rig.load_cell_range_n)
    if bad.any():
        warnings.append("the load cell was overloaded under some of the masses")
    levels, errors = _plateaus(force, min(m for m in masses if m > 0) / sum(masses), where)
    fitted = _best_reading(levels, errors, np.array(masses) * GRAVITY_M_PER_S2, where)
    gain, offset, covariance, freedom, cumulative = fitted
    if cumulative:
        warnings.append("the masses were read as added to each other")
    if gain < 0:
        raise NotIdentifiableError(
            f"the force falls when masses are hung (gain {gain:.3g})", where=where, expected="tension positive"
        )
    limit = float(stdtrit(freedom, 0.975)) if freedom > 0 else float("inf")
    sd = float(np.sqrt(covariance[0, 0]))
    return WeightCalibration(
        gain=gain,
        gain_sd=sd,
        offset_n=offset,
        offset_sd=float(np.sqrt(covariance[1, 1])),
        gain_interval=(gain - limit * sd, gain + limit * sd),
        plateaus=levels.size,
        recording_id=where,
        warnings=tuple(warnings),
    )


def _plateaus(force: Float, smallest: float, where: str) -> tuple[Float, Float]:
    """Means of the steady parts and their standard errors, in the unit of the force, whichever that is.

    Parameters
    ----------
    force : (N,) samples
    smallest : the smallest mass over the sum of all
    where : the recording, for errors
    """
    n = force.size
    if n < 4 * _FEWEST_PLATEAU_SAMPLES:
        raise NotIdentifiableError(f"{n} samples of force", where=where, expected="plateaus under each mass")
    block = max(1, n // 2000)
    means = force[: n // block * block].reshape(-1, block).mean(axis=1)
    width = max(3, means.size // 200) | 1
    smooth = median_filter(means, size=width, mode="nearest")
    # Steady: the smooth force changes by little over a few blocks.
    ahead = np.abs(smooth[2 * width :] - smooth[: -2 * width])
    moving = np.zeros(means.size, dtype=bool)
    low, high = np.percentile(smooth, _SPAN)
    moving[width:-width] = ahead > _STEP * smallest * (high - low)
    levels, errors = [], []
    for a, b in runs(~moving):
        # The first third may still swing.
        a, b = a + (b - a) // 3, b - max(1, (b - a) // 20)
        part = means[a:b]
        if part.size * block < _FEWEST_PLATEAU_SAMPLES or part.size < 4:
            continue
        levels.append(float(part.mean()))
        pieces = np.array_split(part, 4)
        scatter = np.std([p.mean() for p in pieces], ddof=1) / 2
        errors.append(float(max(scatter, part.std() / np.sqrt(part.size))))
    if len(levels) < 2:
        raise NotIdentifiableError(
            f"{len(levels)} steady levels of force", where=where, expected="one per mass, and an unloaded one"
        )
    return np.array(levels), np.array(errors)


def _best_reading(levels: Float, errors: Float, loads: Float, where: str) -> tuple[float, float, Float, int, bool]:
    """Line through the plateaus for the reading of the masses that fits best: (gain, offset, covariance, ν, added up)."""
    candidates = []
    # Equal masses hung one after the other without a pause are one level.
    changed = np.concatenate([[True], np.diff(loads) != 0])
    for hung, cumulative in ((loads, False), (loads[changed], False), (np.cumsum(loads), True)):
        for reading in _readings(hung, levels.size):
            if np.ptp(reading) == 0:
                continue
            design = np.column_stack([reading, np.ones_like(reading)])
            solution, *_ = np.linalg.lstsq(design, levels, rcond=None)
            residual = levels - design @ solution
            candidates.append((float(residual @ residual), cumulative, design, solution))
    if not candidates:
        raise NotIdentifiableError(
            f"{levels.size} steady levels do not go with {loads.size} masses",
            where=where,
            expected=f"{loads.size} levels, with or without unloaded ones before, between and after",
        )
    # Masses one by one unless adding them up fits far better.
    candidates.sort(key=lambda c: c[0] * (9.0 if c[1] else 1.0))
    cost, cumulative, design, solution = candidates[0]
    freedom = levels.size - 2
    variance = max(cost / freedom if freedom > 0 else 0.0, float(np.mean(errors**2)), np.finfo(float).tiny)
    span = float(np.ptp(levels))
    if np.sqrt(cost / levels.size) > 0.05 * span:
        raise NotIdentifiableError(
            f"the levels of force miss a straight line through the masses by {np.sqrt(cost / levels.size):.2g} N",
            where=where,
            expected="levels proportional to the masses in their order",
        )
    return float(solution[0]), float(solution[1]), variance * np.linalg.inv(design.T @ design), freedom, cumulative


def _readings(loads: Float, count: int) -> list[Float]:
    """Loads on `count` plateaus: masses in order, unloaded before, after, both, or between each two."""
    between = np.zeros(2 * loads.size + 1)
    between[1::2] = loads
    shapes = (
        loads,
        np.concatenate([[0.0], loads]),
        np.concatenate([loads, [0.0]]),
        np.concatenate([[0.0], loads, [0.0]]),
        np.concatenate([[0.0], loads, loads[-2::-1], [0.0]]),
        between,
        between[:-1],
        between[1:],
    )
    return [s for s in shapes if s.size == count]


def sharpen(rig: RigConstants, calibration: Calibration) -> RigConstants:
    """The rig's constants with a calibration taken into account: prior and measurement by their inverse variances.

    A tap measures √(kL/M), so that mass and stiffness each move a little and are tied together (`clamp_frequency_hz` keeps
    the tie); its damping replaces a prior that is usually wide. Weights set `force_gain`. A rig without mass or stiffness
    keeps the measured frequency and nothing else. A tap with a further mass on the clamp is no measure of the clamp alone: what it says
    of mass and stiffness is for the diagnosis to say.
    """
    if isinstance(calibration, WeightCalibration):
        gain, sd = calibration.gain, calibration.gain_sd
        if rig.force_gain is not None and rig.force_gain_sd:
            gain, sd = _pooled(np.array([rig.force_gain, gain]), np.array([rig.force_gain_sd, sd]))
        return replace(rig, force_gain=gain, force_gain_sd=sd)
    if calibration.extra_mass_kg:
        return rig
    frequency = calibration.frequency_hz
    frequency_sd = float(np.hypot(calibration.frequency_sd, _REPEATABILITY * frequency))
    tied = replace(rig, clamp_frequency_hz=frequency, clamp_frequency_hz_sd=frequency_sd)
    if rig.clamp_mass_kg is None or rig.load_cell_stiffness_n_per_mm is None or rig.clamp_mass_kg == 0:
        return tied
    prior = RigPrior.of(replace(rig, clamp_frequency_hz=None, clamp_frequency_hz_sd=None))
    (mass, stiffness), (mass_sd, stiffness_sd) = prior.nominal[:2].tolist(), prior.sd[:2].tolist()
    mass, stiffness, covariance = tied_by_frequency(mass, stiffness, mass_sd, stiffness_sd, frequency, frequency_sd)
    mass_sd, stiffness_sd = np.sqrt(np.diag(covariance))
    damping = 2 * calibration.damping_ratio * float(np.sqrt(stiffness * mass))
    relative = calibration.damping_ratio_sd / max(calibration.damping_ratio, 1e-12)
    damping_sd = damping * float(np.hypot(relative, np.hypot(mass_sd / mass, stiffness_sd / stiffness) / 2))
    if rig.load_cell_damping_n_s_per_mm is not None and rig.load_cell_damping_n_s_per_mm_sd:
        damping, damping_sd = _weighted(
            rig.load_cell_damping_n_s_per_mm, rig.load_cell_damping_n_s_per_mm_sd, damping, damping_sd
        )
    return replace(
        tied,
        clamp_mass_kg=mass / TONNES_PER_KG,
        clamp_mass_kg_sd=float(mass_sd) / TONNES_PER_KG,
        load_cell_stiffness_n_per_mm=stiffness,
        load_cell_stiffness_n_per_mm_sd=float(stiffness_sd),
        load_cell_damping_n_s_per_mm=damping,
        load_cell_damping_n_s_per_mm_sd=damping_sd,
    )


def _weighted(a: float, a_sd: float, b: float, b_sd: float) -> tuple[float, float]:
    """Mean of two independent values by inverse variance, and its standard deviation."""
    wa, wb = 1 / a_sd**2, 1 / max(b_sd, 1e-12 * abs(b) + np.finfo(float).tiny) ** 2
    return (a * wa + b * wb) / (wa + wb), float(1 / np.sqrt(wa + wb))
