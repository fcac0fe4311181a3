"""The parts of a campaign's page about lifetimes: survival, groups, comparisons, where the film fails."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from markupsafe import Markup

from reports import words
from reports.blocks import Block, Figure, Fold, Head, Pair, Row, Section, Table, bold, filled, flow
from reports.figures import palette
from reports.figures import survival as figures
from reports.figures.survival import FittedLaw, GroupCurve
from reports.findings import survival_title
from reports.names import short, visible
from reports.pages import listing
from reports.pages.campaign import causes, laws
from reports.pages.draft import Draft
from reports.results import Query, write_bounds
from reports.results import Row as Record
from schemas.arrays import Float, Int
from schemas.numbers import (
    ABSENT,
    NBSP,
    capital,
    compact,
    every,
    joined,
    p_equals,
    p_value,
    pm,
    significant,
    time_unit,
    with_unit,
)

_GROUPS = 6
"""Groups whose medians stand beside a headline."""
_EFFECT = "restricted mean"
"""The comparison that says by how much, in seconds."""


@dataclass(frozen=True)
class Lives:
    """Everything about lifetimes in a campaign; single lives and curves only where they are shown."""

    tested: int
    failed: int
    longest_s: float
    lifetimes: list[Record]
    curves: list[Record]
    summaries: list[Record]
    comparisons: list[Record]
    quantiles: list[Record]
    notes: list[Record]
    queries: dict[str, Query]
    laws: Sequence[Record] = ()

    @property
    def groups(self) -> list[tuple[str, float | None]]:
        """Configurations and voltages, in a fixed order."""
        return list(dict.fromkeys((r["configuration"], r["voltage_kv"]) for r in self.summaries))

    @property
    def unit(self) -> tuple[float, str]:
        """Factor from seconds and the unit in which this campaign's lives are read."""
        return time_unit(self.longest_s)

    def label(self, key: tuple[str, float | None], limit: int = 60) -> str:
        """The configuration, with the voltage where one configuration has several."""
        voltages = {v for _, v in self.groups}
        name = short(key[0] or "no configuration", limit)
        if len(voltages) > 1 and key[1] is not None:
            volts = with_unit(compact(key[1]), "kV")
            return volts if len({c for c, _ in self.groups}) == 1 else f"{name}, {volts}"
        return name


def load(draft: Draft, *, single: bool = True) -> Lives:
    """The lifetimes of the campaign and the survival of its configurations; without `single`, what its headline needs."""
    parameters = {"campaign": draft.item}
    queries = {
        "lifetimes": Query(
            "SELECT specimen_id, configuration, voltage_kv, lifetime_s, failed, censored_because, failure_site, failure_region,\n"
            "       breakdown_voltage_kv, decided, probability_failed, warnings, recording_id\nFROM lifetimes\nWHERE campaign = $campaign\n"
            "ORDER BY configuration, voltage_kv, lifetime_s, specimen_id, recording_id",
            parameters,
        ),
        "curves": Query(
            "SELECT *\nFROM survival_curves\nWHERE campaign = $campaign\nORDER BY configuration, voltage_kv, time_s",
            parameters,
        ),
        "summaries": Query(
            "SELECT configuration, voltage_kv, specimens, failures, restricted_mean_s, restricted_mean_s_lower,\n"
            "       restricted_mean_s_upper, restricted_to_s, median_s, median_s_lower, median_s_upper, survival_at_end,\n"
            "       survival_at_end_lower, survival_at_end_upper, weibull_shape, weibull_shape_lower, weibull_shape_upper,\n"
            "       weibull_scale_s, weibull_scale_s_lower, weibull_scale_s_upper, warnings, campaign\n"
            "FROM survival_summaries\nWHERE campaign = $campaign\nORDER BY voltage_kv, restricted_mean_s, configuration",
            parameters,
        ),
        "comparisons": Query(
            "SELECT configuration_a, configuration_b, voltage_kv, test, statistic, statistic_lower, statistic_upper, p_value,\n"
            "       p_value_holm, warnings\n"
            "FROM survival_comparisons\nWHERE campaign = $campaign\n"
            "ORDER BY configuration_a, configuration_b, voltage_kv, test",
            parameters,
        ),
        "quantiles": Query(
            "SELECT configuration, voltage_kv, distribution, failed_share, time_s, time_s_lower, time_s_upper\n"
            "FROM lifetime_quantiles\nWHERE campaign = $campaign\n"
            "ORDER BY configuration, voltage_kv, distribution, failed_share",
            parameters,
        ),
        "notes": Query(
            "SELECT configuration, specimen_id, statement\nFROM survival_notes AS n\nWHERE campaign = $campaign AND NOT EXISTS (\n"
            "    SELECT 1 FROM survival_summaries AS s WHERE s.campaign = n.campaign AND contains(s.warnings, n.statement)\n)\n"
            "ORDER BY configuration, specimen_id, statement",
            parameters,
        ),
    }
    powers = Query(
        "SELECT configuration, exponent, exponent_lower, exponent_upper\nFROM voltage_life\nWHERE campaign = $campaign AND holds\n"
        "  AND exponent_upper < 0 AND exponent_lower IS NOT NULL\nORDER BY configuration",
        parameters,
    )
    counted = Query(
        "SELECT count(*) AS tested, count(*) FILTER (WHERE failed) AS failed, coalesce(max(lifetime_s), 0) AS longest_s\n"
        "FROM lifetimes\nWHERE campaign = $campaign",
        parameters,
    )
    needed = queries if single else {"summaries", "comparisons"}
    rows = {name: draft.results.rows(query) if name in needed else [] for name, query in queries.items()}
    (number,) = draft.results.rows(counted)
    return Lives(
        number["tested"],
        number["failed"],
        number["longest_s"],
        rows["lifetimes"],
        rows["curves"],
        rows["summaries"],
        rows["comparisons"],
        rows["quantiles"],
        rows["notes"],
        queries,
        draft.results.rows(powers),
    )


def decisive(comparisons: Sequence[Record]) -> Record | None:
    """The clearest difference by the test that is trusted most: exact before simulated before asymptotic."""
    known = [c for c in comparisons if c["p_value"] is not None]
    trusted = [c for c in known if _trust(c) == min(_trust(k) for k in known)] if known else []
    return min(
        trusted, key=lambda c: (c["p_value"], c["configuration_a"] or "", c["configuration_b"] or ""), default=None
    )


def _trust(comparison: Record) -> int:
    test = comparison["test"] or ""
    for rank, named in enumerate(("exact permutation", "simulated permutation", "fisher", "log-rank")):
        if named in test:
            return rank
    return 9


def headline(lives: Lives) -> str:
    """What the lifetimes show, in one sentence; empty without lifetimes."""
    best = decisive(lives.comparisons)
    if best is not None and best["p_value"] < 0.05:
        return survival_title(best, lives.summaries)
    if lives.tested:
        tested = f"{lives.failed} of {lives.tested} specimens failed"
        if best is None and len(lives.laws) == 1:
            return f"{tested}; life goes with the voltage to the power {write_bounds(lives.laws[0], 'exponent')}"
        return f"{tested}; no difference between the groups is shown" if best is not None else tested
    return ""


def support(lives: Lives) -> str:
    """The numbers behind the headline."""
    best = decisive(lives.comparisons)
    if best is None:
        return _tell_medians(lives)
    parts = []
    for s in lives.summaries:
        if (
            s["configuration"] in (best["configuration_a"], best["configuration_b"])
            and s["voltage_kv"] == best["voltage_kv"]
        ):
            mean = write_bounds(s, "restricted_mean_s", lives.unit[0])
            parts.append(f"“{short(s['configuration'] or '', 40)}” {mean}{NBSP}{lives.unit[1]}")
    to = next((s["restricted_to_s"] for s in lives.summaries if s["restricted_to_s"]), None)
    until = f" to {with_unit(compact(to * lives.unit[0]), lives.unit[1])}" if to else ""
    means = f"Restricted mean life{until}, 95 % interval: {'; '.join(parts)}. " if parts else ""
    holm = f" ({p_equals(best['p_value_holm'])} after Holm)" if best["p_value_holm"] is not None else ""
    return f"{means}{words.test(best['test'])}: {p_equals(best['p_value'])}{holm}."


def _tell_medians(lives: Lives) -> str:
    """The median life of each group of one configuration, with its limits; empty where there are none."""
    known = [s for s in lives.summaries if s["median_s"] is not None]
    if not known or len(known) > _GROUPS:
        return ""
    parts = [
        f"{lives.label((s['configuration'], s['voltage_kv']), 40)} {write_bounds(s, 'median_s', lives.unit[0])}{NBSP}{lives.unit[1]}"
        for s in known
    ]
    return f"Median life, 95 % interval: {'; '.join(parts)}."


def survival(draft: Draft, lives: Lives) -> Section | None:
    """Kaplan–Meier curves with numbers at risk, and the Weibull check."""
    groups = list_curves(lives)
    if not groups:
        return None
    href = draft.data("survival", {n: [r[n] for r in lives.curves] for n in lives.curves[0]})
    volts = {v for _, v in lives.groups if v is not None}
    axis = f"Time at {with_unit(compact(volts.copy().pop()), 'kV')}, " if len(volts) == 1 else "Time under voltage, "
    axis += lives.unit[1]
    counts = "; ".join(f"{g.name}: {g.failed} of {g.total} failed" for g in groups)
    empty = any(g.failed == 0 for g in groups)
    inspected = any(r["method"] == "turnbull" for r in lives.curves)
    between = (
        " Where failures were found at inspections: Turnbull’s curve, drawn to fall at the inspection."
        if inspected
        else ""
    )
    note = " Where nothing failed such a band does not exist; the exact limit is in the table." if empty else ""
    first = Figure(
        figures.kaplan_meier(groups, axis, alt=f"Kaplan–Meier curves. {counts}."),
        flow(
            bold("Kaplan–Meier"), f" with 95 % bands (log–log). Open marks: alive when the test ended.{between}{note}"
        ),
        href,
    )
    plotted = [g for g in groups if g.failed > 1]
    if not plotted:
        return Section("survival", "Survival", "Survival", (first,))
    quantiles = lives.quantiles
    files: tuple[str, ...] = (href,)
    if quantiles:
        files += (draft.data("probability", {n: [r[n] for r in quantiles] for n in quantiles[0]}),)
    shapes = "; ".join(f"{g.name}: {g.laws[figures.WEIBULL].words}" for g in groups if figures.WEIBULL in g.laws)
    meaning = " Shape near 1: failure at random, weak spots; well above: wear-out." if shapes else ""
    second = Figure(
        figures.probability(plotted, figures.WEIBULL, axis, alt=f"Share failed on Weibull scales. {shapes or 'No law was fitted'}."),
        flow(bold("Weibull check."), f" Points on the line: the law holds. {shapes + '.' if shapes else 'No law was fitted.'}{meaning}"),
        files,
    )  # fmt: skip
    further: list[Figure] = []
    spreads = "; ".join(f"{g.name}: {g.laws[figures.LOG_NORMAL].words}" for g in groups if figures.LOG_NORMAL in g.laws)
    if spreads:
        further.append(
            Figure(
                figures.probability(plotted, figures.LOG_NORMAL, axis, alt=f"Share failed on log-normal scales. {spreads}."),
                flow(bold("Log-normal check."), f" The same lives on scales on which log-normal ones are a line. {spreads}. Bands: 95 %, by profile likelihood."),
                files,
            )
        )  # fmt: skip
    competing = causes.incidence(draft, lives.unit[0], {key: lives.label(key) for key in lives.groups}, axis)
    further += [competing] if competing is not None else []
    pairs = [Pair((first, second)), *([Pair(tuple(further))] if further else [])]
    return Section("survival", "Survival", "Survival", tuple(pairs))


def list_curves(lives: Lives, configurations: Collection[str] | None = None) -> list[GroupCurve]:
    """The survival curves of all groups, or of those of some configurations, in the unit in which the lives are read."""
    found = []
    for i, key in enumerate(lives.groups):
        if configurations is not None and key[0] not in configurations:
            continue
        rows = [r for r in lives.curves if (r["configuration"], r["voltage_kv"]) == key]
        summary = next(s for s in lives.summaries if (s["configuration"], s["voltage_kv"]) == key)
        if not rows:
            continue

        def real(column: str, rows: list[Record] = rows) -> Float:
            return np.array([np.nan if r[column] is None else r[column] for r in rows], dtype=float)

        def count(column: str, rows: list[Record] = rows) -> Int:
            return np.array([r[column] or 0 for r in rows], dtype=np.int64)

        inspected = any(r["method"] == "turnbull" for r in rows)
        found.append(
            GroupCurve(
                lives.label(key), palette.group(i), lives.unit[0] * real("time_s"), real("survival"), real("lower_95"), real("upper_95"),
                count("at_risk"), count("censored"), _falls(rows), _laws_of(lives, key, summary), summary["failures"] if inspected else None,
            )
        )  # fmt: skip
    return found


def _laws_of(lives: Lives, key: tuple[str | None, float | None], summary: Record) -> dict[str, FittedLaw]:
    """The Weibull and log-normal laws of a group, with their bands where the quantiles are known."""
    factor, found = lives.unit[0], {}
    for law in (figures.WEIBULL, figures.LOG_NORMAL):
        rows = [r for r in lives.quantiles if (r["configuration"], r["voltage_kv"], r["distribution"]) == (*key, law)]
        share, time, low, high = (
            np.array([np.nan if r[name] is None else r[name] for r in rows], dtype=float)
            for name in ("failed_share", "time_s", "time_s_lower", "time_s_upper")
        )
        if law == figures.WEIBULL:
            shape, scale = summary["weibull_shape"], summary["weibull_scale_s"]
            if not shape or not scale:
                continue
            lower, upper = summary["weibull_shape_lower"], summary["weibull_shape_upper"]
            spread = None if lower is None or upper is None else (upper - lower) / 3.92
            words = f"shape {pm(shape, spread)}" if spread else f"shape {significant(shape, 2)}"
            location, sigma = math.log(factor * scale), 1 / shape
        elif len(rows) > 1:
            place = [NormalDist().inv_cdf(s) for s in share.tolist()]
            sigma, location = np.polyfit(place, np.log(factor * time), 1).tolist()
            words = f"median {compact(math.exp(location))}{NBSP}{lives.unit[1]}, SD of ln t {significant(sigma, 2)}"
        else:
            continue
        found[law] = FittedLaw(location, sigma, words, share, factor * low, factor * high)
    return found


def _falls(rows: list[Record]) -> Int:
    """Failures at each time of a curve; where only inspections tell them, 1 where the curve falls."""
    survival = [1.0, *(r["survival"] for r in rows)]
    fallen = [int(after < before) for before, after in itertools.pairwise(survival)]
    return np.array(
        [fell if r["failures"] is None else r["failures"] for r, fell in zip(rows, fallen, strict=True)], dtype=np.int64
    )


def marked(index: int, text: str) -> Markup:
    """A group's name after its marker."""
    drawn = palette.group(index)
    return Markup('<span class="group g{}">{}</span> {}').format(palette.number_colour(index), drawn.sign, text)


def groups(draft: Draft, lives: Lives) -> Section | None:
    """Survival in numbers, and the tests between groups."""
    if not lives.summaries:
        return None
    to = {s["restricted_to_s"] for s in lives.summaries if s["restricted_to_s"]}
    factor, unit = lives.unit
    end = f"Alive at {with_unit(compact(to.copy().pop() * factor), unit)}, %" if len(to) == 1 else "Alive at the end, %"
    rows = []
    for i, key in enumerate(lives.groups):
        s = next(x for x in lives.summaries if (x["configuration"], x["voltage_kv"]) == key)
        none = s["failures"] == 0
        rows.append(
            Row(
                (
                    marked(i, lives.label(key)), str(s["specimens"]), str(s["failures"]),
                    f"{compact(s['restricted_mean_s'] * factor)} (no failure)" if none else write_bounds(s, "restricted_mean_s", factor),
                    "not reached" if s["median_s"] is None else write_bounds(s, "median_s", factor),
                    ABSENT if s["weibull_shape"] is None else write_bounds(s, "weibull_shape"),
                    ABSENT if s["weibull_scale_s"] is None else write_bounds(s, "weibull_scale_s", factor),
                    write_bounds(s, "survival_at_end", 100.0),
                )
            )
        )  # fmt: skip
    heads = (
        Head("Configuration"), Head("Specimens", "n"), Head("Failed", "n"), Head(f"Restricted mean, {unit}", "n"), Head(f"Median, {unit}", "n"),
        Head("Weibull shape", "n"), Head(f"Weibull scale, {unit}", "n"), Head(end, "n"),
    )  # fmt: skip
    others = sorted({s["campaign"] for s in lives.summaries if s["campaign"]})
    limits = _remarks(lives)
    if len(others) > 1:
        limits.append(
            f"Configurations are compared over all campaigns that have them: {short('; '.join(others), 200)}."
        )
    below = " ".join(limits)
    blocks: list[Block | Fold] = [
        Table(
            "Lifetimes by configuration",
            heads,
            tuple(rows),
            lives.queries["summaries"].shown(),
            "95 % intervals in brackets",
            below,
            "wide",
        )
    ]
    blocks += _comparisons(lives)
    blocks += _notes(lives)
    fitted = laws.distributions(draft)
    if fitted is not None:
        blocks.append(fitted)
    return Section("groups", "Groups and their comparison", "Groups", tuple(blocks))


def _remarks(lives: Lives) -> list[str]:
    """What the analysis remarks on groups, each remark once, with the groups that it is about unless it is about all."""
    about: dict[str, list[str]] = {}
    for s in lives.summaries:
        for text in filter(None, (s["warnings"] or "").split("; ")):
            about.setdefault(text, []).append(lives.label((s["configuration"], s["voltage_kv"])))
    together: dict[tuple[str, ...], list[str]] = {}
    for text, who in about.items():
        together.setdefault(tuple(who), []).append(words.remark(text))
    everyone = len(lives.summaries)
    return [
        f"{capital('; '.join(texts))}." if len(who) == everyone > 1 else f"{joined(who)}: {'; '.join(texts)}."
        for who, texts in together.items()
    ]


def _notes(lives: Lives) -> list[Block | Fold]:
    """What was left out or contradicts itself, and what these lives cannot tell, where it does not stand with a group."""
    if not lives.notes:
        return []
    rows = tuple(
        Row(
            (
                visible(r["specimen_id"] or "several"),
                short(r["configuration"] or ABSENT, 44),
                words.remark(r["statement"]),
            )
        )
        for r in lives.notes
    )
    heads = (Head("Specimen"), Head("Configuration"), Head("What, and why", "text"))
    caption = "Left out, contradictory, or not to be told"
    return [Table(caption, heads, rows, lives.queries["notes"].shown())]


_SIGNS = (
    "One against the other: a difference of restricted means is the first less the second, a hazard ratio the first over the second;"
    " a permutation test states the failures of the second, observed less expected."
)


def _comparisons(lives: Lives) -> list[Block | Fold]:
    """The test that is trusted most and the effect size of each pair; all other tests folded."""
    if not lives.comparisons:
        return []
    best = min(_trust(c) for c in lives.comparisons)
    main = [c for c in lives.comparisons if _trust(c) == best or _EFFECT in (c["test"] or "")]
    below = (
        "Exact permutation tests count every relabelling of the specimens; where groups are small they, not χ², are to be believed."
        f" {_SIGNS}"
    )
    caption = "Comparison of the groups"
    everyone = lives.queries["comparisons"]
    tests = {f"test_{i}": test for i, test in enumerate(sorted({c["test"] for c in main if c["test"]}))}
    among = f"\n  AND test IN ({', '.join('$' + key for key in tests)})\nORDER BY"
    these = Query(everyone.sql.replace("\nORDER BY", among), {**everyone.parameters, **tests})
    blocks: list[Block | Fold] = [_comparison_table(lives, main, these, caption, below)]
    if len(main) < len(lives.comparisons):
        everything = _comparison_table(lives, lives.comparisons, everyone, "All comparisons of the groups", _SIGNS)
        blocks.append(Fold(f"{every(len(lives.comparisons), 'comparison')}, by other tests, too", (everything,)))
    return blocks


def _comparison_table(lives: Lives, shown: Sequence[Record], query: Query, caption: str, below: str) -> Table:
    rows = []
    for c in sorted(
        shown, key=lambda c: (c["configuration_a"] or "", c["configuration_b"] or "", c["voltage_kv"] or 0.0)
    ):
        pair = words.against(c)
        if c["voltage_kv"] is not None and len({v for _, v in lives.groups}) > 1:
            pair += f", {with_unit(compact(c['voltage_kv']), 'kV')}"
        statistic = write_bounds(c, "statistic")
        cells = (pair, words.test(c["test"]), statistic, p_value(c["p_value"]), p_value(c["p_value_holm"]))
        rows.append(Row((*cells, words.remark(c["warnings"]))))
    heads = (
        Head("Pair"), Head("Test"), Head("Statistic (times in s)", "n"), Head("p", "n"), Head("p, Holm", "n"), Head("What limits it"),
    )  # fmt: skip
    return Table(caption, *filled(heads, rows), query.shown(), below=below)


def table(draft: Draft, lives: Lives) -> Fold | None:
    """All lifetimes, folded."""
    if not lives.lifetimes:
        return None
    rows = lives.lifetimes
    shown = listing.lifetimes(draft.site, rows, lives.queries["lifetimes"], "Lifetimes", unit=lives.unit)
    return Fold(every(len(rows), "lifetime"), (shown,))
