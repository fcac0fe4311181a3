"""The parts of a specimen's page about steps, self-sensing and static force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Pair, Piece, Row, Section, Table, Text, bold, filled, flow
from reports.figures import steps as figures
from reports.figures.steps import Trace
from reports.names import short
from reports.pages.campaign import comparing
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.words import remark
from schemas.numbers import ABSENT, NBSP, bounds, capital, compact, percent, pm, significant, with_unit

_STEPS_SQL = """SELECT s.recording_id, round(s.voltage_kv, 1) AS voltage_kv, count(*) AS steps, avg(s.force_step_n) AS force_n,
       stddev_samp(s.force_step_n) AS force_sd_n, avg(s.capacitance_step_pf) AS capacitance_pf,
       stddev_samp(s.capacitance_step_pf) AS capacitance_sd_pf, avg(s.capacitive_strain) AS strain,
       avg(s.force_instant_fraction) AS force_instant, avg(s.capacitance_instant_fraction) AS capacitance_instant,
       avg(s.rise_time_s) AS rise_s, avg(s.overshoot_percent) AS overshoot, avg(s.settling_time_s) AS settling_s,
       avg(s.recovery_time_s) AS recovery_s, coalesce(bool_or(s.wrinkled), false) AS wrinkled
FROM step_responses AS s JOIN recordings AS r USING (recording_id)
WHERE r.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
  AND s.recording_id NOT IN (SELECT recording_id FROM loop_responses)
GROUP BY s.recording_id, round(s.voltage_kv, 1)
ORDER BY voltage_kv, s.recording_id"""
_CYCLES_SQL = """SELECT s.recording_id, s.cycle, s.voltage_kv, s.force_step_n, s.capacitance_step_pf, s.capacitive_strain,
       s.force_step_sd_n, s.capacitance_step_sd_pf, coalesce(s.wrinkled, false) AS wrinkled
FROM step_responses AS s JOIN recordings AS r USING (recording_id)
WHERE r.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY s.recording_id, s.cycle"""
_OPEN_CYCLES_SQL = """SELECT s.recording_id, s.cycle, s.voltage_kv, s.force_step_n, s.capacitance_step_pf, s.capacitive_strain,
       s.force_step_sd_n, s.capacitance_step_sd_pf, coalesce(s.wrinkled, false) AS wrinkled
FROM step_responses AS s JOIN recordings AS r USING (recording_id)
WHERE r.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
  AND s.recording_id NOT IN (SELECT recording_id FROM loop_responses)
ORDER BY s.recording_id, s.cycle"""


def steps_finding(draft: Draft) -> str:
    """What the steps of a specimen show, in a sentence."""
    return finding(draft.results.columns(Query(_CYCLES_SQL, {"specimen": draft.item})))


def sensing_finding(draft: Draft) -> str:
    """What the capacitance tells about the force, in a sentence; empty without a slope."""
    found = draft.results.rows(Query(_SENSING_SQL, {"specimen": draft.item}))
    slope = _per_percent(found[0]) if found else ABSENT
    return "" if slope == ABSENT else f"capacitance reads the force, {slope} per percent of capacitive strain"


def steps(draft: Draft) -> Section | None:
    """Do force and capacitance follow V²? Every step, the course of one per voltage, and their numbers."""
    query = Query(_STEPS_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    cycles = draft.results.columns(Query(_OPEN_CYCLES_SQL, {"specimen": draft.item}))
    href = draft.data("steps", cycles)
    several = len({round(float(v), 1) for v in cycles["voltage_kv"].astype(float) if v > 0}) > 1
    drawn = [
        f
        for f in (
            _square(draft, cycles, "force_step_n", 1e3, "Force", "mN", "Drop of tension, mN", href),
            _square(draft, cycles, "capacitance_step_pf", 1.0, "Capacitance", "pF", "Change of capacitance, pF", href),
        )
        if f and several
    ]
    traces = [
        f
        for f in (
            _traces(draft, "force", -1e3, "Drop of tension, mN", "Force."),
            _traces(draft, "capacitance", 1.0, "Change of capacitance, pF", "Capacitance."),
        )
        if f
    ]
    pairs = [(*drawn, *traces)] if len(drawn) + len(traces) <= 2 else [drawn, traces]
    blocks: list[Block | Fold] = [Pair(tuple(pair)) for pair in pairs if pair]
    slow = _slow(draft)
    if slow:
        blocks.append(Text(flow(bold("Beside the steps."), f" {slow}")))
    blocks.append(_table(draft, query, found))
    return Section("steps", capital(finding(cycles)), "Steps", tuple(blocks))


_SLOW_SQL = """SELECT c.recording_id, c.quantity, c.change, c.change_sd, c.duration_s, c.unrecovered, c.unrecovered_sd
FROM slow_changes AS c JOIN recordings AS r USING (recording_id)
WHERE c.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY c.recording_id, c.quantity DESC"""


def _slow(draft: Draft) -> str:
    """What changes slowly while the steps come and go, and is taken out of them; empty where nothing is known."""
    found = draft.results.rows(Query(_SLOW_SQL, {"specimen": draft.item}))
    parts = []
    for recording in list(dict.fromkeys(r["recording_id"] for r in found))[:3]:
        own = {r["quantity"]: r for r in found if r["recording_id"] == recording}
        texts = [
            f"{word} by {pm(factor * own[q]['change'], factor * own[q]['change_sd'], unit)}"
            for q, word, factor, unit in (("force", "tension", 1e3, "mN"), ("capacitance", "capacitance", 1.0, "pF"))
            if q in own
        ]
        seconds = compact(next(iter(own.values()))["duration_s"])
        parts.append(f"{short(recording, 40)}, {seconds}{NBSP}s: {' and '.join(texts)}")
    return (
        f"The rest levels change by themselves, and that is taken out of the steps. {'; '.join(parts)}."
        if parts
        else ""
    )


def _slope(voltage: np.ndarray, step: np.ndarray, kept: np.ndarray) -> float | None:
    """Least-squares slope of the step against V² through zero."""
    square = voltage[kept] ** 2
    return float(square @ step[kept] / (square @ square)) if square.any() else None


def _slope_sd(voltage: np.ndarray, step: np.ndarray, kept: np.ndarray, slope: float) -> float | None:
    """Standard error of such a slope, from the scatter of the steps around it; None with fewer than three."""
    square, n = voltage[kept] ** 2, int(kept.sum())
    rest = step[kept] - slope * square
    return float(np.sqrt(rest @ rest / (n - 1) / (square @ square))) if n > 2 else None


def _square(
    draft: Draft,
    cycles: dict[str, np.ndarray],
    column: str,
    factor: float,
    label: str,
    unit: str,
    title: str,
    href: str,
) -> Figure | None:
    voltage, step = cycles["voltage_kv"].astype(float), factor * cycles[column].astype(float)
    good = np.isfinite(voltage) & np.isfinite(step) & (voltage > 0)
    if not good.any():
        return None
    voltage, step, wrinkled = voltage[good], step[good], cycles["wrinkled"].astype(bool)[good]
    slope = _slope(voltage, step, ~wrinkled)
    levels, means = _levels(voltage, step, wrinkled)
    off = float(np.max(np.abs(means - slope * levels**2))) if slope is not None and levels.size > 1 else None
    words = "no slope"
    if slope is not None:
        sd = _slope_sd(voltage, step, ~wrinkled, slope)
        words = with_unit(significant(slope), f"{unit}/kV²") if sd is None else pm(slope, sd, f"{unit}/kV²")
    text = f" {words} through zero" + (
        f"; the means at each voltage are off it by {significant(off, 2)}{NBSP}{unit} at most."
        if off is not None
        else "."
    )
    if wrinkled.any():
        text += f" Open: wrinkled, from {compact(float(voltage[wrinkled].min()), 2)}{NBSP}kV on, not in the line."
    return Figure(
        figures.against_square(
            voltage,
            step,
            wrinkled,
            slope,
            title,
            alt=f"{label} steps of {short(draft.item, 40)} against voltage squared:{text}",
        ),
        flow(bold(f"{label}."), text),
        href,
    )


def _levels(voltage: np.ndarray, step: np.ndarray, wrinkled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean step (m,) at each voltage (m,), wrinkled steps left out."""
    rounded = np.round(voltage, 1)
    levels = np.unique(rounded[~wrinkled])
    return levels, np.array([np.mean(step[(rounded == v) & ~wrinkled]) for v in levels])


def _errors(voltage: np.ndarray, sd: np.ndarray, wrinkled: np.ndarray) -> np.ndarray:
    """Standard deviation (m,) of the mean step at each voltage, from those of the steps."""
    rounded = np.round(voltage, 1)
    kept = [sd[(rounded == v) & ~wrinkled] for v in np.unique(rounded[~wrinkled])]
    return np.array([np.sqrt(np.mean(own**2) / own.size) for own in kept])


def exponent(voltage: np.ndarray, step: np.ndarray, sd: np.ndarray | None = None) -> tuple[float, float] | None:
    """Slope of ln |step| against ln voltage with its standard error; None with fewer than four levels or other signs.

    `sd` are standard deviations of the steps, for their weights; what scatters more than they say widens the error.
    """
    if voltage.size < 4 or not (np.all(step > 0) or np.all(step < 0)):
        return None
    x, y = np.log(voltage), np.log(np.abs(step))
    weight = np.ones_like(y) if sd is None or not np.all(sd > 0) else (step / sd) ** 2
    x = x - float(weight @ x / weight.sum())
    spread = float((weight * x) @ x)
    slope = float((weight * x) @ y / spread)
    rest = y - float(weight @ y / weight.sum()) - slope * x
    return slope, float(np.sqrt((weight * rest) @ rest / (x.size - 2) / spread))


_FAR = 2.6
"""Standard errors at which an exponent from few levels is another one than 2."""


def finding(cycles: dict[str, np.ndarray]) -> str:
    """How force and capacitance follow the voltage, and from where on the film wrinkles."""
    voltage, wrinkled = cycles["voltage_kv"].astype(float), cycles["wrinkled"].astype(bool)
    parts = []
    for column, label, factor, unit in (
        ("force_step_n", "force", 1e3, "mN"),
        ("capacitance_step_pf", "capacitance", 1.0, "pF"),
    ):
        step = factor * cycles[column].astype(float)
        good = np.isfinite(voltage) & np.isfinite(step) & (voltage > 0)
        levels, means = _levels(voltage[good], step[good], wrinkled[good])
        sd = np.abs(factor) * cycles[column.replace("step", "step_sd")].astype(float)
        power = exponent(levels, means, _errors(voltage[good], sd[good], wrinkled[good]))
        if power is not None:
            square = "" if abs(power[0] - 2) <= _FAR * power[1] else ", not as V²"
            parts.append(f"{label} goes with V to the power {pm(*power)}{square}")
        elif levels.size:
            last = step[good][np.isclose(np.round(voltage[good], 1), levels[-1])]
            scatter = float(np.std(last, ddof=1)) if last.size > 1 else 0.0
            change = pm(means[-1], scatter, unit) if scatter > 0 else with_unit(significant(means[-1]), unit)
            parts.append(f"{label} changes by {change} at {compact(levels[-1], 2)}{NBSP}kV")
    if voltage.size and not np.isfinite(cycles["force_step_n"].astype(float)).any():
        parts.insert(0, "no force step can be read beside the load's own movement or noise")
    text = "; ".join(parts) or "steps"
    if wrinkled.any():
        text += f"; from {compact(float(voltage[wrinkled].min()), 2)}{NBSP}kV on the film wrinkles"
    return text


def _table(draft: Draft, query: Query, found: Sequence[Record]) -> Table:
    rows = []
    for r in found:
        wrinkled: Piece = "wrinkled" if r["wrinkled"] else ""
        rows.append(
            Row(
                (
                    draft.site.recording(r["recording_id"]), compact(r["voltage_kv"], 2), str(r["steps"]),
                    _spread(r["force_n"], r["force_sd_n"], r["steps"], 1e3),
                    _spread(r["capacitance_pf"], r["capacitance_sd_pf"], r["steps"], 1.0),
                    percent(r["strain"]), percent(r["force_instant"]), percent(r["capacitance_instant"]),
                    significant(r["rise_s"], 2), significant(r["overshoot"], 2), significant(r["settling_s"], 2),
                    significant(r["recovery_s"], 2), wrinkled,
                )
            )
        )  # fmt: skip
    heads = (
        Head("Recording"), Head("Voltage, kV", "n"), Head("Steps", "n"), Head("Force, mN", "n"), Head("Capacitance, pF", "n"),
        Head("Strain", "n"), Head("Force at once", "n"), Head("Cap. at once", "n"),
        Head("Force: rise, s", "n"), Head("Force: over­shoot, %", "n"), Head("Force: settling, s", "n"),
        Head("Force: recovery, s", "n"), Head("Film"),
    )  # fmt: skip
    below = (
        "Means over the cycles ± their standard deviation. At once: share of the step 0.1 s after the voltage has reached"
        " 90 %. Settling: last exit from ±5 %. Recovery: until 90 % of the step is gone; – where longer than recorded."
    )
    return Table("Steps by recording and voltage", *filled(heads, rows), query.shown(), below=below, kind="wide")


def _spread(mean: float | None, sd: float | None, count: int, factor: float) -> str:
    if mean is None:
        return ABSENT
    return pm(factor * mean, factor * sd) if sd and count > 1 else significant(factor * mean)


_FIRST_STEPS_SQL = """SELECT round(s.voltage_kv, 1) AS voltage_kv, s.recording_id, s.start_s, s.end_s,
       coalesce(s.wrinkled, false) AS wrinkled
FROM step_responses AS s JOIN recordings AS r USING (recording_id)
WHERE r.specimen_id = $specimen AND r.status IN ('ok', 'damaged') AND s.end_s > s.start_s
  AND s.recording_id NOT IN (SELECT recording_id FROM loop_responses)
QUALIFY row_number() OVER (PARTITION BY round(s.voltage_kv, 1) ORDER BY s.recording_id, s.cycle) = 1
ORDER BY voltage_kv"""
_TRACES = 6
_SENSING_SQL = "SELECT *\nFROM sensing_fits\nWHERE specimen_id = $specimen"


def _traces(draft: Draft, quantity: str, factor: float, title: str, caption: str) -> Figure | None:
    """The first step at each voltage, from the preview of the recording."""
    steps_ = draft.results.rows(Query(_FIRST_STEPS_SQL, {"specimen": draft.item}))[-_TRACES:]
    slope = _fitted_slope(draft, quantity, abs(factor))
    found = [t for t in (_trace(draft, s, quantity, factor, slope) for s in steps_) if t is not None]
    if not found:
        return None
    on = max(s["end_s"] - s["start_s"] for s in steps_)
    columns: dict[str, list[object]] = {"voltage": [], "time_s": [], "change": [], "simulated": []}
    for t in found:
        columns["voltage"] += [t.name] * t.time.size
        under = (t.time >= 0) & (t.time <= on)
        columns["simulated"] += [None if t.expected is None else t.expected * bool(u) for u in under]
        columns["time_s"] += t.time.tolist()
        columns["change"] += t.change.tolist()
    return Figure(
        figures.traces(
            found,
            on,
            title,
            alt=f"{title.replace(', ', ' in ')} over time after switching on: {_levels_reached(found, on)}.",
        ),
        flow(
            bold(caption),
            " First step at each voltage, as recorded (middle of the envelope).",
            " Dashed: simulated, at once and in proportion to V²." if slope is not None else "",
        ),
        draft.data(f"steps_{quantity}", columns),
    )


def _levels_reached(traces: Sequence[Trace], on_s: float) -> str:
    """`6.2 at 3 kV, 25 at 6 kV, 44 at 8 kV (wrinkled)`: the median over the last fifth of the time under voltage."""
    parts = []
    for t in traces:
        late = t.change[(t.time > 0.8 * on_s) & (t.time < on_s)]
        level = significant(float(np.median(late)), 3) if late.size else ABSENT
        parts.append(f"{level} at {t.name}{' (wrinkled)' if t.wrinkled else ''}")
    return ", ".join(parts)


def _fitted_slope(draft: Draft, quantity: str, factor: float) -> float | None:
    """Change per kV² of a quantity, fitted through the steps at several voltages; None with fewer than two."""
    cycles = draft.results.columns(Query(_OPEN_CYCLES_SQL, {"specimen": draft.item}))
    column = {"force": "force_step_n", "capacitance": "capacitance_step_pf"}[quantity]
    voltage, step = cycles["voltage_kv"].astype(float), factor * cycles[column].astype(float)
    kept = np.isfinite(voltage) & np.isfinite(step) & (voltage > 0) & ~cycles["wrinkled"].astype(bool)
    return _slope(voltage, step, kept) if np.unique(np.round(voltage[kept], 1)).size > 1 else None


def _trace(draft: Draft, step: Record, quantity: str, factor: float, slope: float | None) -> Trace | None:
    """The stretch of a preview around a step, zero before it."""
    start, length = step["start_s"], step["end_s"] - step["start_s"]
    data = draft.results.columns(
        Query(
            "SELECT time_s, (low + high) / 2 AS middle FROM previews WHERE recording_id = $recording"
            " AND quantity = $quantity AND time_s BETWEEN $first AND $last ORDER BY time_s",
            {
                "recording": step["recording_id"], "quantity": quantity,
                "first": start - 0.3 * length, "last": start + 1.9 * length,
            },
        )
    )  # fmt: skip
    time = data["time_s"].astype(float) - start
    before = (time > -0.3 * length) & (time < -0.02 * length)
    shown = time > -0.1 * length
    if shown.sum() < 8 or not before.any():
        return None
    change = factor * (data["middle"].astype(float) - float(np.nanmean(data["middle"][before])))
    expected = None if slope is None else slope * step["voltage_kv"] ** 2
    return Trace(f"{compact(step['voltage_kv'], 2)} kV", time[shown], change[shown], bool(step["wrinkled"]), expected)


def _per_percent(fit: Record, unit: str = "mN") -> str:
    """The slope of force on capacitive strain in mN per percent."""
    sd = fit["force_per_capacitive_strain_n_sd"]
    if fit["force_per_capacitive_strain_n"] is None:
        return ABSENT
    return pm(10 * fit["force_per_capacitive_strain_n"], None if sd is None else 10 * sd, unit)


def sensing(draft: Draft) -> Section | None:
    """Force from capacitance: the fit, and the steps it stands on."""
    query = Query(_SENSING_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    fit = found[0]
    rows = [
        (
            "Force over capacitive strain",
            "mN/%",
            _per_percent(fit, ""),
        ),
        ("R² of that line", "", significant(fit["r_squared"], 3)),
        ("Bend at the largest strain", "", bounds(*(fit[f"nonlinearity{end}"] for end in ("", "_lower", "_upper")))),
        ("Modulus that the slope implies", "MPa", pm(fit["modulus_mpa"], fit["modulus_mpa_sd"])),
        ("Modulus of mechanical tests", "MPa", pm(fit["mechanical_modulus_mpa"], fit["mechanical_modulus_mpa_sd"])),
        ("Ratio of the two", "", bounds(*(fit[f"modulus_ratio{end}"] for end in ("", "_lower", "_upper")))),
        ("Sensitivity", "", pm(fit["sensitivity"], fit["sensitivity_sd"])),
        ("Sensitivity from the geometry", "", significant(fit["predicted_sensitivity"], 3)),
        ("Drift of the capacitance at given force", "pF/h", pm(fit["drift_pf_per_hour"], fit["drift_pf_per_hour_sd"])),
        ("Exponent of the force in the voltage", "", pm(fit["force_exponent"], fit["force_exponent_sd"])),
        ("Wrinkles from", "kV", bounds(*(fit[f"wrinkling_onset_kv{end}"] for end in ("", "_lower", "_upper")))),
    ]
    rows = [row for row in rows if row[2] != ABSENT]
    table = Table(
        "Self-sensing", (Head("Quantity"), Head("Unit"), Head("Value", "n")), tuple(Row(r) for r in rows), query.shown(),
        below=f"The fit warns: {remark(fit['warnings'])}." if fit["warnings"] else "", kind="narrow",
    )  # fmt: skip
    cycles = draft.results.columns(Query(_CYCLES_SQL, {"specimen": draft.item}))
    strain, force = 100 * cycles["capacitive_strain"].astype(float), 1e3 * cycles["force_step_n"].astype(float)
    good = np.isfinite(strain) & np.isfinite(force)
    blocks: list[Block | Fold] = [table]
    slope = fit["force_per_capacitive_strain_n"]
    if good.any():
        kept = ~cycles["wrinkled"].astype(bool)[good]
        per_percent = None if slope is None else 10 * slope
        centre = float(np.mean(force[good][kept] - per_percent * strain[good][kept])) if slope and kept.any() else 0.0
        words = (
            f"{int(good.sum())} steps"
            if fit["r_squared"] is None
            else f"R² {significant(fit['r_squared'], 3)}, {int(good.sum())} steps"
        )
        figure = Figure(
            figures.sensing(strain[good], force[good], per_percent, centre, kept, alt=f"Force step against capacitive strain: {words}."),
            flow(bold("Force from capacitance."), f" {words}. Open: wrinkled, left out of the line."),
            draft.data("sensing", {"capacitive_strain_percent": strain[good], "force_step_mn": force[good], "used": kept.tolist()}),
        )  # fmt: skip
        everyone = draft.results.rows(Query("SELECT * FROM sensing_fits ORDER BY specimen_id"))
        drawn = comparing.agreement(draft, everyone[:12] if fit in everyone[:12] else [fit], draft.item)
        blocks.insert(0, figure if drawn is None else Pair((figure, drawn)))
    return Section("sensing", capital(sensing_finding(draft)) or "Self-sensing", "Self-sensing", tuple(blocks))
