"""The parts of a campaign's page about causes of failure that compete: how each grows, and where it ends."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from reports.blocks import Figure, Head, Row, Table, bold, flow
from reports.figures import palette
from reports.figures.life_models import Incidence
from reports.figures.life_models import incidence as draw_incidence
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.arrays import Float
from schemas.numbers import NBSP, bounds, capital, compact, digits, percent

_COURSE_SQL = """SELECT configuration, voltage_kv, failure_site, time_s, failures, probability, lower_95, upper_95
FROM failure_causes
WHERE campaign = $campaign
ORDER BY configuration, voltage_kv, failure_site, time_s"""
_CAUSE_SQL = """SELECT configuration, voltage_kv, failure_site, sum(failures) AS failed, max_by(probability, time_s) AS probability,
       max_by(lower_95, time_s) AS lower_95, max_by(upper_95, time_s) AS upper_95
FROM failure_causes
WHERE campaign = $campaign
GROUP BY configuration, voltage_kv, failure_site
ORDER BY configuration, voltage_kv, failed DESC, failure_site"""
_MOST_PANELS = 3


def incidence(
    draft: Draft, factor: float, labels: Mapping[tuple[str | None, float | None], str], time_title: str
) -> Figure | None:
    """Cumulative incidence of each cause, in the groups in which several compete."""
    query = Query(_COURSE_SQL, {"campaign": draft.item})
    rows = draft.results.rows(query)
    groups = list(dict.fromkeys((r["configuration"], r["voltage_kv"]) for r in rows))
    of = {key: [r for r in rows if (r["configuration"], r["voltage_kv"]) == key] for key in groups}
    several = [key for key in groups if len({r["failure_site"] for r in of[key]}) > 1]
    if not several:
        return None
    several.sort(key=lambda key: -sum(r["failures"] or 0 for r in of[key]))
    shown = several[:_MOST_PANELS]
    names = sorted({r["failure_site"] or "unknown" for key in shown for r in of[key]})
    drawn = [
        (
            labels.get(key, ""),
            [
                # The groups' own colours stand in the figures beside: a cause has another one.
                _course(of[key], name, palette.group(len(labels) + i), factor)
                for i, name in enumerate(names)
                if _named(of[key], name)
            ],
        )
        for key in shown
    ]
    ends = "; ".join(
        f"{name}: " + ", ".join(f"{one.cause} {percent(float(one.probability[-1]))}" for one in causes)
        for name, causes in drawn
    )
    left = (
        f" {capital(digits(len(several) - len(shown), 'other group is', 'other groups are'))} in the table below."
        if len(several) > len(shown)
        else ""
    )
    return Figure(
        draw_incidence(drawn, time_title, alt=f"Cumulative incidence by cause. {ends}."),
        flow(
            bold("Causes compete."),
            f" Probability of having failed by each (Aalen–Johansen), with 95 % bands: {ends}.{left}",
        ),
        draft.data("incidence", {n: [r[n] for r in rows] for n in rows[0]}),
    )


def _named(rows: list[Record], cause: str) -> bool:
    return any((r["failure_site"] or "unknown") == cause for r in rows)


def _course(rows: list[Record], cause: str, group: palette.Group, factor: float) -> Incidence:
    own = [r for r in rows if (r["failure_site"] or "unknown") == cause]

    def real(column: str) -> Float:
        return np.array([np.nan if r[column] is None else r[column] for r in own], dtype=float)

    return Incidence(cause, group, factor * real("time_s"), real("probability"), real("lower_95"), real("upper_95"))


def at_end(draft: Draft) -> Table | None:
    """Probability of having failed by each cause at the end of the test; causes compete."""
    query = Query(_CAUSE_SQL, {"campaign": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                f"{short(r['configuration'] or '', 40)}, {compact(r['voltage_kv'])}{NBSP}kV", visible(r["failure_site"] or "unknown"),
                str(r["failed"] or 0), bounds(r["probability"], r["lower_95"], r["upper_95"], 100.0),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Group"),
        Head("Cause"),
        Head("Failures", "n"),
        Head("Probability, % (95 %)", "n"),
    )
    below = "Aalen–Johansen: the causes compete, so their probabilities and survival add up to one."
    return Table(
        "Probability of failing by each cause, by the end of the test",
        heads,
        rows,
        query.shown(),
        below=below,
        kind="narrow",
    )
