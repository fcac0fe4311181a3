"""The part of a campaign's page about the law of life of the film itself, and each layout as the others predict it."""

from __future__ import annotations

from collections.abc import Sequence

from reports.blocks import Block, Head, Row, Table, Text, bold, flow
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
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
    return [_law(laws[0]), _table(query, draft.results.rows(query))]


def _law(law: Record) -> Text:
    if law["life_s"] is None:
        return Text(flow(bold("Life from the film."), f" No law: {visible(law['warnings'] or 'no reason was kept')}."))
    life, exponent, shape = (
        bounds(law[name], law[f"{name}_lower"], law[f"{name}_upper"]) for name in ("life_s", "exponent", "shape")
    )
    return Text(
        flow(
            bold("Life from the film."),
            f" Each mm² by its own field, the weakest one first, from {law['failures']} failures in the film of all layouts:"
            f" 1 mm² lives {life} s at {significant(law['reference_mv_per_m'])} MV/m, life over field has the exponent"
            f" {exponent}, Weibull shape {shape}. Assumed: {visible(law['warnings'] or 'nothing')}.",
        )
    )


def _table(query: Query, rows: Sequence[Record]) -> Table:
    made = []
    for r in rows:
        if r["predicted_median_s"] is None:
            reason = f"no prediction: {visible(r['warnings'] or 'no reason was kept')}"
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
