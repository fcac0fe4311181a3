"""Electrical steps: per cycle the steps of force and capacitance and how they come about.

The source names instant fractions, rise, overshoot and recovery without defining them (thesis, section 5.4); the
definitions here are the project's own and stand in `measure_steps`. Edges are found in `step_edges`, levels and the slow
change in `step_levels`; fits over the steps of a specimen are in `pipeline.fit.sensing.self_sensing` and `pipeline.fit.sensing.wrinkling`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.transform.step_drift import DriftingStep, fit_drifting_steps
from pipeline.transform.step_edges import (
    EDGE_S,
    Edges,
    describe_unsteady,
    on_phases,
    seconds_and_values,
    without_spikes,
)
from pipeline.transform.step_levels import (
    FEWEST_RESTS,
    Course,
    SlowChange,
    baseline_misfit,
    course,
    final_level,
    noise_memory,
    on_span,
    slow_change,
)
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.numbers import among
from schemas.recording import Recording

_STILL_FADING = 0.01
"""Share of a step that goes in the second half of the rest after it, from which on a rest counts as too short."""
_MOST_MOVED = 0.25
"""Share of a force step from which what the load may have moved beside it is no slow change of the film: over the 95
steps of the demonstration it is 0.16 at most, with staircases as high as the step 0.35 and more."""
_MOVES = "the load itself moves"
INSTANT_S = 0.1
"""Delay after the voltage has reached 90 % at which the instant fraction is read."""


@dataclass(frozen=True)
class StepResponse:
    """One step: on-edge to off-edge and the rest after it. None where it cannot be computed, see `warnings`.

    Force steps are positive for a drop of tension, capacitance steps as measured, both from the level that the film would
    recover to; fractions are of the change from the level that it had, at its end. `start_s` and `end_s` are seconds since the recording's first sample. Standard deviations are those of the levels and
    of the slow change between them.
    """

    cycle: int
    start_s: float
    end_s: float
    voltage_kv: float
    force_rest_n: float
    force_step_n: float
    force_step_sd_n: float
    force_instant_fraction: float | None
    rise_time_s: float | None
    overshoot_percent: float | None
    settling_time_s: float | None
    recovery_time_s: float | None
    capacitance_rest_pf: float | None = None
    capacitance_step_pf: float | None = None
    capacitance_step_sd_pf: float | None = None
    capacitance_instant_fraction: float | None = None
    capacitance_mean_fraction: float | None = None
    spikes: int = 0
    wrinkled: bool | None = None
    warnings: tuple[str, ...] = ()

    @property
    def capacitive_strain(self) -> float | None:
        """|change| over rest capacitance: 1 − λ_cap."""
        if self.capacitance_step_pf is None or not self.capacitance_rest_pf:
            return None
        return abs(self.capacitance_step_pf) / self.capacitance_rest_pf

    @property
    def capacitive_strain_sd(self) -> float | None:
        if self.capacitance_step_sd_pf is None or not self.capacitance_rest_pf:
            return None
        return self.capacitance_step_sd_pf / self.capacitance_rest_pf


@dataclass(frozen=True)
class StepAnalysis:
    """All steps of a recording, the slow change of its rest levels, and what could not be done."""

    steps: tuple[StepResponse, ...]
    force_change: SlowChange | None
    capacitance_change: SlowChange | None
    warnings: tuple[str, ...] = ()

    @property
    def common_sd(self) -> float:
        """Relative standard deviation that all ratios of force to capacitance steps share: of what was not recovered."""
        return math.hypot(*(_left(c)[1] for c in (self.force_change, self.capacitance_change)))


def measure_steps(recording: Recording) -> StepAnalysis:
    """Steps of an electrical step recording, open or closed loop.

    Edges are 50 % crossings of the measured voltage. A level is the mean of the last 0.5 s (or of the last 20 % of the
    phase, if that is shorter) before an edge. With five rest levels or more the slow change beside the steps is estimated
    and taken out first, and to each step is added what the film had not recovered of the one before, which is gone by its
    end. y is the change over the step, from the level before it. Instant fraction: y 0.1 s after the voltage has reached 90 %. Rise
    time: first crossings of 0.1 and 0.9. Overshoot: 100 (max y − 1), 0 where noise explains it. Settling: last exit from
    ±5 %, or from what noise alone reaches in the phase where that is wider. Recovery: from the fall until 90 % of the
    step is gone. With fewer rest levels in a force that drifts, levels and a drift that slows down are fitted together
    (`step_drift`), and times and fractions are not read. One step that begins with the record is known by its release.

    Raises `NotIdentifiableError` without a voltage step, and without force.
    """
    voltage, force = recording.channels["voltage"], recording.channels["force"]
    capacitance = recording.channels.get("capacitance")
    start = recording.start_ns
    warnings: list[str] = []
    if capacitance is None:
        warnings.append("no capacitance channel: force only")
    if recording.metadata.controller == "closed" and "demand" not in recording.channels:
        warnings.append("closed loop without a demand channel: the loop's error cannot be computed")
    volts = seconds_and_values(voltage, start)
    phases = on_phases(*volts)
    if not phases:
        raise NotIdentifiableError(
            "the voltage makes no step",
            where=f"{recording.metadata.recording_id} /voltage",
            expected="at least one change from off to on",
        )
    tension = seconds_and_values(force, start)
    force_memory, capacitance_memory = noise_memory(*tension, phases), 0.0
    force_change = slow_change(*tension, phases, force_memory)
    capacitance_change = None
    clean: tuple[Float, Float] | None = None
    spikes_by_phase = [0] * len(phases)
    if capacitance is not None:
        clean, spikes_by_phase = without_spikes(*seconds_and_values(capacitance, start), phases)
        capacitance_memory = noise_memory(*clean, phases)
        capacitance_change = slow_change(*clean, phases, capacitance_memory)
    if len(phases) == 1 and not phases[0].has_rest:
        return _measure_release(volts, tension, clean, phases[0], (force_memory, capacitance_memory), tuple(warnings))
    steps: list[StepResponse] = []
    together: list[DriftingStep] | None = None

    @functools.cache
    def fit_together() -> list[DriftingStep] | None:
        return fit_drifting_steps(*tension, phases, force_memory)

    for number, phase in enumerate(phases, start=1):
        if not phase.has_rest:
            warnings.append(f"step {number} begins with the record: no rest level before it")
            continue
        pulled = course(*tension, phase, force_change, force_memory)
        step = _force_step(number, phase, final_level(*volts, phase).value, pulled)
        rest_from = phases[number - 2].off if number > 1 else float(tension[0][0])
        last = -steps[-1].force_step_n if steps and math.isfinite(steps[-1].force_step_n) else 0.0
        left = 0.0 if force_change is None or pulled is None else force_change.unrecovered * (pulled.step - last)
        moved = baseline_misfit(*tension, phase, rest_from, force_change, force_memory, left)
        if moved > 0 and force_change is None:
            together = fit_together()
        step = _refuse_moved(step, moved) if together is None else _beside_drift(step, together[number - 1])
        if unsteady := describe_unsteady(*volts, phase):
            step = replace(step, warnings=(*step.warnings, unsteady))
        if clean is not None:
            found = course(*clean, phase, capacitance_change, capacitance_memory)
            step = _with_capacitance(step, phase, found, spikes_by_phase[number - 1])
        steps.append(step)
    steps = _refuse_unchecked(steps, phases)
    if any(spikes_by_phase):
        warnings.append(
            f"{sum(spikes_by_phase)} samples of the capacitance within {EDGE_S * 1e3:.0f} ms of an edge left out as"
            " interference"
        )
    if together is not None:
        warnings.append(
            "the force drifts: its levels before, while and after the voltage are fitted together with the drift"
        )
    elif force_change is None:
        warnings.append(
            f"fewer than {FEWEST_RESTS} rest levels: slow relaxation and drift cannot be told from the step"
        )
    refused = sum(any(_MOVES in warning for warning in step.warnings) for step in steps)
    if refused:
        warnings.append(
            f"the force of {among(refused, len(steps), 'step')} is refused: {_MOVES} beside {'it' if refused == 1 else 'them'}"
        )
    whole = _recovered(steps, force_change, capacitance_change)
    return StepAnalysis(tuple(whole), force_change, capacitance_change, tuple(warnings))


def _measure_release(
    volts: tuple[Float, Float],
    tension: tuple[Float, Float],
    clean: tuple[Float, Float] | None,
    phase: Edges,
    memories: tuple[float, float],
    warnings: tuple[str, ...],
) -> StepAnalysis:
    """The one step of a record that begins with the voltage on, known by its release: where the film comes back to is its rest.

    Raises `NotIdentifiableError` where the voltage stays on, or the force around the release is no level.
    """
    if not phase.has_fall:
        raise NotIdentifiableError(
            "the voltage makes no step: it is on from the first sample to the last",
            expected="at least one change from off to on, or from on to off",
        )
    pulled = fit_drifting_steps(*tension, [phase], memories[0])
    if pulled is None:
        raise NotIdentifiableError(
            "the record begins with the voltage on, and the force is no step on a steady drift where it goes off",
            expected="a level before the voltage goes off and one after it, or a rest before it comes on",
        )
    step = _force_step(1, phase, final_level(*volts, phase).value, None)
    said = ("it begins with the record: its levels are those at its end and after it; no rise, no instant fraction",)
    step = _beside_drift(replace(step, warnings=said), pulled[0])
    sensed = None if clean is None else fit_drifting_steps(*clean, [phase], memories[1])
    if sensed is not None:
        step = replace(
            step,
            capacitance_rest_pf=sensed[0].rest,
            capacitance_step_pf=sensed[0].step,
            capacitance_step_sd_pf=sensed[0].step_sd,
        )
    elif clean is not None:
        step = replace(
            step, warnings=(*step.warnings, "the capacitance is no step on a steady drift where it goes off")
        )
    if unsteady := describe_unsteady(*volts, phase):
        step = replace(step, warnings=(*step.warnings, unsteady))
    return StepAnalysis(
        (step,), None, None, (*warnings, "the record begins with the voltage on: one release is measured")
    )


def _beside_drift(step: StepResponse, found: DriftingStep) -> StepResponse:
    """The step with what a fit together with the drift gives; courses of time that were read without the drift are none."""
    return replace(
        _without_courses(step),
        force_rest_n=found.rest,
        force_step_n=-found.step,
        force_step_sd_n=found.step_sd,
    )


def _left(change: SlowChange | None) -> tuple[float, float]:
    """Share of a step that is still there before the next, with its standard deviation; 0 where the rests are long enough.

    They are where hardly anything goes in their second half, and what is left cannot be more than what still went there.
    """
    if change is None or change.fading < _STILL_FADING:
        return 0.0, 0.0
    return min(max(change.unrecovered, 0.0), change.fading), min(change.unrecovered_sd, change.fading)


def _recovered(
    steps: Sequence[StepResponse], force: SlowChange | None, capacitance: SlowChange | None
) -> list[StepResponse]:
    """Steps with what was left of the one before them added. The error of that share is one for all: `common_sd`."""
    whole = list(steps)
    pulled, sensed = _left(force)[0], _left(capacitance)[0]
    for i in range(1, len(steps)):
        before, step = steps[i - 1], steps[i]
        if math.isfinite(before.force_step_n):
            whole[i] = replace(whole[i], force_step_n=step.force_step_n + pulled * before.force_step_n)
        change, last = step.capacitance_step_pf, before.capacitance_step_pf
        if change is not None and last is not None:
            whole[i] = replace(whole[i], capacitance_step_pf=change + sensed * last)
    return whole


def _instant(course: Course, phase: Edges) -> float | None:
    at = phase.reached - phase.on + INSTANT_S
    if at > phase.off - phase.on:
        return None
    return float(np.interp(at, course.t, course.y))


def _force_step(number: int, phase: Edges, volts: float, course: Course | None) -> StepResponse:
    empty = StepResponse(
        number,
        phase.on,
        phase.off,
        volts,
        math.nan,
        math.nan,
        math.nan,
        None,
        None,
        None,
        None,
        None,
        warnings=("too few force samples around the step",),
    )
    if course is None:
        return empty
    step = replace(
        empty, force_rest_n=course.rest, force_step_n=-course.step, force_step_sd_n=course.step_sd, warnings=()
    )
    return _with_dynamics(step, course, phase)


def _refuse_moved(step: StepResponse, moved: float) -> StepResponse:
    """The step without its force where the load itself may have moved by `moved` N over it, much of the step."""
    if not math.isfinite(step.force_step_n) or moved < _MOST_MOVED * abs(step.force_step_n):
        return step
    text = (
        f"{_MOVES} by up to {moved:.2g} N over this step, and no slow change describes it: the force of the"
        f" step, {step.force_step_n:.2g} N if it did not, is refused"
    )
    return _without_force(step, text)


def _refuse_unchecked(steps: list[StepResponse], phases: Sequence[Edges]) -> list[StepResponse]:
    """The steps, without the force of those that may stand in a load that moves though their own rests do not show it.

    One that ends with the record has no rest after it; and a load that moves beside a third of the steps and more may come back to where
    it was beside any other.
    """
    moving = sum(any(_MOVES in warning for warning in step.warnings) for step in steps)
    if not moving:
        return steps
    everywhere = 3 * moving >= len(steps)
    text = f"{_MOVES} beside {among(moving, len(steps), 'step')}, and the rests at this one cannot show that it does not here"
    return [
        _without_force(step, text)
        if math.isfinite(step.force_step_n) and (everywhere or not phases[step.cycle - 1].has_fall)
        else step
        for step in steps
    ]


def _without_force(step: StepResponse, because: str) -> StepResponse:
    return replace(
        _without_courses(step), force_step_n=math.nan, force_step_sd_n=math.nan, warnings=(*step.warnings, because)
    )


def _without_courses(step: StepResponse) -> StepResponse:
    """The step without what is read from the course of its force over time."""
    return replace(
        step,
        force_instant_fraction=None,
        rise_time_s=None,
        overshoot_percent=None,
        settling_time_s=None,
        recovery_time_s=None,
    )


def _with_dynamics(step: StepResponse, course: Course, phase: Edges) -> StepResponse:
    """Adds rise, overshoot, settling and recovery of the force."""
    if abs(course.step) < 5 * course.step_sd or not math.isfinite(course.noise):
        return replace(step, warnings=(*step.warnings, "the force step is within the noise: no times, no fractions"))
    warnings = list(step.warnings)
    on = (course.t >= -EDGE_S) & (course.t < phase.off - phase.on - EDGE_S)  # the smoothing reaches over the edge
    t, y = course.t[on], course.y[on]
    # The largest of many noise values, not three standard deviations: else the last exit is always noise.
    highest_noise = 1.2 * course.noise * math.sqrt(2 * math.log(max(y.size, 2)))
    band = max(0.05, highest_noise)
    outside = np.flatnonzero(np.abs(y - 1) > band)
    settling = float(t[min(outside[-1] + 1, t.size - 1)]) if outside.size else 0.0
    tail = 0.2 * (phase.off - phase.on)
    if settling > phase.off - phase.on - tail:
        warnings.append("the step is shorter than its settling time")
    before_the_end = y[t < phase.off - phase.on - on_span(phase)]
    peak = float(before_the_end.max() - 1) if before_the_end.size else 0.0
    if not phase.has_fall:
        warnings.append("the record ends before the voltage falls: no recovery time")
    recovery = _recovery(course, phase)
    if phase.has_fall and recovery is None:
        warnings.append("recovery takes longer than the rest after the step")
    return replace(
        step,
        force_instant_fraction=_instant(course, phase),
        rise_time_s=_between(t, y, 0.1, 0.9),
        overshoot_percent=100 * peak if peak > highest_noise else 0.0,
        settling_time_s=max(settling, 0.0),
        recovery_time_s=recovery,
        warnings=tuple(warnings),
    )


def _recovery(course: Course, phase: Edges) -> float | None:
    """Time from the fall until 90 % of the step is gone; None where that is not seen."""
    if not phase.has_fall:
        return None
    after = course.t >= phase.off - phase.on
    gone = np.flatnonzero(course.y[after] <= 0.1)
    return float(course.t[after][gone[0]] - (phase.off - phase.on)) if gone.size else None


def _between(t: Float, y: Float, low: float, high: float) -> float | None:
    """Time from the first crossing of `low` to the first crossing of `high`, interpolated."""
    times = []
    for limit in (low, high):
        above = np.flatnonzero(y >= limit)
        if not above.size:
            return None
        i = int(above[0])
        if i == 0:
            times.append(float(t[0]))
            continue
        times.append(float(np.interp(limit, [y[i - 1], y[i]], [t[i - 1], t[i]])))
    return times[1] - times[0]


def _with_capacitance(step: StepResponse, phase: Edges, course: Course | None, spikes: int) -> StepResponse:
    if course is None:
        return replace(step, warnings=(*step.warnings, "too few capacitance samples around the step"), spikes=spikes)
    step = replace(
        step,
        capacitance_rest_pf=course.rest,
        capacitance_step_pf=course.step,
        capacitance_step_sd_pf=course.step_sd,
        spikes=spikes,
    )
    if abs(course.step) < 5 * course.step_sd:
        return replace(step, warnings=(*step.warnings, "the capacitance step is within the noise"))
    warnings = tuple(w for w in step.warnings if not w.startswith("recovery takes longer"))
    recovery = _recovery(course, phase)
    if phase.has_fall and recovery is None:
        warnings += ("recovery takes longer than the rest after the step",)
    on = (course.t >= 0) & (course.t < phase.off - phase.on)
    return replace(
        step,
        capacitance_instant_fraction=_instant(course, phase),
        capacitance_mean_fraction=float(np.mean(course.y[on])) if on.any() else None,
        recovery_time_s=recovery,
        warnings=warnings,
    )
