"""The part of a campaign's page about what lives depend on: the regression on stresses and categories, and its checks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Pair, Row, Section, Table, Text, bold, flow
from reports.figures import life_models as figures
from reports.figures import palette
from reports.figures.life_models import Effect, StressLine, Strip
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.words import remark
from schemas.arrays import Bool, Float
from schemas.numbers import ABSENT, bounds, capital, compact, digits, every, joined, p_equals, p_value, significant

_SQL = {
    "regressions": """SELECT family, stress_law, chosen, specimens, failures, sigma, sigma_lower, sigma_upper, shape, shape_lower,
       shape_upper, log_likelihood, aic, p_value, tests, method, warnings
FROM life_regressions
WHERE campaign = $campaign
ORDER BY chosen DESC, aic, family, stress_law""",
    "effects": """SELECT c.coefficient, c.law, c.unit, c.contrast, c."value", c.value_lower, c.value_upper, c.factor, c.factor_lower, c.factor_upper,
       c.p_value, x.factor AS hazard_ratio, x.factor_lower AS hazard_ratio_lower, x.factor_upper AS hazard_ratio_upper,
       x.p_value AS p_value_by_cox
FROM life_coefficients c
JOIN life_regressions r ON r.chosen AND r.campaign = c.campaign AND r.family = c.family
    AND r.stress_law IS NOT DISTINCT FROM c.stress_law
LEFT JOIN life_coefficients x ON x.family = 'cox' AND x.campaign = c.campaign AND x.coefficient = c.coefficient
WHERE c.campaign = $campaign AND c.coefficient <> 'intercept'
ORDER BY c.coefficient""",
    "groups": """SELECT conditions, specimens, failures, expected_failures, factor, p_value, stress, stress_value, life_s, category, line_life_s
FROM life_group_fits
WHERE campaign = $campaign
ORDER BY conditions""",
    "lines": """SELECT category, stress, stress_law, stress_unit, stress_value, life_s, life_s_lower, life_s_upper, extrapolated
FROM life_lines
WHERE campaign = $campaign
ORDER BY category, stress_value""",
    "residuals": """SELECT specimen_id, conditions, failed, cox_snell, observed_hazard, deviance
FROM life_residuals
WHERE campaign = $campaign
ORDER BY conditions, cox_snell, specimen_id""",
    "modes": """SELECT failure_mode, model, coefficient, failures, "value", value_lower, value_upper, p_value
FROM mode_effects
WHERE campaign = $campaign
ORDER BY failure_mode, coefficient, model""",
    "proportionality": """SELECT covariate, trend, statistic, degrees_of_freedom, p_value
FROM proportionality_tests
WHERE campaign = $campaign AND p_value IS NOT NULL
ORDER BY covariate = 'all covariates', covariate""",
    "limits": """SELECT stress, family, stress_limit, stress_limit_lower, stress_limit_upper, exponent, p_value
FROM endurance_limits
WHERE campaign = $campaign""",
    "batches": """SELECT e.batch, e.specimens, e.failures, e.factor, e.factor_lower, e.factor_upper, s.batches, s.tau, s.tau_lower,
       s.tau_upper, s.sigma, s.p_value
FROM batch_effects e
JOIN batch_scatter s ON s.campaign = e.campaign
WHERE e.campaign = $campaign
ORDER BY e.factor, e.batch""",
}
_COVARIATES = {
    "voltage_kv": ("voltage", "Voltage, kV"),
    "temperature_c": ("temperature", "Temperature, °C"),
    "humidity": ("humidity", "Relative humidity"),
    "frequency_hz": ("frequency", "Frequency, Hz"),
}
"""How covariates are called in text, and on an axis."""
_MEANINGS = {
    "exponential": "The coefficient of {name} is the change of ln t per {unit}. ",
    "inverse power": "The coefficient of {name} is the exponent of {its} power law. ",
    "arrhenius": "The coefficient of {name} is the activation energy in eV. ",
    "category": "",
}
"""What coefficients are, by the law of their covariates."""
_MOST_STRIPS = 14


@dataclass(frozen=True)
class _Found:
    """Everything that the regressions of a campaign left."""

    rows: dict[str, list[Record]]
    queries: dict[str, Query]

    @property
    def chosen(self) -> Record | None:
        return next((r for r in self.rows["regressions"] if r["chosen"]), None)

    @property
    def effects(self) -> list[Record]:
        """Coefficients of the chosen model but the intercept, each beside Cox's ratio of hazards."""
        return self.rows["effects"]


def section(draft: Draft, unit: tuple[float, str]) -> Section | None:
    """What the lives depend on; None where nothing was varied."""
    queries = {name: Query(sql, {"campaign": draft.item}) for name, sql in _SQL.items()}
    found = _Found({name: draft.results.rows(query) for name, query in queries.items()}, queries)
    if not found.rows["regressions"]:
        return None
    refused = remark("; ".join(r["warnings"] for r in found.rows["regressions"] if r["warnings"]))
    if found.chosen is None:
        told = Text(f"No regression of the lives on what was varied: {refused or 'no reason was kept'}.")
        only: list[Block | Fold] = [told, *([_batch_table(found)] if found.rows["batches"] else [])]
        return Section("depends", "What the lives depend on", "What lives depend on", tuple(only))
    blocks: list[Block | Fold] = [_evidence(draft, found, unit), _checks(draft, found)]
    blocks.append(_coefficient_table(found, f"Not in the regression: {refused}." if refused else ""))
    groups = _group_table(found, unit)
    many = len(groups.rows) > _MOST_STRIPS
    blocks.append(Fold(f"Each of the {len(groups.rows)} groups against the regression", (groups,)) if many else groups)
    if found.rows["batches"]:
        blocks.append(_batch_table(found))
    if found.rows["modes"]:
        blocks.append(_mode_table(found))
    families = found.rows["regressions"]
    if len(families) > 1:
        blocks.append(
            Fold(
                f"{every(len(families), 'regression')} that {'was' if len(families) == 1 else 'were'} tried",
                (_family_table(found),),
            )
        )
    return Section("depends", _heading(found), "What lives depend on", tuple(blocks))


def _heading(found: _Found) -> str:
    """Which covariates have an effect, of which none is shown, and whether the groups follow the regression."""
    known = [(_covariate(r["coefficient"]), r["p_value"]) for r in found.effects if r["p_value"] is not None]
    acting = list(dict.fromkeys(name for name, p in known if p < 0.05))
    idle = [name for name in dict.fromkeys(name for name, _ in known) if name not in acting]
    parts = []
    if acting:
        parts.append(f"Life depends on {joined(acting)}")
        parts += [f"no effect of {joined(idle)} is shown"] if idle else []
    elif idle:
        parts.append(f"No effect of {joined(idle)} on life is shown")
    best = found.chosen
    if best is not None and best["p_value"] is not None and best["p_value"] < 0.05:
        parts.append(f"the groups do not follow the law ({p_equals(best['p_value'])})")
    return "; ".join(parts) or "What the lives depend on"


def _covariate(coefficient: str) -> str:
    name = coefficient.partition(":")[0]
    return _COVARIATES.get(name, (name,))[0]


def _label(coefficient: str) -> str:
    """`electrode: silver` stays, `voltage_kv` becomes `voltage`."""
    name, colon, level = coefficient.partition(":")
    return _covariate(name) + colon + level


def _family(record: Record) -> str:
    family = str(record["family"]).replace("weibull", "Weibull")
    return f"{family}, {record['stress_law']}" if record["stress_law"] else family


def _evidence(draft: Draft, found: _Found, unit: tuple[float, str]) -> Pair:
    """Life against the first stress where one was varied, and the forest of all effects."""
    shown = [figure for figure in (_stress_figure(draft, found, unit), _forest(draft, found)) if figure is not None]
    return Pair(tuple(shown))


def _numbers(rows: Sequence[Record], column: str) -> Float:
    return np.array([np.nan if r[column] is None else r[column] for r in rows], dtype=float)


def _stress_figure(draft: Draft, found: _Found, unit: tuple[float, str]) -> Figure | None:
    rows, best = found.rows["lines"], found.chosen
    if not rows or best is None:
        return None
    stress = rows[0]["stress"]
    unit_of_stress = rows[0]["stress_unit"]
    title = capital(stress) if unit_of_stress is None else f"{capital(stress)}, {visible(unit_of_stress)}"
    name, axis = _COVARIATES.get(stress, (stress, title))
    categories = list(dict.fromkeys(r["category"] for r in rows))
    lines = []
    for i, category in enumerate(categories):
        own = [r for r in rows if r["category"] == category]
        groups = [g for g in found.rows["groups"] if g["line_life_s"] and (g["category"] or "") == (category or "")]
        lines.append(
            StressLine(
                category or "", palette.group(i), _numbers(own, "stress_value"), unit[0] * _numbers(own, "life_s"),
                unit[0] * _numbers(own, "life_s_lower"), unit[0] * _numbers(own, "life_s_upper"),
                np.array([bool(r["extrapolated"]) for r in own]), _numbers(groups, "stress_value"), unit[0] * _numbers(groups, "line_life_s"),
            )
        )  # fmt: skip
    tested = [r["stress_value"] for r in rows if not r["extrapolated"]]
    span = f"tested from {compact(min(tested))} to {compact(max(tested))}"
    beside = {r["coefficient"].partition(":")[0] for r in found.effects} - {stress}
    others = (
        " All else at its mean, where the points are moved to by the regression."
        if len(beside) > (len(categories) > 1)
        else ""
    )
    return Figure(
        figures.against_stress(lines, axis, unit[1], log=stress == "voltage_kv" or rows[0]["stress_law"] == "inverse power", alt=f"Median life against {name}, {span}."),
        flow(
            bold(f"Life against {name}."), f" Median life by the {_family(best)} regression with 95 % band; points: each group by itself.",
            f" Dashed where nothing was tested: there the line rests on the law alone.{others}",
        ),
        draft.data("life_lines", {n: [r[n] for r in rows] for n in rows[0]}),
    )  # fmt: skip


def _forest(draft: Draft, found: _Found) -> Figure | None:
    rows, best = [r for r in found.effects if r["factor"]], found.chosen
    if not rows or best is None:
        return None
    effects = []
    for r in rows:
        by_cox = None
        bounded = all(r[n] is not None and 0 < r[n] < math.inf for n in ("hazard_ratio_lower", "hazard_ratio_upper"))
        if r["hazard_ratio"] and best["sigma"] and bounded:  # unbounded where failures and survivors do not overlap
            # A ratio of hazards h is one of lives h^(−σ) where the lives are Weibull.
            ends = sorted(r[name] ** -best["sigma"] for name in ("hazard_ratio_lower", "hazard_ratio_upper"))
            by_cox = (r["hazard_ratio"] ** -best["sigma"], ends[0], ends[1])
        low, high = (math.nan if r[n] is None else r[n] for n in ("factor_lower", "factor_upper"))
        effects.append(Effect(_label(r["coefficient"]), r["contrast"] or "", r["factor"], low, high, by_cox))
    words = "; ".join(f"{e.label}, {e.contrast}: × {bounds(e.factor, e.low, e.high)}" for e in effects)
    check = (
        " Open: what Cox’s model, which assumes no distribution, says, turned into lives as for Weibull ones."
        if any(e.by_cox for e in effects)
        else ""
    )
    return Figure(
        figures.forest(effects, alt=f"Effects on life. {words}."),
        flow(bold("Effects."), f" How many times as long lives are over each contrast, all others being equal, with 95 % limits.{check}"),
        draft.data(
            "effects",
            {
                "covariate": [e.label for e in effects], "contrast": [e.contrast for e in effects], "factor": [e.factor for e in effects],
                "factor_lower": [e.low for e in effects], "factor_upper": [e.high for e in effects],
                "factor_by_cox": [e.by_cox[0] if e.by_cox else None for e in effects],
            },
        ),
    )  # fmt: skip


def _checks(draft: Draft, found: _Found) -> Pair:
    rows = found.rows["residuals"]
    href = draft.data("life_residuals", {n: [r[n] for r in rows] for n in rows[0]})
    failed = np.array([bool(r["failed"]) for r in rows])
    residual, observed, deviance = (_numbers(rows, n) for n in ("cox_snell", "observed_hazard", "deviance"))
    strips, left = _strips([r["conditions"] for r in rows], deviance, failed)
    outside = int((np.abs(deviance) > 1.96).sum())
    first = Figure(
        figures.cox_snell(residual, observed, failed, alt="Cumulative hazard of the Cox–Snell residuals against themselves."),
        flow(bold("Is it the right distribution?"), " Points on the line, within the 95 % band: yes. A bend: another family; see the table of all that were tried."),
        href,
    )  # fmt: skip
    second = Figure(
        figures.deviances(strips, alt=f"Deviance residuals by conditions; {outside} of {len(rows)} beyond 1.96."),
        flow(bold("Does each group follow?"), f" Deviance residuals by conditions, open for survivors; a group off zero does not follow. {outside} of {len(rows)} beyond the 95 % stripe.{left}"),
        href,
    )  # fmt: skip
    return Pair((first, second))


def _strips(conditions: Sequence[str], deviance: Float, failed: Bool) -> tuple[list[Strip], str]:
    """The residuals of each group of equal conditions; of many groups those of all lives that share one condition."""
    names = list(dict.fromkeys(conditions))
    if len(names) <= _MOST_STRIPS:
        members = {_own_words(name, names): np.array([c == name for c in conditions]) for name in names}
        return [Strip(name, deviance[here], failed[here]) for name, here in members.items()], ""
    parts = list(dict.fromkeys(part for name in names for part in name.split(", ")))
    members = {part: np.array([part in c.split(", ") for c in conditions]) for part in parts}
    telling = [part for part in parts if not members[part].all()]
    shown = sorted(telling, key=lambda part: -int(members[part].sum()))[:_MOST_STRIPS]
    said = f" A strip for all lives that share a condition: there are {len(names)} groups of equal ones."
    return [Strip(p, deviance[members[p]], failed[members[p]]) for p in telling if p in shown], said


def _own_words(conditions: str, everyone: Sequence[str]) -> str:
    """The conditions of a group less what is the same in all groups."""
    shared = set.intersection(*(set(one.split(", ")) for one in everyone)) if len(everyone) > 1 else set()
    return ", ".join(part for part in conditions.split(", ") if part not in shared) or conditions


def _in_words(tests: str) -> str:
    """Likelihood-ratio tests with covariates as they are called in text."""
    for name, (called, _) in _COVARIATES.items():
        tests = tests.replace(name, called)
    return tests


def _coefficient_table(found: _Found, below: str) -> Table:
    rows = []
    for r in found.effects:
        rows.append(
            Row(
                (
                    _label(r["coefficient"]), short(r["contrast"] or ABSENT, 40), bounds(r["value"], r["value_lower"], r["value_upper"]),
                    bounds(r["factor"], r["factor_lower"], r["factor_upper"]), p_value(r["p_value"]),
                    bounds(r["hazard_ratio"], r["hazard_ratio_lower"], r["hazard_ratio_upper"]),
                    p_value(r["p_value_by_cox"]),
                )
            )
        )  # fmt: skip
    best = found.chosen
    heads = (
        Head("Covariate"), Head("Over"), Head("Coefficient", "n"), Head("Life times", "n"), Head("p", "n"), Head("Hazard times, Cox", "n"), Head("p, Cox", "n"),
    )  # fmt: skip
    scatter = ""
    if best is not None:
        scatter = f"Scatter of ln t {bounds(best['sigma'], best['sigma_lower'], best['sigma_upper'])}; limits: {best['method']}. "
        scatter += f"{capital(_in_words(remark(best['tests'])))}. " if best["tests"] else ""
    meaning = _meanings(found.effects)
    caption = f"Regression of the lives: {_family(best)}" if best is not None else "Regression of the lives"
    below = meaning + scatter + _limit_in_words(found) + _proportionality_in_words(found) + below
    query = found.queries["effects"].shown()
    return Table(caption, heads, tuple(rows), query, "95 % intervals in brackets", below, "wide")


def _limit_in_words(found: _Found) -> str:
    """Whether there is a voltage below which nothing fails."""
    said = ""
    for r in found.rows["limits"]:
        if r["p_value"] < 0.05:
            shown = bounds(r["stress_limit"], r["stress_limit_lower"], r["stress_limit_upper"])
            said += f"Below {shown} kV nothing would ever fail (endurance limit; no limit: {p_equals(r['p_value'])}). "
        else:
            said += (
                f"No endurance limit is shown ({p_equals(r['p_value'])}); if there is one, it is below"
                f" {significant(r['stress_limit_upper'])} kV. "
            )
    return said


def _proportionality_in_words(found: _Found) -> str:
    """Whether Cox's ratios of hazards stay the same over the life."""
    tests = found.rows["proportionality"]
    if not tests:
        return ""
    every = [r for r in tests if r["p_value"] < 0.05]
    changing = [r for r in every if r["covariate"] != "all covariates"] or every
    if not changing:
        return f"Hazards are proportional as far as is seen ({p_equals(tests[-1]['p_value'])}). "
    shown = joined([f"{_covariate(r['covariate'])} ({p_equals(r['p_value'])})" for r in changing])
    return f"Hazards are not proportional over the life, by {shown}: Cox’s ratios are averages over it. "


def _meanings(effects: Sequence[Record]) -> str:
    """What the coefficients are, a sentence per law."""
    said = ""
    for law, words in _MEANINGS.items():
        own = [r for r in effects if r["law"] == law]
        # Slopes have a unit each; of exponents and energies one sentence tells all.
        for group in [[r] for r in own] if law == "exponential" else [own] if own else []:
            names = joined([_covariate(r["coefficient"]) for r in group])
            unit = visible(group[0]["unit"] or "unit")
            said += words.format(name=names, unit=unit, its="its" if len(group) == 1 else "each one’s")
    return said


def _group_table(found: _Found, unit: tuple[float, str]) -> Table:
    everyone = [r["conditions"] for r in found.rows["groups"]]
    rows = tuple(
        Row(
            (
                short(_own_words(r["conditions"], everyone) or ABSENT, 100), f"{r['failures']} of {r['specimens']}", significant(r["expected_failures"], 2),
                ABSENT if not r["life_s"] else significant(unit[0] * r["life_s"]), ABSENT if not r["factor"] else f"× {significant(r['factor'], 2)}",
                p_value(r["p_value"]),
            )
        )
        for r in found.rows["groups"]
    )  # fmt: skip
    heads = (
        Head("Conditions"), Head("Failed", "n"), Head("Expected", "n"), Head(f"Median life, {unit[1]}", "n"), Head("Off the law", "n"),
        Head("p of its own location", "n"),
    )  # fmt: skip
    return Table("Each group against the regression", heads, rows, found.queries["groups"].shown(), kind="wide")


def _batch_table(found: _Found) -> Table:
    rows = tuple(
        Row(
            (
                short(r["batch"], 40), f"{r['failures']} of {r['specimens']}",
                bounds(r["factor"], r["factor_lower"], r["factor_upper"]),
            )
        )
        for r in found.rows["batches"]
    )  # fmt: skip
    one = found.rows["batches"][0]
    upper = math.exp(one["tau_upper"]) if one["tau_upper"] < 700 else None
    factor = bounds(math.exp(one["tau"]), math.exp(one["tau_lower"]), upper)
    shown = f"Lives scatter between the {digits(one['batches'], 'batch', 'batches')} by a factor of {factor}"
    if one["p_value"] < 0.05:
        below = f"{shown} (one standard deviation; none: {p_equals(one['p_value'])}), within a batch by "
    else:
        below = f"No scatter between batches is shown ({p_equals(one['p_value'])}): {shown.lower()}, within a batch by "
    below += f"{significant(math.exp(one['sigma']))} (of ln t: {significant(one['sigma'])})."
    heads = (Head("Batch"), Head("Failed", "n"), Head("Life times", "n"))
    query = found.queries["batches"].shown()
    return Table("Batches as a random effect", heads, rows, query, "95 % intervals in brackets", below, "wide")


def _mode_table(found: _Found) -> Table:
    rows = tuple(
        Row(
            (
                visible(r["failure_mode"]), str(r["failures"]), _label(r["coefficient"]), capital(visible(r["model"])).replace("gray", "Gray"),
                bounds(r["value"], r["value_lower"], r["value_upper"]), p_value(r["p_value"]),
            )
        )
        for r in found.rows["modes"]
    )  # fmt: skip
    heads = (
        Head("Mode"), Head("Failures", "n"), Head("Covariate"), Head("Model"), Head("ln hazard per unit", "n"), Head("p", "n"),
    )  # fmt: skip
    below = "Cause-specific: on the hazard of the mode. Fine–Gray: on the probability to fail by it, others competing."
    return Table(
        "Effects on each mode of failure", heads, rows, found.queries["modes"].shown(), below=below, kind="wide"
    )


def _family_table(found: _Found) -> Table:
    rows = tuple(
        Row(
            (
                _family(r), compact(r["aic"], 5), bounds(r["sigma"], r["sigma_lower"], r["sigma_upper"]),
                ABSENT if r["shape"] is None else bounds(r["shape"], r["shape_lower"], r["shape_upper"]), p_value(r["p_value"]), _in_words(remark(r["tests"] or ABSENT)),
            ),
            "sel" if r["chosen"] else "",
        )
        for r in found.rows["regressions"]
    )  # fmt: skip
    heads = (
        Head("Family"), Head("AIC", "n"), Head("Scatter of ln t", "n"), Head("Shape", "n"), Head("p of the laws", "n"), Head("Tests", "text"),
    )  # fmt: skip
    caption = "Regressions that were tried"
    return Table(caption, heads, rows, found.queries["regressions"].shown(), "smaller AIC is better", kind="wide")
