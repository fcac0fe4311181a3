"""A film under a load that is put on, held and taken off: compliance, retardation, and how much of the creep comes back.

Terms as in ISO 899 and Tschoegl (1989): creep is what the displacement goes on by while the load is held, recovery what it goes back by
after the load is off. The recovered share is that of all displacement that the film has shown at the end of the load.

What is left after the recovery is read off the record, not off the model: a film of springs and dampers always comes back. Its interval
knows the noise and the wander of the displacement, and holds both readings of a constant drift: that there is none, and that it is what
the fit takes for one. A slow recovery and a drift look alike, and no record tells them apart for certain.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipeline.fit.retardation.fit import RESOLVED, Retardation, RetardationFit, fit_retardation
from pipeline.physics.compliance import Compliance
from pipeline.physics.film import RelaxationModel
from pipeline.transform.channels import drive
from pipeline.transform.holds import FEWEST_WINDOWS, Hold, find_holds, reduce_record
from pipeline.transform.sampling import seconds
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording

NOT_AT_ONCE = "what the film gives way by at once is not resolved: all that is seen comes later than the first window"
_NORMAL = 1.959964
_TAKEN_OFF = 0.5
"""Share of the load that is still on, below which it counts as taken off."""
_ALIKE = 0.05
"""Share of the load within which two levels are one, and the load is the one that the metadata tell."""
_TARED = 0.05
"""Share of the load by which the load cell of a film at rest may be off zero without a word."""
_DIFFERENCE = 1e-4
_NOT_SOFTER = 0.95
"""Share of a film's compliance that the load cell may make up."""


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval."""

    value: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Creep:
    """What one test tells. Displacements in mm, loads in N, of the film with the load cell in series.

    Parameters
    ----------
    retardation : all orders, of the film with the load cell in series
    load_n : change of the load to its first level, with its standard deviation
    hold_s, recovery_s : how long it was on and off; None where it was not taken off
    elastic_mm, end_mm : displacement at once (None where it is not resolved), and at the end of the load
    left_mm : what was left at the end of the record; None without recovery
    recovered_share : of `end_mm`; None without recovery
    drift_mm_per_h : constant drift of the displacement; None where it cannot be told from creep
    walk_mm_per_sqrt_h : wander of the displacement, standard deviation after an hour
    cell_mm_per_n : compliance of the load cell that is in the displacement; 0 where no rig is known
    length_mm : length of the film that strains refer to; None where unknown
    """

    retardation: Retardation
    load_n: float
    load_n_sd: float
    hold_s: float
    recovery_s: float | None
    elastic_mm: Estimate | None
    end_mm: Estimate
    left_mm: Estimate | None
    recovered_share: Estimate | None
    drift_mm_per_h: Estimate | None
    walk_mm_per_sqrt_h: float
    cell_mm_per_n: float
    length_mm: float | None
    warnings: tuple[str, ...] = ()

    def instant(self, fit: RetardationFit) -> float | None:
        """Compliance of the film alone at once, mm/N; None where the record does not resolve it."""
        left = fit.compliance.instant - self.cell_mm_per_n
        return left if left > 0 else None

    def solid(self, fit: RetardationFit) -> RelaxationModel | None:
        """The Maxwell-Wiechert model of the film alone, N/mm and s; None where its compliance at once is not resolved."""
        return None if self.instant(fit) is None else fit.compliance.stiffer_by(self.cell_mm_per_n).solid()

    def solid_sd(self, fit: RetardationFit) -> tuple[float | None, tuple[float | None, ...], tuple[float | None, ...]]:
        """Standard deviations of k0, of the springs and of the relaxation times; None where one is not resolved."""
        model = self.solid(fit)
        if model is None:
            return None, (), ()

        def numbers(parameters: Float) -> Float:
            near = fit.with_parameters(parameters).compliance.stiffer_by(self.cell_mm_per_n)
            if not near.is_real:
                return np.full(1 + 2 * len(model.k), np.nan)
            other = near.solid()
            return np.log(np.maximum([other.k0, *other.k, *other.tau], 1e-300))

        sd = _propagate(numbers, fit)
        values = np.array([model.k0, *model.k, *model.tau])
        shown = [float(v * s) if s <= RESOLVED else None for v, s in zip(values, sd, strict=True)]
        arms = len(model.k)
        return (shown[0] if model.k0 > 0 else None), tuple(shown[1 : 1 + arms]), tuple(shown[1 + arms :])


def measure_creep(recording: Recording) -> Creep:
    """Compliance, retardation and recovery of one test.

    Raises `NotIdentifiableError` where the load is held nowhere, or for too short a time.
    """
    source, about = drive(recording), recording.metadata
    where = about.recording_id
    x_s, x = seconds(source.input, recording.start_ns)
    f_s, force = seconds(source.output, recording.start_ns)
    holds = find_holds(f_s, force, where=where)
    rests = _begins_at_rest(holds)
    zero = holds[0].level if rests else 0.0
    record = reduce_record(
        f_s, force, x_s, x, holds, rests=rests, step=(source.input.resolution or 0.0) / math.sqrt(12), where=where
    )
    held, *later = _from_load_on(record.holds, zero, where)
    change = held.level - zero
    while later and abs(later[0].level - held.level) <= _ALIKE * abs(change):
        held = replace(held, end_s=later.pop(0).end_s)
    goes_on = bool(later) and not _is_off(later[0], held, zero)
    off = None if goes_on or not later else later[0]
    recovers = off is not None and int(np.sum(record.hold == record.holds.index(off))) >= FEWEST_WINDOWS
    goes_off = recovers or (goes_on and any(_is_off(h, held, zero) for h in later))
    found = fit_retardation(record, drifts=goes_off)
    fit = found.selected
    warnings = [*fit.warnings, *record.warnings]
    if rests and abs(zero) > _TARED * abs(change):
        warnings.append(f"the load cell reads {zero:.3g} N before the load: that is taken for its zero")
    if goes_on:
        warnings.append(
            f"the load goes on from {change:.3g} to {later[0].level - zero:.3g} N without being taken off: displacement and "
            "compliance are those of the first level, retardation times those of all levels, and no recovery is told"
        )
    if "force" in recording.channels:
        warnings += contradict_load(about.load_n, [h.level - zero for h in holds])
    if not rests:
        warnings.append(
            "the record begins with the load on: the displacement is taken to count from before it, and the load to come with the first sample"
        )
    if not goes_off:
        warnings.append(
            "the load is not taken off, or not for long: a drift of the displacement cannot be told from creep, and counts as creep"
        )
    cell = _cell_compliance(recording, fit.compliance.instant, warnings)
    end = held.end_s if off is None else min(off.begins_s, record.end_s)
    drift, drift_sd = fit.drift
    elastic = None
    if fit.compliance.instant > 0:
        elastic = _estimate(lambda p: found.sign * change * fit.with_parameters(p).compliance.instant, fit)
    else:
        warnings.append(NOT_AT_ONCE)
    last = holds[-1].end_s if off is None else off.end_s
    read = _Reading(found, end, last if recovers else None)
    per_hour = 3600 * found.sign
    return Creep(
        retardation=found,
        load_n=change,
        load_n_sd=abs(change) * record.drive_error,
        hold_s=end - held.begins_s,
        recovery_s=None if off is None else last - off.begins_s,
        elastic_mm=elastic,
        end_mm=read.of(lambda moved, left: moved),
        left_mm=read.of(lambda moved, left: left) if recovers else None,
        recovered_share=read.of(lambda moved, left: 1 - left / moved) if recovers else None,
        drift_mm_per_h=bounds(per_hour * drift, 3600 * drift_sd) if goes_off else None,
        walk_mm_per_sqrt_h=math.sqrt(3600 * found.noise.walk),
        cell_mm_per_n=cell,
        length_mm=about.stretched_length_mm,
        warnings=tuple(warnings),
    )


class _Reading:
    """Displacements at the end of the load and of the record, against the rest before, as read off the windows there."""

    def __init__(self, found: Retardation, end_s: float, last_s: float | None) -> None:
        record, fit = found.record, found.selected
        weights = np.zeros((2, record.time_s.size))
        since = np.zeros(2)
        nearer = np.zeros(2)
        for i, instant in enumerate((end_s, end_s if last_s is None else last_s)):
            row = int(np.flatnonzero(record.usable & (record.time_s <= instant))[-1])
            weights[i, row] = 1.0
            since[i] = record.time_s[row]
            nearer[i] = film_at(found, fit.compliance, instant) - float(
                (record.mean[row] @ fit.compliance.response(record.history_s, record.drive))[0]
            )
        covariance = found.noise.covariance(record)
        if record.rests:
            rest = np.flatnonzero(record.hold == 0)
            own = np.linalg.solve(covariance[np.ix_(rest, rest)], np.ones(rest.size))
            weights[:, rest] -= own / own.sum()
            since -= float(own @ record.time_s[rest]) / float(own.sum())
        else:
            since -= record.history_s[0]
        self.values = weights @ record.displacement + found.sign * nearer
        self.covariance = weights @ covariance @ weights.T
        if record.offset and not record.rests:
            self.values -= found.sign * fit.parameters[0]
            self.covariance += fit.covariance[0, 0]
        drift, sd = fit.drift
        self.drift, self.drift_sd, self.since = found.sign * drift, sd, since

    def of(self, function: Callable[[float, float], float]) -> Estimate:
        """A number made of both displacements; its interval holds those without drift and with the drift of the fit."""
        without = self._bounds(function, self.values, self.covariance)
        corrected = self._bounds(
            function,
            self.values - self.drift * self.since,
            self.covariance + self.drift_sd**2 * np.outer(self.since, self.since),
        )
        return Estimate(without.value, min(without.lower, corrected.lower), max(without.upper, corrected.upper))

    @staticmethod
    def _bounds(function: Callable[[float, float], float], at: Float, covariance: Float) -> Estimate:
        step = _DIFFERENCE * max(float(np.abs(at).max()), 1e-300)
        slopes = np.array(
            [(function(*(at + step * unit)) - function(*(at - step * unit))) / (2 * step) for unit in np.eye(2)]
        )
        return bounds(function(*at), math.sqrt(max(float(slopes @ covariance @ slopes), 0.0)))


def film_at(found: Retardation, film: Compliance, time_s: float) -> float:
    """Displacement of a film at an instant of the record, offset and drift left out; along the drive it is positive."""
    record = found.record
    place = int(np.searchsorted(record.history_s, time_s, side="right"))
    return float(film.response(record.history_s[:place], record.drive[:place])[-1])


def _begins_at_rest(holds: tuple[Hold, ...]) -> bool:
    """Whether the first level is a rest: the drive comes back to it at the end, or else none is nearer to zero.

    The load cell may read anything at rest: a change that is put on and undone tells the rest, not the sign or the size of a level.
    """
    levels = np.array([hold.level for hold in holds])
    largest = float(np.abs(levels - levels[0]).max())
    comes_back = levels.size > 2 and abs(levels[-1] - levels[0]) < _TAKEN_OFF * largest
    return levels.size > 1 and (comes_back or bool(np.argmin(np.abs(levels)) == 0))


def _from_load_on(holds: tuple[Hold, ...], zero: float, where: str) -> tuple[Hold, ...]:
    """The holds from the first on in which the load is on."""
    largest = max(abs(hold.level - zero) for hold in holds)
    on = [i for i, hold in enumerate(holds) if abs(hold.level - zero) > _ALIKE * largest]
    if not on or largest == 0:
        raise NotIdentifiableError(
            "the displacement has no sample while the load is on",
            where=where,
            expected="both channels over the whole test",
        )
    return holds[on[0] :]


def contradict_load(told: float | None, seen: list[float]) -> list[str]:
    """What there is to say where the load that the metadata tell, in N, is none of those that the force channel shows."""
    if told is None:
        return []
    nearest = min(map(abs, seen), key=lambda load: abs(load - told))
    if abs(nearest - told) <= _ALIKE * told:
        return []
    return [f"load_n in the metadata says {told:.3g} N, the force channel {nearest:.3g} N: the channel is taken"]


def _is_off(hold: Hold, held: Hold, zero: float) -> bool:
    return abs(hold.level - zero) < _TAKEN_OFF * abs(held.level - zero)


def _cell_compliance(recording: Recording, instant: float, warnings: list[str]) -> float:
    stiffness = recording.rig.load_cell_stiffness_n_per_mm
    if stiffness is None:
        return 0.0
    if 1 / stiffness > _NOT_SOFTER * instant:
        warnings.append(
            f"a load cell of {stiffness:.4g} N/mm gives way by more than all that was measured: it is left in the film"
        )
        return 0.0
    return 1 / stiffness


def _propagate(function: Callable[[Float], Float], fit: RetardationFit) -> Float:
    """Standard deviations of what a function makes of a fit's parameters."""
    at = fit.parameters
    step = _DIFFERENCE * np.sqrt(np.diag(fit.covariance))
    slopes = np.array(
        [
            (function(at + np.eye(at.size)[i] * s) - function(at - np.eye(at.size)[i] * s)) / (2 * s)
            for i, s in enumerate(np.maximum(step, 1e-300))
        ]
    )
    return np.asarray(np.sqrt(np.maximum(np.einsum("i...,ij,j...->...", slopes, fit.covariance, slopes), 0.0)))


def _estimate(function: Callable[[Float], float], fit: RetardationFit) -> Estimate:
    sd = float(_propagate(lambda p: np.asarray(function(p)), fit))
    return bounds(function(fit.parameters), sd)


def bounds(value: float, sd: float) -> Estimate:
    """A number with its normal 95 % interval."""
    return Estimate(value, value - _NORMAL * sd, value + _NORMAL * sd)
