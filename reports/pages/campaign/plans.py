"""The part of a campaign's page about what to test next: plans for a narrower interval of the life at use."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Pair, Row, Section, Table, Text, bold, code, flow
from reports.figures.life_models import Limits, intervals
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.words import remark
from schemas.numbers import ABSENT, NBSP, bounds, capital, compact, digits, percent, significant

_SQL = """SELECT configuration, plan, voltage_kv, duration_s, specimens, expected_failures, rig_hours, use_kv,
       failed_share, life_at_use_s, life_at_use_s_lower, life_at_use_s_upper, limits_ratio, worst_limits_ratio, warnings
FROM life_plans
WHERE campaign = $campaign
ORDER BY configuration, plan = 'even grid', plan, voltage_kv"""


def section(draft: Draft, unit: tuple[float, str]) -> Section | None:
    """What to test next; None where lives at one voltage alone leave nothing to plan."""
    query = Query(_SQL, {"campaign": draft.item})
    rows = draft.results.rows(query)
    planned = [r for r in rows if r["use_kv"]]
    refused = [r for r in rows if not r["use_kv"]]
    blocks: list[Block | Fold] = []
    if planned:
        data = draft.data("life_plans", {n: [r[n] for r in planned] for n in planned[0]})
        names = dict.fromkeys(r["configuration"] for r in planned)
        groups = [[r for r in planned if r["configuration"] == name] for name in names]
        blocks.append(Pair(tuple(_figure(own, data, unit) for own in groups)))
        blocks += [_table(query, own, unit) for own in groups]
    for r in refused:
        blocks.append(Text(f"No plan{_of(r['configuration'])}: {remark(r['warnings'] or 'no reason was kept')}."))
    if not blocks:
        return None
    return Section("plan", _heading(planned), "What to test next", tuple(blocks))


def _of(configuration: str | None) -> str:
    return f" for {short(configuration, 40)}" if configuration else ""


def _heading(rows: Sequence[Record]) -> str:
    """The next test of the first configuration, in a sentence."""
    test = next((r for r in rows if r["plan"] == "next test"), None)
    if test is None:
        return "What to test next"
    at, use = (f"{compact(test[name])}{NBSP}kV" for name in ("voltage_kv", "use_kv"))
    return f"The next specimen tells most at {at} about life at {use}"


def _figure(rows: Sequence[Record], data: str, unit: tuple[float, str]) -> Figure:
    """The interval of the life at use today, and as it is expected after each plan."""
    first = rows[0]
    life, low, high = (unit[0] * first[n] for n in ("life_at_use_s", "life_at_use_s_lower", "life_at_use_s_upper"))
    shown = [Limits("today", "as known", life, low, high)]
    for plan in dict.fromkeys(r["plan"] for r in rows):
        own = [r for r in rows if r["plan"] == plan]
        half = np.sqrt(own[0]["limits_ratio"])
        words = digits(sum(r["specimens"] for r in own), "specimen")
        shown.append(
            Limits(f"after the {plan}" + (" plan" if plan == "robust" else ""), words, life, life / half, life * half)
        )
    share = (
        "Median life" if first["failed_share"] == 0.5 else f"Life by which {percent(first['failed_share'])} have failed"
    )
    text = "; ".join(f"{one.label} × {significant(one.high / one.low)}" for one in shown)
    return Figure(
        intervals(
            shown, f"{share} at {compact(first['use_kv'])} kV, {unit[1]}", alt=f"Limits of the life at use. {text}."
        ),
        flow(
            bold(f"What more tests would tell{_of(first['configuration'])}."),
            f" 95 % limits of the life at {compact(first['use_kv'])} kV today, and how far apart they are"
            " expected to be after each plan if lives are as fitted. Nobody said the voltage in use: it is taken as 60 % of the"
            " lowest tested.",
        ),
        data,
    )


def _table(query: Query, rows: Sequence[Record], unit: tuple[float, str]) -> Table:
    heads = (
        Head("Plan"), Head("Voltage, kV", "n"), Head(f"For up to, {unit[1]}", "n"), Head("Specimens", "n"),
        Head("Failures", "n"), Head("Rig hours", "n"), Head("Limits apart by", "n"), Head("At worst", "n"),
    )  # fmt: skip
    made, before = [], ""
    for r in rows:
        new, before = r["plan"] != before, r["plan"]
        worst = r["worst_limits_ratio"]
        made.append(
            Row(
                (
                    capital(r["plan"]), significant(r["voltage_kv"]),
                    significant(unit[0] * r["duration_s"]), str(r["specimens"]),
                    significant(r["expected_failures"], 2), significant(r["rig_hours"]),
                    f"× {significant(r['limits_ratio'])}" if new else "",
                    "" if not new else ABSENT if worst is None or worst > 1e4 else f"× {significant(worst)}",
                )
            )
        )  # fmt: skip
    first = rows[0]
    life = bounds(first["life_at_use_s"], first["life_at_use_s_lower"], first["life_at_use_s_upper"], unit[0])
    below = (
        f"Life at {compact(first['use_kv'])} kV as known today: {life} {unit[1]}. Robust: as many specimens and"
        f" rig hours as so far,"
        " for the narrowest interval on average over all lives that the data and the choice of their"
        " distribution leave open. Even"
        " grid: the same without a plan. Other conditions, budgets and prices of a specimen: "
    )
    note = "failures expected; at worst: under the least favourable of those lives"
    caption = f"Plans{_of(first['configuration'])}"
    return Table(
        caption,
        heads,
        tuple(made),
        query.shown(),
        note,
        flow(below, "the command ", code("plan lifetimes"), "."),
        "wide",
    )
