"""What a record shows around a fall of the voltage: one outcome in words for each piece of evidence.

Belongs here: looking at voltage, command, current, force and metadata around one fall. What an outcome weighs stands in
`breakdown_model`; where falls are, in `breakdown_falls`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.transform.breakdown_falls import FAST_S, LASTING_S, SHORTEST_LASTING_S, Fall
from pipeline.transform.breakdown_signal import FULL, Trace, finite_samples
from schemas.arrays import Float
from schemas.recording import Channel, Recording


@dataclass(frozen=True)
class Rules:
    """Limits between outcomes. Those with a source are physics; the others were set on `tests.studies.breakdown_records`."""

    shortest_discharge_s: float = 1.6e-3
    """A 33 MΩ resistor across 50 pF of film and cable: no switched-off film empties faster (physics, 3.5)."""
    like_breakdown_s: float = 20e-3
    """Below this time constant a discharge can look like a breakdown (physics, 4.7)."""
    discharge_shows_s: float = 3e-3
    """Up to this distance of samples most discharges are resolved."""
    short_discharge_shows_s: float = 8e-3
    """Up to this distance of samples the discharges are hidden that are over in five of their shortest time constants."""
    spark_shows_s: float = 25e-3
    """Up to this distance of samples the longest discharges are resolved, and a spark before a trip is seen."""
    settled_s: float = 0.15
    """Five time constants of the longest discharge through 33 MΩ: what is left after it is fed by the supply."""
    watched_s: float = 1.5
    """The fall is looked at for so long; later an operator may have come."""
    least_samples: int = 4
    """On a slow clock so many samples are taken instead of the windows in s."""
    significant: float = 6.0
    """Standard deviations of the noise beyond which a change is one."""
    residual: float = 0.02
    """Share of the level above the monitor's zero from which on voltage is left."""
    fed: float = 0.05
    """A monitor that has lost the film shows less than this share of the level; more is voltage that something feeds."""
    steady: float = 0.8
    """What still falls by a fifth while it is watched is a discharge cut short."""
    unrest: float = 0.04
    """Share of the level by which a voltage that hunts goes up and down."""
    collapse: float = 0.1
    """Share of the level that a collapse within a fall takes at once, beyond what the fall before it explains."""
    steeper: float = 2.5
    """How many times faster than the fall before it a collapse is: a discharge through a resistor only gets slower."""
    raised: float = 3.0
    """A current that has risen so many times above its early value is no longer the film's usual leakage."""
    planned_slack_s: float = 0.5
    """A timer and the start of the life agree to this (physics, 4.7)."""


RULES = Rules()
_SLOW_SAMPLES = 3
"""Samples of a fall that show that it is slow."""
_SLOW_LOSS = 0.02
"""Share of the level that is lost on the way, where a fall is slow before it collapses."""
_BEFORE_S = 1.0
_SPIKE = 1.5
"""A spark shows above everything that the current did in the life before, by this factor."""


def noise_of(value: Float) -> float:
    """Standard deviation of one sample, from differences of neighbours (robust)."""
    differences = np.diff(value)
    if differences.size < 3:
        return 0.0
    return float(1.4826 * np.median(np.abs(differences - np.median(differences))) / np.sqrt(2))


@dataclass(frozen=True)
class Samples:
    """Finite samples of another channel on the voltage's clock, s."""

    time: Float
    value: Float

    def between(self, begin: float, end: float) -> Float:
        return self.value[self.indices(begin, end)]

    def indices(self, begin: float, end: float) -> slice:
        """Samples after `begin`, up to `end`."""
        first, stop = np.searchsorted(self.time, (begin, end), side="right")
        return slice(int(first), int(stop))

    @property
    def interval(self) -> float:
        return float(np.median(np.diff(self.time)))


def samples_of(channel: Channel | None, origin_ns: int) -> Samples | None:
    """The channel, or None where it is absent or has fewer than three samples."""
    if channel is None:
        return None
    time, value = finite_samples(channel, origin_ns)
    return Samples(time, value) if time.size >= 3 else None


@dataclass(frozen=True)
class Life:
    """The life before a fall: `start` its first sample, `applied_s` when the voltage came on, `raised` whether it has left
    its set point upwards since.
    """

    start: int
    applied_s: float
    raised: bool


class Witnesses:
    """All channels of a recording, to be asked about one fall after the other."""

    def __init__(self, recording: Recording, trace: Trace, origin_ns: int) -> None:
        self.trace = trace
        self.metadata = recording.metadata
        command = samples_of(recording.channels.get("command"), origin_ns)
        self.command = command if command is not None and np.any(np.abs(command.value) > 0) else None
        self.leakage = samples_of(recording.channels.get("leakage_current"), origin_ns)
        self.force = samples_of(recording.channels.get("force"), origin_ns)

    def ask(self, fall: Fall, life: Life) -> Mapping[str, str]:
        """Outcome of each piece of evidence that the record has; what it cannot tell is left out."""
        state, off_s = self.command_at(fall)
        until = min(self._until(fall), off_s if state == "off after" else np.inf)
        settled = self._settled(fall, until)
        after, left = self._after(fall, settled)
        found = {
            "fall": self._speed(fall, until, after, 0.0 if after in ("falls on", "not seen") else left),
            "after": after,
            "command": state,
            "leakage_current": self._leakage(fall, life, until, left),
            "force": self._force(fall, life, until, left),
            "planned end": self._planned(fall, life),
        }
        if fall.back is None:  # what failed in the end says nothing about a fall that came back
            site = _site(self.metadata.failure_site)
            found["failure_site"] = "" if life.raised and site == "none" else site  # it held the test, not the stairs
        return {name: outcome for name, outcome in found.items() if outcome}

    def _until(self, fall: Fall) -> float:
        """Until when the voltage after a fall is looked at: `watched_s`, or some samples; not beyond its return."""
        time = self.trace.time
        count = min(fall.entry + RULES.least_samples, time.size - 1)
        until = max(float(time[fall.last]) + RULES.watched_s, float(time[count]))
        return until if fall.back is None else min(until, float(time[fall.back - 1]))

    def _settled(self, fall: Fall, until: float) -> slice:
        """Samples after all fast discharges are over, up to `until`."""
        time, (t0, t1) = self.trace.time, self.trace.time[[fall.last, fall.entry]]
        first = int(np.searchsorted(time, max(t0 + RULES.settled_s, t1), side="right"))
        stop = int(np.searchsorted(time, until, side="right"))
        if stop - first >= 2:
            return slice(first, stop)
        return slice(min(fall.entry + (stop - fall.entry > 2), max(stop - 1, fall.entry)), max(stop, fall.entry + 1))

    # ---- voltage ----------------------------------------------------------------------------------------------------

    def _zero(self) -> float:
        """Reading of the monitor without voltage, kV."""
        off = self.trace.value[: int(np.argmax(self.trace.value >= 0.1 * self.trace.set_point))]
        return float(np.median(off)) if off.size >= 3 else 0.0

    def _noise(self, fall: Fall) -> float:
        begin = max(0, fall.last - max(round(_BEFORE_S / self.trace.interval), 20))
        return noise_of(self.trace.value[begin : fall.last + 1])

    def _after(self, fall: Fall, settled: slice) -> tuple[str, float]:
        """What the voltage does after the fall, and the share of the level that is left of it."""
        value = (self.trace.value[settled] - self._zero()) / fall.level
        noise = self._noise(fall) / fall.level
        early = value[: max(value.size // 3, min(2, value.size))]
        left = float(np.median(early))
        if fall.back is not None:
            return ("back" if fall.fast else "sagged and back"), left
        if fall.watched(self.trace) < SHORTEST_LASTING_S:
            return "not seen", left
        rise = float(np.max(value - np.minimum.accumulate(value)))
        drop = float(np.max(np.maximum.accumulate(value) - value))
        if min(rise, drop) > max(RULES.unrest, 10 * noise):
            return "hunts", left
        if left <= max(RULES.residual, RULES.significant * noise / np.sqrt(early.size)):
            return "zero", left
        if value.size < 2:
            return "not seen", left
        if rise > 0.1 and value[-1] > 0.5 + noise:
            return "comes back in part", left
        parts = [float(np.median(part)) for part in np.array_split(value, 3)[:2]]
        return ("holds" if parts[1] >= RULES.steady * parts[0] else "falls on"), left

    def _speed(self, fall: Fall, until: float, after: str, left: float) -> str:
        """How the voltage fell to what is `left` of it, against what the resistor across the film allows."""
        trace, level = self.trace, fall.level
        stop = int(np.searchsorted(trace.time, until, side="right"))
        time = trace.time[fall.last : stop] - trace.time[fall.last]
        value = (trace.value[fall.last : stop] - self._zero()) / level
        floor = min(max(left, 0.0), 0.8)
        noise = self._noise(fall) / level
        down = np.flatnonzero(value <= floor + 0.1 * (1 - floor))
        if down.size and time[down[0]] < np.log(FULL / 0.1) * RULES.shortest_discharge_s:
            return "spark"
        below = np.flatnonzero(value <= floor + max(4 * noise, 0.03))
        way = slice(1, int(below[0]) if below.size else value.size)
        t, v = time[way], value[way] - floor
        if floor <= max(RULES.residual, RULES.significant * noise):
            t, v = time[way], value[way]
        if fall.back is None and after != "hunts" and _collapses(time, value, noise):
            return "slow, then at once"
        rest = "zero" if left <= max(RULES.residual, RULES.significant * noise) else "a rest"
        if t.size < 3 or np.any(v <= 0):
            if fall.entry - fall.last > 2:
                return "fast" if fall.fast else "slow"
            if time[1] <= RULES.discharge_shows_s:
                return "in one step"
            if time[1] <= RULES.short_discharge_shows_s:
                return f"in one step of some ms to {rest}"
            return (
                f"in one slow step to {rest}" if time[1] <= RULES.spark_shows_s else f"between slow samples to {rest}"
            )
        tau, misfit = _exponential(t, v)
        if tau > 0 and misfit <= max(3 * noise, 0.02):
            pace = "short" if tau < RULES.like_breakdown_s else ("long" if tau < RULES.settled_s else "slow")
            return "slow" if pace == "slow" and rest != "zero" else f"{pace} discharge to {rest}"
        return "fast" if fall.fast else "slow"

    # ---- other channels ---------------------------------------------------------------------------------------------

    def command_at(self, fall: Fall) -> tuple[str, float]:
        """Whether the command was on while the voltage fell, and when it went off in s (NaN while on).

        `off first`: it had left its level when the voltage did. `off at once`: on a slow clock nobody can say which was first.
        `off after`: it went within half a second. Empty where its
        samples are too coarse to say, or it is not there.
        """
        if self.command is None:
            return "", float("nan")
        time = self.trace.time
        before, after = float(time[fall.last]), float(time[min(fall.last + 1, time.size - 1)])
        until = float(time[fall.entry]) + LASTING_S
        steady = self.command.between(before - 1.25, before - 0.25)
        if not steady.size:
            steady = self.command.between(-np.inf, before)[-3:]
        reference = float(np.median(np.abs(steady))) if steady.size else 0.0
        if (
            reference <= 0.01 * np.abs(self.command.value).max()
            or self.command.time[-1] < after - self.command.interval
        ):
            return "", float("nan")
        window = self.command.indices(before - 0.25, until)
        at, off = self.command.time[window], np.abs(self.command.value[window]) < FULL * reference
        if not off.any():
            return "on", float("nan")
        first = int(np.argmax(off))
        gone, seen = float(at[first]), float(at[first - 1]) if first else before - 0.25
        if gone <= after + 0.25 * (after - before):
            return ("off first" if seen < before or after - before < RULES.spark_shows_s else "off at once"), gone
        return ("off after" if seen >= before else ""), gone

    def _leakage(self, fall: Fall, life: Life, until: float, left: float) -> str:
        if self.leakage is None:
            return ""
        time = self.trace.time
        last, start = float(time[fall.last]), float(time[life.start])
        step = self.leakage.interval
        before = self.leakage.between(last - max(_BEFORE_S, 8 * step), last - min(0.02, 0.5 * step))
        near = self.leakage.between(last, last + max(0.1, 1.5 * step))
        later = self.leakage.between(min(last + max(RULES.settled_s, 0.5 * step), until - step), until + 0.5 * step)
        if before.size < 3 or not near.size or not later.size:
            return ""
        off = self.leakage.between(-np.inf, life.applied_s - step)
        zero = float(np.median(off)) if off.size >= 3 else 0.0
        before, near, later = before - zero, near - zero, later - zero
        lived = self.leakage.between(min(start + 0.2, last), last) - zero
        early = float(np.median(lived[: max(lived.size // 5, 1)])) if lived.size else float(np.median(before))
        usual, noise = float(np.median(before)), max(noise_of(before), noise_of(lived))
        found = float(np.median(later))
        margin = RULES.significant * noise / np.sqrt(min(later.size, before.size))
        highest = max(float(np.median(near)), found) if near.size >= 3 else found
        if highest > usual + max(RULES.significant * noise / np.sqrt(min(near.size, later.size)), 0.5 * abs(usual)):
            return "jumps"
        if found > RULES.raised * abs(early) + margin and found > min(2 * left, 0.6) * usual:
            return "stays high"
        top = float(np.abs(lived).max()) if lived.size else 0.0
        if float(near.max()) > max(_SPIKE * top, usual + 10 * noise + abs(usual)):
            return "spikes"
        slowly = "" if step <= RULES.spark_shows_s else ", slowly sampled"
        if left > 0.8 or abs(usual) * (1 - left) <= 2 * margin:
            return f"shows nothing{slowly}"
        if abs(found - left * usual) < abs(found - usual):
            return f"follows the voltage{slowly}"
        return "goes on" if left < RULES.fed else "goes on at less voltage"

    def _force(self, fall: Fall, life: Life, until: float, left: float) -> str:
        if self.force is None:
            return ""
        time, step = self.trace.time, self.force.interval
        last, start = float(time[fall.last]), float(time[life.start])
        before = self.force.between(last - max(0.1, 4 * step), last)
        after = self.force.between(last + min(0.02, step), max(last + 0.1, min(until, last + max(0.5, 4 * step))))
        if before.size < 2 or after.size < 2:
            return ""
        after = after[after.size // 3 :]
        noise = noise_of(self.force.between(last - max(_BEFORE_S, 20 * step), last))
        limit = RULES.significant * noise * np.sqrt(1 / before.size + 1 / after.size)
        moved = float(np.median(after) - np.median(before))
        rest = self.force.between(life.applied_s - max(_BEFORE_S, 4 * step), life.applied_s - step)
        on = self.force.between(start + 0.1, start + max(_BEFORE_S, 4 * step))
        expected = float(np.median(rest) - np.median(on)) * (1 - left**2) if rest.size >= 2 and on.size >= 2 else 0.0
        if abs(expected) < 2 * limit:
            return "steps" if abs(moved) > max(limit, 1e-9) else ("silent" if abs(expected) < limit else "")
        return "still" if abs(moved) < 0.3 * abs(expected) else "steps"

    # ---- what people wrote down -------------------------------------------------------------------------------------

    def _planned(self, fall: Fall, life: Life) -> str:
        planned = self.metadata.test_duration_s
        if life.raised:
            return "raised"
        if planned is None:
            return ""
        last = float(self.trace.time[fall.last])
        slack = RULES.planned_slack_s
        reached = last - float(self.trace.time[life.start]) >= planned - slack
        coarse = max(slack, 1.5 * self.trace.interval)
        timer = abs(last - life.applied_s - planned) <= coarse or last - self.trace.time[life.start] >= planned - coarse
        return "reached" if reached else ("timer" if timer else "not yet")


def _site(site: str | None) -> str:
    if site in (None, "unknown"):
        return ""
    return "none" if site == "none" else "a place"


def _collapses(time: Float, value: Float, noise: float) -> bool:
    """Whether a fall, as shares of the level from its beginning on, goes slowly for some samples and then at once.

    What discharges through a resistor is fastest at its beginning, so that nothing which does falls faster later on.
    """
    if value.size < _SLOW_SAMPLES + 2:
        return False
    step = max(1, round(FAST_S / float(np.median(np.diff(time)))))
    drops = value[:-step] - value[step:]
    if not drops.size:
        return False
    at = int(np.argmax(drops))
    before, lasted = float(value[0] - value[at]), float(time[at] - time[0])
    if at < max(_SLOW_SAMPLES, 3 * step) or before <= max(_SLOW_LOSS, RULES.significant * noise):
        return False
    expected = before / lasted * float(time[at + step] - time[at])
    taken = float(drops[at])
    return taken >= RULES.steeper * expected and taken - expected >= max(RULES.collapse, 10 * noise)


def _exponential(t: Float, v: Float) -> tuple[float, float]:
    """Time constant in s (0 when it does not fall) and root mean square misfit of an exponential to zero."""
    weight = v**2 / np.sum(v**2)
    log = np.log(v)
    mean_t, mean_log = float(weight @ t), float(weight @ log)
    spread = float(weight @ (t - mean_t) ** 2)
    slope = float(weight @ ((t - mean_t) * (log - mean_log))) / spread if spread > 0 else 0.0
    fitted = np.exp(mean_log + slope * (t - mean_t))
    return (-1 / slope if slope < 0 else 0.0), float(np.sqrt(np.mean((v - fitted) ** 2)))
