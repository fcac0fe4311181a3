"""The part of a specimen's page about several temperatures: the master curve, its shifts, and whether it holds."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from reports.blocks import Block, Figure, Head, Pair, Row, Section, Table, Text, bold, filled, flow
from reports.figures import temperatures as figures
from reports.figures.temperatures import Points
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.words import remark
from schemas.arrays import Float
from schemas.numbers import NBSP, bounds, capital, counted, fixed, p_value, percent, significant, with_unit

_POINTS_SQL = """SELECT recording_id, temperature_c, frequency_hz, reduced_frequency_hz, time_s, reduced_time_s, storage, loss, tan_delta,
       curve_storage, curve_loss
FROM master_curve_points
WHERE specimen_id = $specimen
ORDER BY temperature_c, recording_id, frequency_hz, time_s"""
_SHIFTS_SQL = """SELECT temperature_c, recording_id, fixed, log10_a, log10_a_lower, log10_a_upper, b, b_lower, b_upper, magnitude_misfit,
       phase_misfit_deg, van_gurp_palmen_sd, p_value
FROM shift_factors
WHERE specimen_id = $specimen
ORDER BY temperature_c, recording_id"""
_LAWS_SQL = "SELECT * FROM shift_laws WHERE specimen_id = $specimen ORDER BY selected DESC, law"
_SERIES_SQL = """SELECT term, tau_s, stiffness_n_per_mm, share, modulus, unit
FROM prony_series
WHERE specimen_id = $specimen AND enough
ORDER BY term"""


def section(draft: Draft) -> Section | None:
    """The master curve of a specimen that was measured at several temperatures."""
    about = {"specimen": draft.item}
    found = draft.results.rows(Query("SELECT * FROM master_curves WHERE specimen_id = $specimen", about))
    if not found:
        return None
    curve = found[0]
    shifts = draft.results.rows(Query(_SHIFTS_SQL, about))
    laws = draft.results.rows(Query(_LAWS_SQL, about))
    data = draft.results.columns(Query(_POINTS_SQL, about))
    href = draft.data("master_curve", {n: v.tolist() if v.dtype == object else v for n, v in data.items()})
    turned, held = (_points(data, in_time=in_time) for in_time in (False, True))
    drawn = [_master(draft, curve, p, href, in_time=t) for p, t in ((turned, False), (held, True)) if p]
    drawn.append(_shifts(draft, curve, shifts, laws))
    if turned:
        drawn.append(_phases(draft, curve, turned, href))
    drawn.append(_misfits(draft, curve, shifts))
    blocks: list[Block] = [Pair(tuple(drawn[i : i + 2])) for i in range(0, len(drawn), 2)]
    if curve["warnings"]:
        blocks.insert(0, Text(flow(bold("Warning."), f" {capital(remark(curve['warnings']))}.")))
    blocks += [_law_table(laws), _shift_table(draft, shifts)]
    blocks += [Text(text) for text in _tell_returns(shifts)]
    if turned:
        blocks.append(_value_table(draft, curve, turned))
    series = _series_table(draft)
    if series is not None:
        blocks.append(series)
    return Section("master", _heading(curve, shifts), "Master curve", tuple(blocks))


def headline(draft: Draft) -> str:
    """`seven temperatures make one curve at 20.0 °C over 9.2 decades; WLF with C₁ 7.64 and C₂ 107.8 K`; empty without a curve."""
    about = {"specimen": draft.item}
    found = draft.results.rows(Query("SELECT * FROM master_curves WHERE specimen_id = $specimen", about))
    if not found:
        return ""
    text = _heading(found[0], draft.results.rows(Query(_SHIFTS_SQL, about)))
    law = next((law for law in draft.results.rows(Query(_LAWS_SQL, about)) if law["selected"]), None)
    said = text[0].lower() + text[1:]
    if law is None:
        return said
    if law["c1"] is None:
        return f"{said}; shifts by Arrhenius with {with_unit(significant(law['energy_kj_per_mol'], 3), 'kJ/mol')}"
    return f"{said}; WLF with C₁ {significant(law['c1'], 3)} and C₂ {with_unit(significant(law['c2_k'], 4), 'K')}"


def _heading(curve: Record, shifts: Sequence[Record]) -> str:
    meant = _distinct(shifts)
    number = counted(meant, "temperature")
    number += f" in {counted(len(shifts), 'sweep')}" if meant < len(shifts) else ""
    at = f"{fixed(curve['reference_c'], 1)}{NBSP}°C"
    failing = sum((s["p_value"] if s["p_value"] is not None else 1.0) * len(shifts) < 0.01 for s in shifts)
    if failing:
        return f"{capital(number)} make one curve at {at} but for more than noise at {counted(failing, 'of them', 'of them')}"
    span = ""
    if curve["frequency_low_hz"]:
        decades = np.log10(curve["frequency_high_hz"] / curve["frequency_low_hz"])
        span = f" over {significant(float(decades), 2)} decades"
    return f"{capital(number)} make one curve at {at}{span}"


_SAME_K = 1.0
"""Difference below which two sweeps are at one temperature, K."""


def _distinct(shifts: Sequence[Record]) -> int:
    """How many temperatures there are among sweeps, in the order of their temperatures."""
    warm = np.array([float(s["temperature_c"]) for s in shifts])
    return 1 + int((np.diff(warm) > _SAME_K).sum())


def _tell_returns(shifts: Sequence[Record]) -> list[str]:
    """Of each temperature that was measured twice, by how much the second sweep lies beside the first."""
    found = []
    for first, second in itertools.pairwise(shifts):
        apart = float(second["temperature_c"]) - float(first["temperature_c"])
        if apart > _SAME_K or first["log10_a"] is None or second["log10_a"] is None:
            continue
        beside = float(second["log10_a"]) - float(first["log10_a"])
        widths = [
            (float(s["log10_a_upper"]) - float(s["log10_a_lower"])) / 2 for s in (first, second) if not s["fixed"]
        ]
        limit = float(np.hypot.reduce(widths)) if widths else 0.0
        found.append(
            f"Two sweeps near {with_unit(fixed(float(first['temperature_c']), 1), '°C')}, {visible(short(first['recording_id'], 60))} and"
            f" {visible(short(second['recording_id'], 60))}, lie {significant(abs(beside), 2)} decades apart (95 % limit {significant(limit, 2)})"
            f" at temperatures that differ by {with_unit(significant(apart, 2), 'K')}."
        )
    return found


def _value_table(draft: Draft, curve: Record, found: Sequence[Points]) -> Table:
    """Storage, loss and their ratio on the common curve, at whole decades of the frequency within what was measured."""
    place = np.concatenate([p.place for p in found])
    order = np.argsort(place)
    place, storage, loss = (
        np.concatenate([getattr(p, n) for p in found])[order] for n in ("place", "curve_storage", "curve_loss")
    )
    rows = []
    for name, per in (("Hz", 1.0), ("rad/s", 2 * np.pi)):
        decades = np.arange(np.ceil(np.log10(place[0] * per)), np.floor(np.log10(place[-1] * per)) + 1)
        at = 10.0**decades / per
        stored, lost = (np.exp(np.interp(np.log(at), np.log(place), np.log(values))) for values in (storage, loss))
        rows += [
            Row((with_unit(significant(10.0**d, 1), name), significant(s, 3), significant(v, 3), significant(v / s, 3)))
            for d, s, v in zip(decades, stored, lost, strict=True)
        ]
    unit = curve["unit"] or ""
    heads = (Head("Frequency", "n"), Head(f"Storage, {unit}", "n"), Head(f"Loss, {unit}", "n"), Head("tan δ", "n"))
    at_reference = with_unit(fixed(curve["reference_c"], 1), "°C")
    below = f"At {at_reference}, read between the points of the common curve; beyond them it is not known."
    return Table(
        "Values of the master curve",
        heads,
        tuple(rows),
        Query(_POINTS_SQL, {"specimen": draft.item}).shown(),
        below=below,
        kind="narrow",
    )


def _points(data: dict[str, Float], *, in_time: bool) -> list[Points]:
    """The points of each recording, coldest first."""
    place = np.asarray(data["reduced_time_s" if in_time else "reduced_frequency_hz"], dtype=float)
    names = np.array([str(name) for name in data["recording_id"]])
    there = np.isfinite(place)
    found = []
    for name in dict.fromkeys(names[there]):
        rows = there & (names == name)
        columns = (np.asarray(data[c][rows], dtype=float) for c in ("storage", "loss", "curve_storage", "curve_loss"))
        found.append(Points(float(data["temperature_c"][rows][0]), place[rows], *columns))
    return sorted(found, key=lambda one: one.temperature)


def _master(draft: Draft, curve: Record, found: Sequence[Points], href: str, *, in_time: bool) -> Figure:
    who, at = short(draft.item, 40), f"{fixed(curve['reference_c'], 1)}{NBSP}°C"
    cold, hot = (f"{fixed(p.temperature, 1)}{NBSP}°C" for p in (found[0], found[-1]))
    words = f"{counted(len(found), 'temperature')} from {cold} (dark) to {hot} (light), shifted to {at}"
    return Figure(
        figures.master(
            found, curve["unit"] or "", in_time=in_time, alt=f"Master curve of {who} in {curve['unit']}: {words}."
        ),
        flow(
            bold("Master curve."),
            f" {capital(words)}; every second one open. Line: the common curve, a relaxation of any order.",
        ),
        href,
    )


def _shifts(draft: Draft, curve: Record, shifts: Sequence[Record], laws: Sequence[Record]) -> Figure:
    temperature, log_a, lower, upper = (
        np.array([np.nan if s[c] is None else s[c] for s in shifts], dtype=float)
        for c in ("temperature_c", "log10_a", "log10_a_lower", "log10_a_upper")
    )
    law = laws[0] if laws else None
    course = None if law is None else _course(law, np.linspace(temperature.min(), temperature.max(), 120))
    off = (
        ""
        if law is None
        else f" Line: {law['law']}, off by {significant(law['off_decades'], 2)} decades (root mean square)."
    )
    return Figure(
        figures.shifts(
            temperature, log_a, lower, upper, course, "" if law is None else str(law["law"]),
            alt=f"Shifts of {short(draft.item, 40)}, log10 a from {significant(float(log_a.max()), 3)} to {significant(float(log_a.min()), 3)}.",
        ),
        flow(bold("Shifts."), f" With 95{NBSP}% limits, where these are wider than the dots.{off}"),
        draft.data("shifts", {"temperature_c": temperature, "log10_a": log_a, "lower": lower, "upper": upper}),
    )  # fmt: skip


def _course(law: Record, temperature: Float) -> tuple[Float, Float]:
    """log10 a by a law at temperatures (n,) °C."""
    reference = law["reference_c"]
    if law["c1"] is not None:
        rise = temperature - reference
        return temperature, -law["c1"] * rise / (law["c2_k"] + rise)
    inverse = 1 / (temperature + 273.15) - 1 / (reference + 273.15)
    return temperature, 1e3 * law["energy_kj_per_mol"] / 8.314462618 * inverse / np.log(10)


def _phases(draft: Draft, curve: Record, found: Sequence[Points], href: str) -> Figure:
    return Figure(
        figures.phase_over_magnitude(
            found, curve["unit"] or "", alt=f"Phase over magnitude of {short(draft.item, 40)} at {len(found)} temperatures."
        ),
        flow(
            bold("Phase over magnitude."),
            " No horizontal shift changes it: where the superposition holds, all temperatures lie on one curve (van Gurp and"
            " Palmen). Line: the common curve.",
        ),
        href,
    )  # fmt: skip


def _misfits(draft: Draft, curve: Record, shifts: Sequence[Record]) -> Figure:
    temperature = np.array([s["temperature_c"] for s in shifts], dtype=float)
    misfit = 100 * np.array([s["magnitude_misfit"] for s in shifts], dtype=float)
    noise = 100 * float(curve["magnitude_noise"])
    worst = int(np.argmax(misfit))
    words = f"at most {significant(float(misfit[worst]), 2)}{NBSP}% of the magnitude, at {fixed(float(temperature[worst]), 1)}{NBSP}°C"
    return Figure(
        figures.misfits(temperature, misfit, noise, "Off the common curve, %", alt=f"Off the common curve: {words}."),
        flow(
            bold("What is left."),
            f" {capital(words)} (root mean square). Dashed: what a curve of its own leaves of each.",
        ),
        draft.data("misfits", {"temperature_c": temperature, "magnitude_misfit_percent": misfit}),
    )


def _law_table(laws: Sequence[Record]) -> Table:
    heads = (
        Head("Law"), Head("C₁ (95 %)", "n"), Head("C₂ (95 %), K", "n"), Head("E (95 %), kJ/mol", "n"), Head("Off, decades", "n"),
        Head("p, shifts' errors alone", "n"),
    )  # fmt: skip
    rows = tuple(
        Row(
            (
                f"{law['law']}{' ✓' if law['selected'] else ''}",
                *(_bounded(law, name) for name in ("c1", "c2_k", "energy_kj_per_mol")),
                significant(law["off_decades"], 2),
                p_value(law["p_value"]),
            ),
            "sel" if law["selected"] else "",
        )
        for law in laws
    )
    kept, shown = filled(heads, rows)
    reference = with_unit(fixed(laws[0]["reference_c"], 1), "°C") if laws else ""
    below = (
        f"At {reference}. Limits by the profile of χ² over all shifts, whose errors are shared; what a law leaves beyond them widens"
        " the limits. ✓: describes the shifts better."
    )
    return Table("Laws of the shifts", kept, shown, Query(_LAWS_SQL).shown(), below=below, kind="narrow")


def _bounded(row: Record, name: str) -> str:
    return "" if row[name] is None else bounds(row[name], row[f"{name}_lower"], row[f"{name}_upper"])


def _shift_table(draft: Draft, shifts: Sequence[Record]) -> Table:
    heads = (
        Head("°C"), Head("log₁₀ a (95 %)", "n"), Head("b (95 %)", "n"), Head("Off, magnitude", "n"), Head("Off, phase", "n"),
        Head("Beside phase over magnitude, SD", "n"), Head("p, noise alone", "n"),
    )  # fmt: skip
    free = any(s["b"] != 1 for s in shifts)
    rows = tuple(
        Row(
            (
                fixed(s["temperature_c"], 1),
                "0" if s["fixed"] else bounds(s["log10_a"], s["log10_a_lower"], s["log10_a_upper"]),
                "" if not free else "1" if s["fixed"] else bounds(s["b"], s["b_lower"], s["b_upper"]),
                percent(s["magnitude_misfit"]),
                "" if s["phase_misfit_deg"] is None else f"{significant(s['phase_misfit_deg'], 2)}°",
                "" if s["van_gurp_palmen_sd"] is None else significant(s["van_gurp_palmen_sd"], 2),
                p_value(s["p_value"]),
            ),
            "sel" if s["fixed"] else "",
        )
        for s in shifts
    )
    kept, shown = filled(heads, rows)
    return Table("Shifts by temperature", kept, shown, Query(_SHIFTS_SQL, {"specimen": draft.item}).shown())


def _series_table(draft: Draft) -> Table | None:
    query = Query(_SERIES_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    unit = next((r["unit"] for r in found if r["unit"]), None)
    heads = (Head("Term"), Head("τ, s", "n"), Head(f"{unit or 'N/mm'}", "n"), Head("Share", "n"))
    rows = tuple(
        Row(
            (
                "spring" if r["term"] == 0 else str(r["term"]),
                "" if r["tau_s"] is None else significant(r["tau_s"]),
                significant(r["modulus"] if unit else r["stiffness_n_per_mm"]),
                percent(r["share"]),
            )
        )
        for r in found
    )
    below = "The least number of arms of which one more is no significant gain at 1 %; other numbers are in the table prony_series."
    return Table("Prony series of the master curve", heads, rows, query.shown(), below=below, kind="narrow")
