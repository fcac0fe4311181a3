"""From rows of lifetimes to survival per campaign, configuration and voltage, and comparisons within a campaign.

Belongs here: which rows can be used and what is wrong with the others, grouping, and the collection of all results with
their warnings. A row that contradicts itself is named, never averaged away. Does not belong here: the statistics
themselves (`survival` and its siblings) and tables (`pipeline.analyse.survival`).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.fit.survival.comparisons import NO_TEST, Comparison, compare, corrected
from pipeline.fit.survival.competing_causes import CompetingCauses, aalen_johansen
from pipeline.fit.survival.kaplan_meier import UNKNOWN, Estimate, KaplanMeier, kaplan_meier
from pipeline.fit.survival.life_models import CampaignLives, fit_life_models, name_conditions
from pipeline.fit.survival.lifetime_distributions import (
    DISTRIBUTIONS,
    EXPONENTIAL,
    WEIBULL,
    DistributionFit,
    LifeQuantile,
    Lives,
    estimate_quantiles,
    fit_distribution,
)
from pipeline.fit.survival.turnbull import Turnbull, estimate_turnbull
from pipeline.fit.survival.voltage_life import VoltageLife, fit_inverse_power_law
from schemas.arrays import Bool, Float
from schemas.errors import DealabError, NotIdentifiableError
from schemas.lifetimes import RAISED, LifetimeRow
from schemas.numbers import compact, joined, significant, with_unit

_Key = tuple[str | None, str | None, float | None]
"""Campaign, configuration and voltage of a group. Lives of other campaigns are another experiment, whatever their
configurations are called."""
_SAME_VOLTAGE = 0.005
"""Relative difference of two set voltages up to which they are one."""
_SAME_END = 0.01
_END_SLACK_S = 0.5
"""Censoring times within 1 % and 0.5 s of the last one belong to the planned end of the test."""
_ABOVE = 1.02


@dataclass(frozen=True)
class SurvivalSummary:
    """The numbers of one group; `Estimate`s are NaN where the data do not give one, and `warnings` says why.

    `restricted_to_s` is the shortest common follow-up of the groups at this voltage; `survival_at_end` belongs to it.
    """

    specimens: int
    failures: int
    restricted_mean_s: Estimate
    restricted_to_s: float
    median_s: Estimate
    survival_at_end: Estimate
    weibull_shape: Estimate
    weibull_scale_s: Estimate
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class SurvivalGroup:
    """All results of one configuration of a campaign at one voltage (None where the rows give none).

    `curve` is Turnbull's where failures were found at inspections or specimens came under watch late.
    """

    campaign: str | None
    configuration: str | None
    voltage_kv: float | None
    rows: tuple[LifetimeRow, ...]
    curve: KaplanMeier | Turnbull
    summary: SurvivalSummary
    distributions: tuple[DistributionFit, ...]
    quantiles: tuple[LifeQuantile, ...]
    causes: CompetingCauses

    @property
    def name(self) -> str:
        voltage = "" if self.voltage_kv is None else f" at {self.voltage_kv:g} kV"
        return f"{self.configuration or 'no configuration'}{voltage}"


@dataclass(frozen=True)
class SurvivalNote:
    """What is odd about a row, or was left out, and why; `specimen_id` is None where it is about more than one."""

    campaign: str | None
    configuration: str | None
    specimen_id: str | None
    text: str


@dataclass(frozen=True)
class SurvivalResults:
    """Groups, comparisons of configurations at equal voltage, laws over the voltages, and what was left out and why.

    `voltage_life` has one law per campaign and configuration tested at several voltages that can carry one,
    `life_models` the regressions of each campaign in which something was varied.
    """

    groups: tuple[SurvivalGroup, ...]
    comparisons: tuple[Comparison, ...]
    voltage_life: tuple[tuple[str | None, str | None, VoltageLife], ...]
    notes: tuple[SurvivalNote, ...]
    life_models: tuple[CampaignLives, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """The texts of the notes."""
        return tuple(note.text for note in self.notes)


def survival_group(lifetimes: Sequence[LifetimeRow]) -> SurvivalResults:
    """Survival of all specimens, by campaign, configuration and voltage, with comparisons at equal voltage in a campaign.

    Rows that cannot be used (negative or missing life, flags that contradict each other) are left out and named in
    `notes` and in the summary of their group; staircase tests have no life at one voltage and are left out as well.
    """
    usable, problems = _checked(lifetimes)
    grouped = _grouped(usable)
    notes: dict[_Key, list[str]] = defaultdict(list)
    general = [SurvivalNote(row.campaign or None, row.configuration, row.specimen_id, text) for row, text in problems]
    for row, text in problems:
        notes[_home(row, grouped)].append(text)
    voltages: dict[tuple[str | None, str | None], list[float | None]] = defaultdict(list)
    for campaign, configuration, voltage in grouped:
        voltages[campaign, configuration].append(voltage)
    for (campaign, configuration), levels in voltages.items():
        if len(levels) > 1:
            text = f"{configuration or 'no configuration'} was tested at {_listed(levels)}: one group per voltage"
            general.append(SurvivalNote(campaign, configuration, None, text))
            for level in levels:
                notes[campaign, configuration, level].append(text)
    for campaign in {key[0] for key in grouped}:
        own = [key for key in grouped if key[0] == campaign]
        if len(own) == 1 and not any(_varied(row, first) for first, *others in [grouped[own[0]]] for row in others):
            notes[own[0]].append(
                "all of its campaign under one condition: no comparison, no law of voltage, no regression"
            )
    ends = _common_ends(grouped)
    groups = tuple(_group(key, rows, ends[key[0], key[2]], tuple(notes[key])) for key, rows in grouped.items())
    comparisons = corrected(
        [
            comparison
            for i, a in enumerate(groups)
            for b in groups[i + 1 :]
            if (a.campaign, a.voltage_kv) == (b.campaign, b.voltage_kv)
            for comparison in _compared(a, b, ends[a.campaign, a.voltage_kv])
        ]
    )
    laws, refused = _laws(groups)
    return SurvivalResults(groups, comparisons, laws, (*general, *refused), fit_life_models(usable))


def _varied(row: LifetimeRow, other: LifetimeRow) -> bool:
    """Whether two lives differ in anything that a life may depend on."""
    return any(row.condition(name) != other.condition(name) for name in name_conditions((row, other)))


def usable_lives(lifetimes: Sequence[LifetimeRow]) -> list[LifetimeRow]:
    """The rows that `survival_group` uses, as it counts them."""
    return _checked(lifetimes)[0]


def _checked(lifetimes: Sequence[LifetimeRow]) -> tuple[list[LifetimeRow], list[tuple[LifetimeRow, str]]]:
    """Usable rows, and (row, what is wrong with it) for all others and for those kept with a contradiction."""
    usable: list[LifetimeRow] = []
    problems: list[tuple[LifetimeRow, str]] = []
    for row in lifetimes:
        fatal = _unusable(row)
        if fatal:
            problems.append((row, f"{row.name}: {fatal}; left out"))
            continue
        kept, odd = _contradiction(row)
        usable.append(_to_planned_end(kept))
        if odd:
            problems.append((row, f"{row.name}: {odd}"))
    seen: dict[tuple[str | None, str], LifetimeRow] = {}
    for row in usable:
        name = row.campaign, row.specimen_id
        if name in seen:
            problems.append((row, f"{row.name}: the same specimen as {seen[name].name}: not independent"))
        seen.setdefault(name, row)
    return usable, problems


def _unusable(row: LifetimeRow) -> str:
    if not math.isfinite(row.lifetime_s):
        return "no lifetime"
    if row.lifetime_s < 0:
        return f"negative lifetime {row.lifetime_s:g} s"
    if row.staircase:
        broke = f", broke down at {row.breakdown_voltage_kv:g} kV" if row.breakdown_voltage_kv is not None else ""
        return f"staircase test{broke}: no life at one voltage"
    if row.failed and row.censored_because:
        return f"failed and censored at once ({row.censored_because})"
    if _broke_above(row) and row.test_duration_s is None:
        return f"failed at {row.breakdown_voltage_kv:g} kV, above the {row.voltage_kv:g} kV of the test"
    return ""


def _broke_above(row: LifetimeRow) -> bool:
    return bool(
        row.failed
        and row.breakdown_voltage_kv
        and row.voltage_kv
        and row.breakdown_voltage_kv > _ABOVE * row.voltage_kv
    )


def _contradiction(row: LifetimeRow) -> tuple[LifetimeRow, str]:
    """The row as it is counted, and what is odd about it."""
    if _broke_above(row) and row.test_duration_s is not None:
        life = min(row.lifetime_s, row.test_duration_s)
        kept = replace(row, failed=False, lifetime_s=life, censored_because=RAISED)
        return kept, (
            f"failed at {row.breakdown_voltage_kv:g} kV, above the {row.voltage_kv:g} kV of the test: counted as "
            f"surviving {life:g} s"
        )
    if row.failed and row.failure_site == "none":
        return row, f"failed at {row.lifetime_s:g} s, but failure_site is none; counted as failed"
    if row.failed and row.test_duration_s is not None and row.lifetime_s > row.test_duration_s + _END_SLACK_S:
        return row, f"failed at {row.lifetime_s:g} s, after the test of {row.test_duration_s:g} s; counted as failed"
    if not row.failed and row.failure_site not in (None, "none", "unknown") and row.breakdown_voltage_kv is None:
        return row, f"censored at {row.lifetime_s:g} s, but failure_site is {row.failure_site}; counted as censored"
    return row, ""


def _to_planned_end(row: LifetimeRow) -> LifetimeRow:
    """A survivor who reached the planned end counts as watched up to it: when exactly it was switched off, within 0.5 s
    or 1 % of the test, says nothing about the film, and would scatter the group's common end.
    """
    planned = row.test_duration_s
    if row.failed or planned is None or abs(row.lifetime_s - planned) > min(_END_SLACK_S, _SAME_END * planned):
        return row
    return replace(row, lifetime_s=planned)


def _grouped(rows: Sequence[LifetimeRow]) -> dict[_Key, list[LifetimeRow]]:
    campaigns: dict[str | None, list[LifetimeRow]] = defaultdict(list)
    for row in rows:
        campaigns[row.campaign or None].append(row)
    grouped: dict[_Key, list[LifetimeRow]] = defaultdict(list)
    for campaign, members in campaigns.items():
        levels = _voltage_levels(members)
        for row in members:
            grouped[campaign, row.configuration, levels.get(row.voltage_kv)].append(row)
    return dict(sorted(grouped.items(), key=lambda item: (item[0][0] or "", item[0][1] or "", item[0][2] or 0.0)))


def _voltage_levels(rows: Sequence[LifetimeRow]) -> dict[float | None, float]:
    """The voltage under which each set voltage is grouped: those closer than 0.5 % are one, named by their median."""
    found = sorted(row.voltage_kv for row in rows if row.voltage_kv is not None)
    levels: dict[float | None, float] = {}
    start = 0
    for i in range(len(found)):
        if i + 1 == len(found) or found[i + 1] > found[i] * (1 + _SAME_VOLTAGE):
            cluster = found[start : i + 1]
            levels |= dict.fromkeys(cluster, cluster[len(cluster) // 2])
            start = i + 1
    return levels


def _home(row: LifetimeRow, grouped: dict[_Key, list[LifetimeRow]]) -> _Key:
    """The group a problem belongs to, also for rows that were left out of it."""
    own = row.campaign or None, row.configuration
    for campaign, configuration, voltage in grouped:
        if (campaign, configuration) == own and (
            voltage == row.voltage_kv
            or (voltage and row.voltage_kv and abs(row.voltage_kv / voltage - 1) <= _SAME_VOLTAGE)
        ):
            return campaign, configuration, voltage
    return *own, row.voltage_kv


def _arrays(rows: Sequence[LifetimeRow]) -> tuple[Float, Bool]:
    return np.array([row.lifetime_s for row in rows]), np.array([row.failed for row in rows], dtype=np.bool_)


def _common_ends(grouped: dict[_Key, list[LifetimeRow]]) -> dict[tuple[str | None, float | None], float]:
    """Shortest common follow-up in s by campaign and voltage.

    A group that failed completely is known for all times. Otherwise its follow-up ends with the test: at the first of
    the censoring times that belong to the planned end, so that nobody who survived the test is missing there.
    """
    ends: dict[tuple[str | None, float | None], float] = {}
    longest: dict[tuple[str | None, float | None], float] = {}
    for (campaign, _, voltage), rows in grouped.items():
        test = campaign, voltage
        time, failed = _arrays(rows)
        longest[test] = max(longest.get(test, 0.0), float(time.max()))
        if not failed.all():
            censored = time[~failed]
            last = float(censored.max())
            end = float(censored[censored >= last * (1 - _SAME_END) - _END_SLACK_S].min())
            ends[test] = min(ends.get(test, math.inf), end)
    return {test: ends.get(test, longest[test]) for test in longest}


def _group(key: _Key, rows: Sequence[LifetimeRow], end: float, notes: tuple[str, ...]) -> SurvivalGroup:
    lives = _lives(rows)
    curve = _estimate(rows, lives)
    fits, refusals = _distributions(rows, lives)
    weibull = next((fit.parameters for fit in fits if fit.distribution == WEIBULL), None)
    warnings = (*notes, *_group_warnings(rows, curve, end), *refusals)
    summary = SurvivalSummary(
        specimens=len(rows),
        failures=curve.failed,
        restricted_mean_s=curve.restricted_mean(end) if end > 0 and isinstance(curve, KaplanMeier) else UNKNOWN,
        restricted_to_s=end,
        median_s=curve.median(),
        survival_at_end=curve.at(end),
        weibull_shape=weibull["shape"] if weibull else UNKNOWN,
        weibull_scale_s=weibull["scale_s"] if weibull else UNKNOWN,
        warnings=tuple(dict.fromkeys(warnings)),
    )
    causes = CompetingCauses((), np.empty(0))
    if isinstance(curve, KaplanMeier):
        causes = aalen_johansen(*_arrays(rows), [row.failure_site or row.failure_mode for row in rows])
    quantiles = tuple(
        q for fit in fits if lives and fit.distribution != EXPONENTIAL for q in estimate_quantiles(lives, fit)
    )
    return SurvivalGroup(*key, tuple(rows), curve, summary, fits, quantiles, causes)


def _lives(rows: Sequence[LifetimeRow]) -> Lives | None:
    """What is known of the lives that have a place on a logarithmic axis; None where there are none.

    A survivor of 0 s says nothing, a failure at 0 s came before the shortest life above 0 (`Lives.right_censored`).
    """
    if not _need_turnbull(rows):
        try:
            return Lives.right_censored(*_arrays(rows))
        except NotIdentifiableError:
            return None
    kept = [row for row in rows if row.failed or row.lifetime_s > 0]
    shortest = min((row.lifetime_s for row in kept if row.lifetime_s > 0), default=0.0)
    if not shortest:
        return None
    lower = np.array([row.lower_s for row in kept])
    upper = np.array([row.upper_s or shortest for row in kept])
    entered = np.array([row.entered_s or 0.0 for row in kept])
    return Lives(lower, upper, entered if entered.any() else None)


def _estimate(rows: Sequence[LifetimeRow], lives: Lives | None) -> KaplanMeier | Turnbull:
    """Kaplan–Meier, or Turnbull's curve where it does not apply and somebody failed."""
    if lives is None or lives.failures == 0 or not _need_turnbull(rows):
        return kaplan_meier(*_arrays(rows))
    return estimate_turnbull(lives)


def _need_turnbull(rows: Sequence[LifetimeRow]) -> bool:
    """Some failures were found at inspections, or some specimens came under watch late."""
    return any(row.alive_at_s is not None or row.entered_s is not None for row in rows)


def _distributions(
    rows: Sequence[LifetimeRow], lives: Lives | None
) -> tuple[tuple[DistributionFit, ...], tuple[str, ...]]:
    fits: list[DistributionFit] = []
    refused: dict[str, list[str]] = {}
    if lives is None:
        return (), ("no lifetime above 0 s",)
    for distribution in DISTRIBUTIONS:
        try:
            fits.append(fit_distribution(lives, distribution))
        except NotIdentifiableError as error:
            law, _, reason = error.problem.partition(": ")
            refused.setdefault(reason, []).append(law)
    refusals = [f"{joined(laws)}: {reason}" for reason, laws in refused.items()]
    at_once = sum(row.failed and row.lifetime_s == 0 for row in rows)
    if at_once and fits:
        refusals.append(
            f"{at_once} failed at 0 s: in the distributions they count as failed before the shortest life above 0"
        )
    return tuple(fits), tuple(refusals)


def _group_warnings(rows: Sequence[LifetimeRow], curve: KaplanMeier | Turnbull, end: float) -> list[str]:
    warnings = []
    if rows[0].configuration is None:
        warnings.append("specimens without a configuration")
    if len({row.voltage_kv for row in rows}) > 1:
        warnings.append(
            f"set voltages of {_listed(sorted({row.voltage_kv for row in rows if row.voltage_kv}))} taken as one"
        )
    if len(rows) == 1:
        warnings.append("one specimen: its life says next to nothing about the configuration")
    if isinstance(curve, Turnbull):
        warnings += _inspection_warnings(rows)
    elif curve.failed == 0:
        observed = float(sum(row.lifetime_s for row in rows))
        n = int(curve.number_at_risk(end))
        warnings.append(
            f"nobody failed: survival to {with_unit(compact(end, 4), 's')} is at least {0.025 ** (1 / n):.3f} (two-sided 95 %, exact, {n} specimens), "
            f"{0.05 ** (1 / n):.3f} one-sided; if lives are exponential their mean is at least "
            f"{with_unit(significant(observed / -math.log(0.05)), 's')} (one-sided 95 %)"
        )
    elif curve.failed < len(rows):
        early = sum(not row.failed and row.lifetime_s < end for row in rows)
        if early:
            warnings.append(f"{early} censored before {with_unit(compact(end, 4), 's')}")
    undecided = [row.name for row in rows if row.decided is False]
    if undecided:
        warnings.append(f"breakdown or switch-off cannot be decided: {', '.join(undecided)}")
    return warnings


def _inspection_warnings(rows: Sequence[LifetimeRow]) -> list[str]:
    warnings = []
    between = sum(row.alive_at_s is not None for row in rows)
    late = sum(row.entered_s is not None for row in rows)
    if between:
        warnings.append(
            f"{between} failures are only known to lie between inspections: Turnbull's curve, which is not known within its"
            " intervals; no restricted mean, and no probability by cause"
        )
    if late:
        warnings.append(
            f"{late} came under watch late: the curve holds for specimens that have lived until the first of them; no"
            " restricted mean, and no probability by cause"
        )
    return warnings


def _compared(a: SurvivalGroup, b: SurvivalGroup, end: float) -> list[Comparison]:
    if isinstance(a.curve, Turnbull) or isinstance(b.curve, Turnbull):
        reason = "lives between inspections or watched late: no test by ranks"
        return [
            Comparison(a.configuration, b.configuration, a.voltage_kv, NO_TEST, warnings=(reason,), campaign=a.campaign)
        ]
    first, second = _arrays(a.rows), _arrays(b.rows)
    found = compare(a.configuration, first, b.configuration, second, a.voltage_kv, end)
    return [replace(one, campaign=a.campaign) for one in found]


def _laws(
    groups: Sequence[SurvivalGroup],
) -> tuple[tuple[tuple[str | None, str | None, VoltageLife], ...], tuple[SurvivalNote, ...]]:
    by_configuration: dict[tuple[str | None, str | None], list[SurvivalGroup]] = defaultdict(list)
    for group in groups:
        if group.voltage_kv is not None:
            by_configuration[group.campaign, group.configuration].append(group)
    laws: list[tuple[str | None, str | None, VoltageLife]] = []
    refused: list[SurvivalNote] = []
    for (campaign, configuration), members in by_configuration.items():
        if len(members) < 2:
            continue
        known = [(row, group.voltage_kv) for group in members for row in group.rows if row.failed or row.lifetime_s > 0]
        lives = _lives([row for row, _ in known])
        if lives is None:
            continue
        try:
            law = fit_inverse_power_law(lives, np.array([voltage for _, voltage in known]))
        except DealabError as error:
            text = f"{configuration or 'no configuration'}, inverse power law: {error.problem}"
            refused.append(SurvivalNote(campaign, configuration, None, text))
        else:
            laws.append((campaign, configuration, law))
    return tuple(laws), tuple(refused)


def _listed(voltages: Sequence[float | None]) -> str:
    return ", ".join("no voltage" if v is None else f"{v:g} kV" for v in voltages)
