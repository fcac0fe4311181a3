"""The parts of a campaign's page about laws of life: distributions, life against voltage, competing causes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Row, Section, Table, bold, flow
from reports.figures import palette
from reports.figures.survival import VoltageLife, against_voltage
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.words import plain, remark
from schemas.arrays import Float
from schemas.numbers import ABSENT, NBSP, bounds, capital, compact, p_equals, p_value, significant

_LAW_SQL = """SELECT configuration, specimens, failures, exponent, exponent_lower, exponent_upper, sigma, sigma_lower, sigma_upper,
       p_value, holds, statement, warnings
FROM voltage_life
WHERE campaign = $campaign
ORDER BY configuration"""
_RESIDUAL_SQL = """SELECT configuration, voltage_kv, specimens, failures, scale_s, law_scale_s, residual, standardised_residual,
       p_value_without
FROM voltage_residuals
WHERE campaign = $campaign
ORDER BY configuration, voltage_kv"""


def voltage_life(draft: Draft, unit: tuple[float, str]) -> Section | None:
    """Does an inverse power law connect the voltages?"""
    query = Query(_LAW_SQL, {"campaign": draft.item})
    laws = draft.results.rows(query)
    if not laws:
        return None
    residual_query = Query(_RESIDUAL_SQL, {"campaign": draft.item})
    residuals = draft.results.rows(residual_query)
    blocks: list[Block | Fold] = []
    drawn = _drawn(laws, residuals, unit[0])
    if drawn:
        words = "; ".join(remark(law["statement"]) for law in laws if law["statement"])
        blocks.append(
            Figure(
                against_voltage(drawn, unit[1], alt=f"Life against voltage. {words}"),
                flow(
                    bold("Life against voltage."),
                    f" {capital(words)}. Below the lowest voltage tested the law is an extrapolation.",
                ),
                draft.data("voltage_life", {n: [r[n] for r in residuals] for n in residuals[0]}),
            )
        )
    blocks.append(_law_table(query, laws))
    if residuals:
        blocks.append(_residual_table(residual_query, residuals, unit))
    return Section("voltage", _law_heading(laws), "Life against voltage", tuple(blocks))


def headline(draft: Draft) -> str:
    """Whether the inverse power law connects the voltages; empty where there is nothing to say."""
    laws = draft.results.rows(Query(_LAW_SQL, {"campaign": draft.item}))
    return _law_heading(laws) if any(law["holds"] is not None for law in laws) else ""


def _drawn(laws: Sequence[Record], residuals: Sequence[Record], factor: float) -> list[VoltageLife]:
    found = []
    for i, law in enumerate(laws):
        rows = [
            r for r in residuals if r["configuration"] == law["configuration"] and r["scale_s"] and r["law_scale_s"]
        ]
        if len(rows) > 1:

            def real(column: str, rows: list[Record] = rows) -> Float:
                return np.array([np.nan if r[column] is None else r[column] for r in rows], dtype=float)

            found.append(
                VoltageLife(
                    law["configuration"] or "", palette.group(i), real("voltage_kv"), factor * real("scale_s"), factor * real("law_scale_s"),
                    real("standardised_residual"),
                )
            )  # fmt: skip
    return found


def _law_heading(laws: Sequence[Record]) -> str:
    tested = [law for law in laws if law["holds"] is not None]
    if not tested:
        return "Life against voltage"
    broken = [law for law in tested if not law["holds"]]
    if broken:
        worst = min(broken, key=lambda law: law["p_value"] if law["p_value"] is not None else 1.0)
        return f"The inverse power law fails ({p_equals(worst['p_value'])})"
    return "The inverse power law holds"


def _law_table(query: Query, laws: Sequence[Record]) -> Table:
    rows = tuple(
        Row(
            (
                short(r["configuration"] or ABSENT, 60), str(r["specimens"]), str(r["failures"]),
                bounds(r["exponent"], r["exponent_lower"], r["exponent_upper"]), bounds(r["sigma"], r["sigma_lower"], r["sigma_upper"]),
                p_value(r["p_value"]), remark("; ".join(t for t in (r["statement"], r["warnings"]) if t)),
            )
        )
        for r in laws
    )  # fmt: skip
    heads = (
        Head("Configuration"), Head("Specimens", "n"), Head("Failed", "n"), Head("Exponent", "n"), Head("Scatter of ln t", "n"),
        Head("p of the law", "n"), Head("In words", "text"),
    )  # fmt: skip
    return Table("Inverse power law with Weibull scatter", heads, rows, query.shown(), "95 % intervals in brackets")


def _residual_table(query: Query, residuals: Sequence[Record], unit: tuple[float, str]) -> Table:
    rows = tuple(
        Row(
            (
                f"{short(r['configuration'] or '', 40)}, {compact(r['voltage_kv'])}{NBSP}kV", f"{r['failures']} of {r['specimens']}",
                _times(r["scale_s"], unit[0]), _times(r["law_scale_s"], unit[0]), significant(r["standardised_residual"], 2), p_value(r["p_value_without"]),
            )
        )
        for r in residuals
    )  # fmt: skip
    heads = (
        Head("Voltage"), Head("Failed", "n"), Head(f"Scale, {unit[1]}", "n"), Head(f"By the law, {unit[1]}", "n"), Head("Off the law, SD", "n"),
        Head("p of the law without it", "n"),
    )  # fmt: skip
    return Table("Each voltage against the law", heads, rows, query.shown(), kind="narrow")


def _times(value: float | None, factor: float) -> str:
    return significant(None if value is None else factor * value)


_FIT_SQL = """SELECT configuration, voltage_kv, distribution, parameter, "value", lower_95, upper_95, aic, p_value, statement
FROM lifetime_distributions
WHERE campaign = $campaign
ORDER BY configuration, voltage_kv, aic, distribution, parameter"""
_LAWS = {"weibull": "Weibull"}
_PARAMETERS = {"scale_s": "scale, s", "mean_s": "mean, s", "median_s": "median, s", "log_sd": "SD of ln t"}


def distributions(draft: Draft) -> Fold | None:
    """The distributions that were fitted to each group, the best first."""
    query = Query(_FIT_SQL, {"campaign": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                f"{short(r['configuration'] or '', 40)}, {compact(r['voltage_kv'])}{NBSP}kV", _LAWS.get(r["distribution"], visible(r["distribution"] or "")),
                _PARAMETERS.get(r["parameter"], plain(r["parameter"] or "")), bounds(r["value"], r["lower_95"], r["upper_95"]), compact(r["aic"], 4),
                p_value(r["p_value"]), remark(r["statement"]),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Group"), Head("Distribution"), Head("Parameter"), Head("Value", "n"), Head("AIC", "n"), Head("p of the fit", "n"),
        Head("In words", "text"),
    )  # fmt: skip
    table = Table(
        "Distributions of the lifetimes",
        heads,
        rows,
        query.shown(),
        "95 % intervals in brackets; smaller AIC is better",
        kind="wide",
    )
    return Fold("Distributions fitted to the lifetimes", (table,))
