"""The part of a campaign's page about the law of life of the film itself, and each layout as the others predict it."""

from __future__ import annotations

from collections.abc import Sequence

from reports.blocks import Block, Head, Row, Table, Text, bold, flow
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.words import remark
from schemas.numbers import ABSENT, bounds, percent, significant

_LAW_SQL = """SELECT layouts, failures, reference_mv_per_m, life_s, life_s_lower, life_s_upper, exponent, exponent_lower,
       exponent_upper, shape, shape_lower, shape_upper, warnings
FROM film_lives
WHERE campaign = $campaign"""
_PREDICTED_SQL = """SELECT configuration, voltage_kv, fitted_on, specimens, predicted_median_s, predicted_median_s_low,
       predicted_median_s_high, observed_median_s, end_s, predicted_failed, predicted_failed_low, predicted_failed_high,
       observed_failed, within, warnings
FROM film_life_predictions
WHERE campaign = $campaign
ORDER BY configuration, voltage_kv"""


def blocks(draft: Draft) -> list[Block]:
    """Nothing where the film of two layouts is not known."""
    laws = draft.results.rows(Query(_LAW_SQL, {"campaign": draft.item}))
    if not laws:
        return []
    query = Query(_PREDICTED_SQL, {"campaign": draft.item})
    designs = _designs(draft)
    return [_law(laws[0]), _table(query, draft.results.rows(query)), *([] if designs is None else [designs])]


_DESIGN_SQL = """SELECT configuration, design, gap_mm, inset_mm, covered_share, relative_force, voltage_ratio, life_ratio,
       life_ratio_lower, life_ratio_upper, thinnest
FROM electrode_designs
WHERE campaign = $campaign
ORDER BY configuration, list_position(['rectangles', 'shaped', 'any shape'], design)"""


def _designs(draft: Draft) -> Table | None:
    """Electrodes that would live longer at the same force."""
    query = Query(_DESIGN_SQL, {"campaign": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                short(r["configuration"] or ABSENT, 60), r["design"], significant(r["gap_mm"]), significant(r["inset_mm"]),
                percent(r["covered_share"]), significant(r["relative_force"]), significant(r["voltage_ratio"]),
                bounds(r["life_ratio"], r["life_ratio_lower"], r["life_ratio_upper"]), significant(r["thinnest"]),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Configuration"), Head("Design"), Head("From rods, mm", "n"), Head("From ends, mm", "n"), Head("Covers", "n"),
        Head("Force ×", "n"), Head("Voltage ×", "n"), Head("Life × (90 %)", "n"), Head("Thinnest", "n"),
    )  # fmt: skip
    below = (
        "Against the electrodes that the configuration has: force at equal voltage, voltage and median life at equal force, by the law"
        " of the film’s life with its limits. Shaped electrodes follow the outline of film that is thick enough; any shape is the"
        " bound. Force counts film between the rods as equally stiff. The command layout writes the outlines as SVG and CSV."
    )
    return Table(
        "Electrodes that would live longer at the same force", heads, rows, query.shown(), below=below, kind="wide"
    )


def _law(law: Record) -> Text:
    if law["life_s"] is None:
        return Text(flow(bold("Life from the film."), f" No law: {remark(law['warnings'] or 'no reason was kept')}."))
    life, exponent, shape = (
        bounds(law[name], law[f"{name}_lower"], law[f"{name}_upper"]) for name in ("life_s", "exponent", "shape")
    )
    return Text(
        flow(
            bold("Life from the film."),
            f" Each mm² by its own field, the weakest one first, from {law['failures']} failures in the film of all layouts:"
            f" 1 mm² lives {life} s at {significant(law['reference_mv_per_m'])} MV/m, life over field has the exponent"
            f" {exponent}, Weibull shape {shape}. Assumed: {remark(law['warnings'] or 'nothing')}.",
        )
    )


def _table(query: Query, rows: Sequence[Record]) -> Table:
    made = []
    for r in rows:
        if r["predicted_median_s"] is None:
            reason = f"no prediction: {remark(r['warnings'] or 'no reason was kept')}"
            made.append(Row((short(r["configuration"] or ABSENT, 60), *[ABSENT] * 5, reason)))
            continue
        median = bounds(r["predicted_median_s"], r["predicted_median_s_low"], r["predicted_median_s_high"])
        failed = bounds(r["predicted_failed"], r["predicted_failed_low"], r["predicted_failed_high"], 100.0)
        observed = "not reached" if r["observed_median_s"] is None else significant(r["observed_median_s"])
        made.append(
            Row(
                (
                    short(r["configuration"] or ABSENT, 60), significant(r["voltage_kv"]), median, observed, failed,
                    percent(r["observed_failed"]), "yes" if r["within"] else "no",
                )
            )
        )  # fmt: skip
    heads = (
        Head("Configuration"), Head("Voltage, kV", "n"), Head("Median predicted, s", "n"), Head("Found", "n"),
        Head("Failed predicted, %", "n"), Head("Found", "n"), Head("Within"),
    )  # fmt: skip
    below = (
        "Each layout by the law that the lives of the others give, as if it had never been tested; limits hold the median, or"
        " the share failed by the end of the test, of a sample as large as that tested in 90 %."
    )
    return Table("Layouts as the film of the others predicts them", heads, tuple(made), query.shown(), below=below)
