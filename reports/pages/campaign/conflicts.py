"""The part of a campaign's page about numbers of the thesis that contradict each other, each checked on these recordings.

The numbers of the thesis are those of its section 5.4.1: 0.044 N and 0.25 pF of 28.6 pF at 8 kV, 0.115 N and 2.4 % at 11 kV,
on a film of 50 mm × 1 mm stretched by 1.5 (w h = 33.3 mm²), with l_tot = 75 mm and l_AR = 20 mm.
"""

from __future__ import annotations

import math

from reports.blocks import Head, Piece, Row, Section, Table, Text, equation
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import NBSP, bounds, joined, pm, significant

_SECTION_MM2, _TOTAL_MM, _ACTIVE_MM = 50.0 / 1.5, 75.0, 20.0
_FORCE_8, _FORCE_11 = 0.044, 0.115
_STRAIN_8, _STRAIN_11 = 0.25 / 28.6, 0.024
_SQL = """SELECT f.*
FROM sensing_fits AS f
WHERE f.specimen_id IN (SELECT specimen_id FROM recordings WHERE campaign = $item)
ORDER BY f.specimen_id"""
_SIGN_SQL = """SELECT l.specimen_id, f.sensing_region, l.error_sign, count(*) AS loops
FROM loop_responses AS l JOIN sensing_fits AS f USING (specimen_id)
WHERE l.error_sign IS NOT NULL AND l.specimen_id IN (SELECT specimen_id FROM recordings WHERE campaign = $item)
GROUP BY ALL
ORDER BY l.specimen_id"""
_GEOMETRY_SQL = """SELECT specimen_id, any_value(TRY_CAST(metadata ->> '$.recording.total_length_mm' AS DOUBLE)) AS total_mm,
       any_value(TRY_CAST(metadata ->> '$.recording.active_length_mm' AS DOUBLE)) AS active_mm
FROM recordings
WHERE campaign = $item AND specimen_id IS NOT NULL
GROUP BY specimen_id"""


def section(draft: Draft) -> Section | None:
    """Numbers of the thesis that cannot both be right, with what these recordings say."""
    query = Query(_SQL, {"item": draft.item})
    fits = [r for r in draft.results.rows(query) if r["sensing_region"] == "separate"]
    if not fits:
        return None
    signs = draft.results.rows(Query(_SIGN_SQL, {"item": draft.item}))
    rows = [r for r in (_factor(draft, fits), _sign(fits, signs), _exponent(fits)) if r is not None]
    if not rows:
        return None
    heads = (Head("Where"), Head("Printed", "text"), Head("Its own numbers", "text"), Head("These recordings", "text"))
    table = Table(
        "Numbers of the thesis that contradict each other", heads, tuple(rows), query.shown(),
        below="Checked on every specimen with a sensing region of its own; ± is one standard deviation.", kind="wide",
    )  # fmt: skip
    words = {1: "One statement", 2: "Two statements", 3: "Three statements"}[len(rows)]
    text = "The corrected forms are used throughout; the fits do not depend on the printed ones."
    heading = f"{words} of the thesis do{'es' if len(rows) == 1 else ''} not hold"
    return Section("conflicts", heading, "Against the thesis", (table, Text(text, "sub")))


def _factor(draft: Draft, fits: list[Record]) -> Row | None:
    """Eq 5.16: with its factor the film would be three times softer than mechanical tests find it."""
    lengths = {r["specimen_id"]: r for r in draft.results.rows(Query(_GEOMETRY_SQL, {"item": draft.item}))}
    printed = _TOTAL_MM / _ACTIVE_MM - 1
    without = [f / s / _SECTION_MM2 for f, s in ((_FORCE_8, _STRAIN_8), (_FORCE_11, _STRAIN_11))]
    parts = []
    for r in fits:
        if r["modulus_mpa"] is None or r["nonlinearity"] is None:
            continue
        text = f"{short(r['specimen_id'], 20)}: {pm(r['modulus_mpa'], r['modulus_mpa_sd'], 'MPa')}"
        size = lengths.get(r["specimen_id"])
        if size is not None and size["active_mm"] and size["total_mm"] and size["total_mm"] > size["active_mm"]:
            factor = size["total_mm"] / size["active_mm"] - 1
            text += f", with the factor {pm(r['modulus_mpa'] / factor, r['modulus_mpa_sd'] / factor)}"
        if r["mechanical_modulus_mpa"] is not None:
            text += f"; mechanically {pm(r['mechanical_modulus_mpa'], r['mechanical_modulus_mpa_sd'], 'MPa')}"
            text += f", ratio {_limits(r, 'modulus_ratio')}"
        parts.append(text)
    if not parts:
        return None
    return Row(
        (
            "Eq 5.16",
            equation(
                "ΔF = w h Y (l_tot/l_AR − 1)(1 − λ_cap). The factor must not be there: load cell and sensing region carry the same"
                " tension."
            ),
            f"Without it {significant(without[0])} and {significant(without[1])}{NBSP}MPa (8 and 11{NBSP}kV), near the"
            f" 0.16{NBSP}MPa of its chapter 4; with it {significant(without[0] / printed, 2)} and"
            f" {significant(without[1] / printed, 2)}{NBSP}MPa.",
            _sentences(parts),
        )
    )


def _sign(fits: list[Record], signs: list[Record]) -> Row | None:
    """Eq 5.17 and 5.18: the error must be C − C_d where a voltage lowers the capacitance."""
    separate = [r for r in signs if r["sensing_region"] == "separate"]
    if not separate:
        return None
    right = sum(r["loops"] for r in separate if r["error_sign"] == 1)
    wrong = sum(r["loops"] for r in separate if r["error_sign"] == -1)
    names = joined(list(dict.fromkeys(short(r["specimen_id"], 20) for r in separate)))
    text = (
        f"{names}: in {right} of {right + wrong} loops the voltage rose because the capacitance was above its demand."
    )
    shared = [r for r in signs if r["sensing_region"] == "active" and r["error_sign"] == -1]
    if shared:
        text += (
            f" One region for both ({joined([short(r['specimen_id'], 20) for r in shared])}) needs the printed sign."
        )
    return Row(
        (
            "Eq 5.17, 5.18",
            equation("V = K_p E + K_i ∫E with E = C_d − C and positive gains."),
            equation(
                f"Its figure 5-6 raises the voltage while C is above C_d. And K_p = 10{NBSP}V/pF with K_i = 2{NBSP}V/pF/s give"
                f" 0.75{NBSP}kV at once and 0.15{NBSP}kV/s for 0.05{NBSP}pF: not the 8.5{NBSP}kV within 0.5{NBSP}s that it shows."
            ),
            text,
        )
    )


def _exponent(fits: list[Record]) -> Row | None:
    """Section 5.4.1: two figures give a force that grows with V to the power 3."""
    known = [r for r in fits if r["force_exponent"] is not None and r["nonlinearity"] is not None]
    if not known:
        return None
    printed = math.log(_FORCE_11 / _FORCE_8) / math.log(11 / 8)
    strain = math.log(_STRAIN_11 / _STRAIN_8) / math.log(11 / 8)
    parts = [f"{short(r['specimen_id'], 20)}: V to the power {_limits(r, 'force_exponent')}" for r in known]
    return Row(
        (
            "Section 5.4.1",
            "Maxwell stress: force and strain grow with V².",
            f"{1e3 * _FORCE_8:g} and {1e3 * _FORCE_11:g}{NBSP}mN at 8 and 11{NBSP}kV: V to the power"
            f" {significant(printed, 2)}, strain {significant(strain, 2)}. The values come from two figures: a lead, no proof.",
            _sentences(parts),
        )
    )


def _limits(row: Record, name: str) -> str:
    return bounds(*(row[f"{name}{end}"] for end in ("", "_lower", "_upper")))


def _sentences(parts: list[str]) -> Piece:
    return ". ".join(parts) + "."
