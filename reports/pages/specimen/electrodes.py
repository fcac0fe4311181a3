"""The parts of a specimen's page about its sensing electrode: how coats cover it, from which cycle on it migrates."""

from __future__ import annotations

import numpy as np

from reports.blocks import Figure, Head, Row, Section, Table, bold, flow
from reports.figures import sensing as figures
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.words import remark
from schemas.numbers import NBSP, bounds, capital, compact, counted_bounds, p_equals, percent, pm, significant


def coverage(draft: Draft) -> Section | None:
    """How many coats does it take?"""
    query = Query(
        "SELECT coats, capacitance_pf, capacitance_pf_sd, recording_id\nFROM electrode_coats\nWHERE specimen_id = $specimen\n"
        "ORDER BY coats, recording_id",
        {"specimen": draft.item},
    )
    found = draft.results.columns(query)
    if not found["coats"].size:
        return None
    number, capacitance = found["coats"].astype(float), found["capacitance_pf"].astype(float)
    fits = draft.results.rows(
        Query("SELECT * FROM coverage_fits WHERE specimen_id = $specimen", {"specimen": draft.item})
    )
    fit = fits[0] if fits else None
    heading = f"{capital(compact(number.max()))} coats reach {significant(capacitance[-1])}{NBSP}pF"
    words, full, cover = "No fit: fewer than six numbers of coats.", None, None
    if fit is not None:
        full = (fit["full_pf"], fit["full_pf_lower"], fit["full_pf_upper"])
        cover = fit["coats_to_cover"]
        heading = f"{_coats(fit)} coats cover 99{NBSP}% of the electrode"
        words = (
            f"The first coat covers {percent(fit['first_share'])}; covered, the region has {bounds(*full)}{NBSP}pF."
            f" Likeliest form: {visible(fit['form'])}."
        )
        if fit["warnings"]:
            words += f" {capital(remark(fit['warnings']))}."
    figure = Figure(
        figures.coats(number, capacitance, full, cover, alt=f"Capacitance of {short(draft.item, 40)} over its coats. {words}"),
        flow(bold("Electrode coverage."), f" {words} Band: 95{NBSP}% limits."),
        draft.data("coats", found),
    )  # fmt: skip
    rows = tuple(
        Row((str(int(n)), pm(c, sd)))
        for n, c, sd in zip(number, capacitance, found["capacitance_pf_sd"].astype(float), strict=True)
    )
    table = Table("Coats", (Head("Coats", "n"), Head("Capacitance, pF", "n")), rows, query.shown(), kind="narrow")
    return Section("coats", heading, "Electrode coverage", (figure, table))


def _coats(fit: dict[str, float]) -> str:
    lower, upper = max(fit["coats_to_cover_lower"], 1.0), fit["coats_to_cover_upper"]
    return f"{round(fit['coats_to_cover'])} ({round(lower)} to {round(upper)})"


def migration(draft: Draft) -> Section | None:
    """Does the wave of the capacitance stay as it is?"""
    query = Query(
        "SELECT recording_id, cycles, onset_cycle, onset_cycle_lower, onset_cycle_upper, p_value, distortion_before,\n"
        "       distortion_after, warnings\nFROM electrode_migrations\nWHERE specimen_id = $specimen\nORDER BY recording_id",
        {"specimen": draft.item},
    )
    found = draft.results.rows(query)
    if not found:
        return None
    drawn = []
    for r in found[:2]:
        wave = draft.results.columns(
            Query(
                "SELECT cycle, distortion, second_harmonic, third_harmonic FROM electrode_cycles"
                " WHERE recording_id = $recording ORDER BY cycle",
                {"recording": r["recording_id"]},
            )
        )
        lines = [
            (name, 100 * wave[column].astype(float))
            for name, column in (("all", "distortion"), ("second", "second_harmonic"), ("third", "third_harmonic"))
            if np.isfinite(wave[column].astype(float)).any()
        ]
        onset = None
        if r["onset_cycle"] is not None:
            onset = (r["onset_cycle"], r["onset_cycle_lower"], r["onset_cycle_upper"])
        words = (
            f"{short(r['recording_id'], 40)}: {percent(r['distortion_before'])} of the fundamental before,"
            f" {percent(r['distortion_after'])} at the end."
        )
        drawn.append(
            Figure(
                figures.migration(wave["cycle"].astype(float), lines, onset, alt=f"Harmonics of the capacitance by cycle. {words}"),
                flow(bold("Wave of the capacitance."), f" {words}"),
                draft.data(f"cycles_{r['recording_id']}", wave),
            )
        )  # fmt: skip
    rows = tuple(
        Row(
            (
                draft.site.recording(r["recording_id"]),
                str(r["cycles"]),
                counted_bounds(r["onset_cycle"], r["onset_cycle_lower"], r["onset_cycle_upper"]),
                p_equals(r["p_value"]),
                percent(r["distortion_before"]),
                percent(r["distortion_after"]),
            )
        )
        for r in found
    )
    heads = (
        Head("Recording"),
        Head("Cycles", "n"),
        Head("Onset, cycle", "n"),
        Head("No change", "n"),
        Head("Before", "n"),
        Head("At the end", "n"),
    )
    below = "Before, at the end: harmonics over the fundamental. Onset with its 95 % limits; – where the wave does not change."
    table = Table("Electrode migration", heads, rows, query.shown(), below=below)
    first = next((r for r in found if r["onset_cycle"] is not None), None)
    heading = (
        f"The capacitance keeps its wave over {max(r['cycles'] for r in found)} cycles"
        if first is None
        else f"The electrode migrates from cycle {round(first['onset_cycle'])} on"
    )
    return Section("migration", heading, "Electrode migration", (*drawn, table))
