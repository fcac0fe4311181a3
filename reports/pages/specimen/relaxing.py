"""The parts of recording and specimen pages about stress relaxation: the film's force after a step, beside the model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from reports.blocks import Figure, Pair, Section, bold, flow
from reports.evidence import MISSES
from reports.figures.curves import arms, rig
from reports.figures.relaxation import relaxation
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.site import stated_rig
from schemas.arrays import Float
from schemas.numbers import NBSP, compact, percent, significant, with_unit

_POINTS = 48
"""Points drawn, spaced by equal ratios of time."""
_DRAWN = 4
"""Recordings drawn on a specimen's page."""
_SETTLED = 1.0
"""Durations of the ramp after its middle from which the force is compared with the model."""


@dataclass(frozen=True)
class Course:
    """What follows a step, as recorded and by the model.

    Parameters
    ----------
    recording : its id
    time : (n,) s after the middle of the ramp
    stiffness : (n,) force over displacement, or output over input of a system of another kind
    model : (n,) the same by the model, None without one
    unit : N/mm; "" for a system of another kind
    made_from : what the points are
    """

    recording: str
    time: Float
    stiffness: Float
    model: Float | None
    unit: str = "N/mm"
    made_from: str = "from the recording's envelope"

    @property
    def off(self) -> float | None:
        """Root mean square of (measured over model − 1)."""
        return None if self.model is None else float(np.sqrt(np.mean((self.stiffness / self.model - 1) ** 2)))


def of_recording(draft: Draft, row: Record) -> Section | None:
    """The relaxation of one recording; the model stands on the page of its specimen."""
    course = _stored(draft, row, None) or (_course(draft, row, None) if _relaxes(row) else None)
    if course is None:
        return None
    return Section("relaxation", _heading([course]), "Relaxation", (_figure(draft, course, "relaxation"),))


def of_specimen(draft: Draft, recordings: Sequence[Record], chosen: Record | None) -> Section | None:
    """The relaxations of a specimen beside its model."""
    found = [r for r in recordings if _relaxes(r) and r["status"] in ("ok", "damaged")][:_DRAWN]
    drawn = (_stored(draft, r, chosen) or _course(draft, r, chosen) for r in found)
    courses = [c for c in drawn if c is not None]
    if not courses:
        return None
    figures = [_figure(draft, c, f"relaxation_{i}") for i, c in enumerate(courses, 1)]
    pairs = tuple(Pair(tuple(figures[i : i + 2])) for i in range(0, len(figures), 2))
    return Section("relaxation", _heading(courses), "Relaxation", pairs)


def _relaxes(row: Record) -> bool:
    return bool(row["protocol"] == "step" and row["loading"] == "mechanical")


def _heading(courses: Sequence[Course]) -> str:
    first = courses[0]
    before, after = significant(first.stiffness[0], 2), with_unit(significant(first.stiffness[-1], 2), first.unit)
    kept, falls = with_unit(before, first.unit) == after, f"{before} to {after}"
    until = f"{significant(float(first.time[0]), 1)} to {significant(float(first.time[-1]), 2)}{NBSP}s"
    if not first.unit:
        said = f"stays at {after} from {until}" if kept else f"goes from {falls} in {until}"
        return f"After the step the output over the input {said}"
    off = [c.off for c in courses if c.off is not None]
    text = (
        f"The film keeps {after} from {until} after the step" if kept else f"The film relaxes from {falls} in {until}"
    )
    if not off:
        return text
    return f"{text}; the model {'follows to' if max(off) < MISSES else 'misses that by'} {percent(max(off))}"


def _figure(draft: Draft, course: Course, name: str) -> Figure:
    who = short(course.recording, 40)
    words = f"{compact(course.time[0], 1)} to {compact(course.time[-1], 2)}{NBSP}s after the step"
    off = "" if course.off is None else f", the model off by {percent(course.off)} (root mean square)"
    line = "" if course.model is None else "; line: the model with the load cell in series"
    value = "stiffness_n_per_mm" if course.unit else "output_per_input"
    columns: dict[str, Any] = {"time_s": course.time, value: course.stiffness}
    if course.model is not None:
        columns["model_n_per_mm"] = course.model
    return Figure(
        relaxation(
            course.time, course.stiffness, course.model, unit=course.unit, alt=f"Relaxation of {who}, {words}{off}."
        ),
        flow(
            bold("Relaxation."),
            f" {who}: {words}{off}. Points: {course.made_from}{line}; nothing is drawn while the ramp lasts.",
        ),
        draft.data(name, columns),
    )  # fmt: skip


def _stored(draft: Draft, row: Record, fit: Record | None) -> Course | None:
    """What the analysis found after the step, of a staircase after its first one, which is what the model is fitted to."""
    query = Query(
        "SELECT time_s, value, ramp_s, quantity FROM relaxation_curves WHERE recording_id = $item AND usable"
        " AND step_number = 1 ORDER BY time_s",
        {"item": row["recording_id"] or ""},
    )
    data = draft.results.columns(query)
    if data["time_s"].size < 2:
        return None
    time, value = data["time_s"].astype(float), data["value"].astype(float)
    ramp, film = float(data["ramp_s"][0]), data["quantity"][0] == "stiffness_n_per_mm"
    later = time > ramp / 2
    since = time[later] - ramp / 2
    expected = None
    if film and fit is not None:
        constants = rig(fit, stated_rig([row]))
        expected = model(fit, since, ramp, None if constants is None else constants.load_cell_stiffness)
    windows = "means over windows of time"
    return Course(row["recording_id"], since, value[later], expected, "N/mm" if film else "", windows)


def _course(draft: Draft, row: Record, fit: Record | None) -> Course | None:
    """Force over displacement after the step, from the preview, where the analysis found nothing; None where no step is seen."""
    query = Query(
        "SELECT quantity, time_s, (low + high) / 2 AS middle FROM previews WHERE recording_id = $item"
        " AND quantity IN ('displacement', 'force') ORDER BY quantity, time_s",
        {"item": row["recording_id"] or ""},
    )
    data = draft.results.columns(query)
    parts = {q: np.array([str(n) == q for n in data["quantity"]], dtype=bool) for q in ("displacement", "force")}
    if not all(part.any() for part in parts.values()):
        return None
    time, moved = (
        data["time_s"][parts["displacement"]].astype(float),
        data["middle"][parts["displacement"]].astype(float),
    )
    clock, force = data["time_s"][parts["force"]].astype(float), data["middle"][parts["force"]].astype(float)
    ramp = _ramp(time, moved)
    if ramp is None:
        return None
    before = clock < ramp.middle - _SETTLED * ramp.duration
    after = clock > ramp.middle + _SETTLED * ramp.duration
    if not before.any() or after.sum() < 8:
        return None
    constants = rig(fit or {}, stated_rig([row]))
    load = force[after] - float(np.mean(force[before]))
    since, stiffness = _thinned(clock[after] - ramp.middle, load / ramp.height)
    cell = constants.load_cell_stiffness if constants is not None else None
    return Course(
        row["recording_id"], since, stiffness, None if fit is None else model(fit, since, ramp.duration, cell)
    )


@dataclass(frozen=True)
class Ramp:
    """Middle and duration of a ramp, s, and its height, mm."""

    middle: float
    duration: float
    height: float


def _ramp(time: Float, moved: Float) -> Ramp | None:
    """The only ramp of a displacement (n,): middle and duration from the moments of its slope; None where it does more."""
    if time.size < 20:
        return None
    height = float(np.median(moved[-time.size // 3 :]) - moved[0])
    if abs(height) < 1e-9:
        return None
    share = (moved - moved[0]) / height
    left, there = np.flatnonzero(share > 0.02), np.flatnonzero(share > 0.98)
    if not left.size or not there.size or left[0] == 0 or np.ptp(share[there[0] :]) > 0.1:
        return None
    window = slice(max(left[0] - 2, 0), there[0] + 2)
    weight, between = np.diff(share[window]), (time[window][1:] + time[window][:-1]) / 2
    middle = float(weight @ between / weight.sum())
    spread = float(weight @ (between - middle) ** 2 / weight.sum()) - float(np.median(np.diff(time))) ** 2 / 12
    return Ramp(middle, float(np.sqrt(12 * max(spread, 1e-12))), height)


def _thinned(time: Float, value: Float) -> tuple[Float, Float]:
    """Means over bins of equal ratio of time."""
    edges = np.geomspace(time[0] * (1 - 1e-9), time[-1] * (1 + 1e-9), _POINTS + 1)
    place = np.clip(np.digitize(time, edges) - 1, 0, _POINTS - 1)
    count = np.bincount(place, minlength=_POINTS)
    kept = count > 0
    sums = (np.bincount(place, weights=v, minlength=_POINTS) for v in (time, value))
    means = [s[kept] / count[kept] for s in sums]
    return means[0], means[1]


def model(fit: Mapping[str, Any], time: Float, ramp_s: float, cell: float | None) -> Float | None:
    """Force over displacement (n,) N/mm that a fit expects after a ramp of T, t from its middle, load cell in series.

    G(s) = k(s) kL/(k(s) + kL) has one real pole p < 0 for each arm; each gives its residue times e^{pt} sinh(x)/x with
    x = pT/2. Without a load cell the film alone, in which a pure dashpot has gone by then. None without a main spring.
    """
    if fit["k0_n_per_mm"] is None:
        return None
    k0, found = float(fit["k0_n_per_mm"]), arms(fit)
    springs = [(a.k, a.c / a.k) for a in found if a.k is not None]
    dashpot = sum(a.c for a in found if a.k is None) if cell is not None else 0.0
    times = [Polynomial([1.0, tau]) for _, tau in springs]
    below = math.prod(times, start=Polynomial([1.0]))
    above = Polynomial([k0, dashpot]) * below
    for i, (k, tau) in enumerate(springs):
        above += Polynomial([0.0, k * tau]) * math.prod(
            (t for j, t in enumerate(times) if j != i), start=Polynomial([1.0])
        )
    if cell is not None:
        above, below = cell * above, above + cell * below
    total = np.full(time.shape, float(above(0.0) / below(0.0)))
    for pole in below.roots().real:
        x = pole * ramp_s / 2
        late = (
            np.exp(pole * time) * (np.sinh(x) / x if abs(x) > 1e-6 else 1.0) if abs(x) < 500 else np.zeros(time.shape)
        )
        total = total + float(above(pole) / (pole * below.deriv()(pole))) * late
    return total
