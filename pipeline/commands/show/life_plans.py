"""Plans of life tests in words, or for a program."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pipeline.commands.show.rows import as_finite_json, in_plain
from pipeline.fit.life_plan.assumptions import LifeAssumptions, assume_life
from pipeline.fit.life_plan.designs import EVEN_GRID, NEXT_TEST, LifePlan, Planner, Rig, plan_all
from pipeline.fit.life_plan.known_lives import KnownLives, group_rows, know_lives
from pipeline.fit.life_plan.two_designs import Comparison, size_comparison
from pipeline.fit.survival.groups import usable_lives
from pipeline.fit.survival.lifetime_distributions import LOG_NORMAL, WEIBULL
from pipeline.lab.lab import Lab
from pipeline.lab.reader import Reader
from schemas.errors import UsageError
from schemas.lifetimes import LifetimeRow
from schemas.numbers import ABSENT, bounds, digits, percent, significant


@dataclass(frozen=True)
class Asked:
    """The arguments of `dealab plan lifetimes`; None where they were not given."""

    campaign: str | None
    configuration: str | None
    use_kv: float | None
    failed_share: float
    at_kv: float | None
    median_h: float | None
    median_factor: float
    exponent: float | None
    exponent_sd: float
    shape: float
    shape_factor: float
    from_kv: float | None
    to_kv: float | None
    longest_h: float | None
    setup_h: float
    hours: float | None
    most_specimens: int | None
    limits_ratio: float | None
    ratio: float | None
    power: float
    looks: int

    def require(self, name: str) -> float:
        """The number of an argument that cannot be done without here."""
        value: float | None = getattr(self, name)
        if value is None:
            raise UsageError(f"--{name.replace('_', '-')} is missing", remedy="The help of the command says what it is")
        return value


def plan_lifetimes(asked: Asked, lab: Lab | None, *, as_json: bool) -> str:
    """What is asked for: a comparison of two designs where a ratio is given, else plans for life at use.

    Parameters
    ----------
    asked : the arguments
    lab : whose lives are known; None: lives are assumed

    Raises
    ------
    UsageError, NotIdentifiableError, LabError
        An argument is missing or has no meaning, the lives carry no plan, or there is no database.
    """
    known = None if lab is None else know_lives(_choose(read_lives(lab), asked))
    assumed = _assume(asked) if known is None else known.assumed
    if asked.ratio is not None:
        sized = _size(asked, assumed, known)
        return as_finite_json(asdict(sized)) if as_json else in_plain("\n".join(_describe_sizes(sized)))
    rig = _rig(asked, known)
    planner = Planner(assumed, rig, None if known is None else known.known)
    budget = _budget(asked, planner, known)
    plans = plan_all(planner, budget, asked.most_specimens)
    if known is not None:
        plans = (planner.next_test(worth_h=known.hours / known.specimens), *plans)
    if as_json:
        return as_finite_json(
            {"rig": asdict(rig), "budget_h": budget, "plans": [_plan_as_dict(plan) for plan in plans]}
        )
    return in_plain("\n".join(_describe_plans(assumed, rig, budget, plans, known)))


def read_lives(lab: Lab) -> list[LifetimeRow]:
    """All lives of the lab's database."""
    lab.require_database()
    names = set(LifetimeRow.__dataclass_fields__) - {"warnings", "staircase", "covariates"}
    with Reader(lab.database) as reader:
        rows = reader.rows("lifetimes")
    return [
        LifetimeRow(**{name: row[name] for name in names & set(row)}, staircase=bool(row["staircase"])) for row in rows
    ]


def _choose(rows: list[LifetimeRow], asked: Asked) -> list[LifetimeRow]:
    """The lives of the campaign's configuration that is asked for."""
    grouped = group_rows(usable_lives(rows))
    own = {configuration: lives for (campaign, configuration), lives in grouped.items() if campaign == asked.campaign}
    if not own:
        known = ", ".join(sorted({campaign or "no campaign" for campaign, _ in grouped})) or "none"
        raise UsageError(
            f'no lives under voltage in campaign "{str(asked.campaign)[:80]}"', expected=f"one of: {known}"
        )
    if asked.configuration is None and len(own) == 1:
        return next(iter(own.values()))
    if asked.configuration not in own:
        names = ", ".join(str(name) for name in own)
        found = "no --configuration" if asked.configuration is None else f'configuration "{asked.configuration[:80]}"'
        raise UsageError(f"{found}", expected=f"one of: {names}")
    return own[asked.configuration]


def _assume(asked: Asked) -> LifeAssumptions:
    return assume_life(
        reference_kv=asked.require("at_kv"),
        median_h=asked.require("median_h"),
        exponent=asked.require("exponent"),
        shape=asked.shape,
        median_factor=asked.median_factor,
        exponent_sd=asked.exponent_sd,
        shape_factor=asked.shape_factor,
        families=(WEIBULL, LOG_NORMAL),
    )


def _rig(asked: Asked, known: KnownLives | None) -> Rig:
    if known is None:
        use = asked.require("use_kv")
        low, high, longest = asked.from_kv or use, asked.require("to_kv"), asked.require("longest_h")
        return Rig(use, low, high, longest, asked.setup_h, asked.failed_share)
    so_far = known.rig(asked.use_kv, asked.failed_share, asked.setup_h)
    return Rig(
        so_far.use_kv,
        so_far.lowest_kv if asked.from_kv is None else asked.from_kv,
        so_far.highest_kv if asked.to_kv is None else asked.to_kv,
        so_far.longest_h if asked.longest_h is None else asked.longest_h,
        asked.setup_h,
        asked.failed_share,
    )


def _budget(asked: Asked, planner: Planner, known: KnownLives | None) -> float:
    if asked.limits_ratio is not None:
        if asked.hours is not None or asked.most_specimens is not None:
            raise UsageError(
                "--limits-ratio together with --hours or --most-specimens", expected="a wanted interval, or a budget"
            )
        return planner.hours_for(asked.limits_ratio)
    if asked.hours is None and known is not None:
        return known.hours + known.specimens * asked.setup_h
    return asked.require("hours")


def _size(asked: Asked, assumed: LifeAssumptions, known: KnownLives | None) -> Comparison:
    longest = asked.longest_h if known is None else asked.longest_h or known.longest_h
    voltage = asked.at_kv or assumed.reference_kv
    return size_comparison(
        assumed.sure().scenarios()[0],
        float(asked.ratio or 1.0),
        voltage,
        asked.require("longest_h") if longest is None else longest,
        power=asked.power,
        setup_h=asked.setup_h,
        looks=asked.looks,
    )


def _plan_as_dict(plan: LifePlan) -> dict[str, Any]:
    return {**asdict(plan), "specimens": plan.specimens, "failures": plan.failures, "hours": plan.hours}


def _describe_plans(
    assumed: LifeAssumptions, rig: Rig, budget: float, plans: tuple[LifePlan, ...], known: KnownLives | None
) -> Iterator[str]:
    share = "median life" if rig.failed_share == 0.5 else f"life by which {percent(rig.failed_share)} have failed"
    yield f"Plans for the {share} at {rig.use_kv:g} kV, {significant(budget)} rig hours"
    sure = assumed.sure().scenarios()[0]
    sds = np.sqrt(np.diag(assumed.covariance))
    shape = f"{assumed.family} shape {significant(1 / sure.sigma)} (within × {significant(float(np.exp(sds[2])), 2)})"
    yield (
        f"  {'assumed' if known is None else 'known'}: median life"
        f" {significant(sure.life_s(assumed.reference_kv) / 3600)} h at"
        f" {assumed.reference_kv:.3g} kV (within × {significant(float(np.exp(sds[0])), 2)}), exponent"
        f" {significant(sure.exponent)} ± {significant(float(sds[1]), 2)}, {shape}; at use"
        f" {significant(sure.life_s(rig.use_kv, rig.failed_share) / 3600)} h"
    )
    if known is not None:
        life = known.life_at(rig)
        yield (
            f"  so far: {digits(known.specimens, 'specimen')}, {known.fit.failures} failed; at use"
            f" {bounds(life.value, life.lower, life.upper, 1 / 3600)} h, limits apart by ×"
            f" {significant(life.upper / life.lower)}"
        )
    yield (
        f"  tests from {rig.lowest_kv:g} to {rig.highest_kv:g} kV, none longer than {rig.longest_h:g} h;"
        f" {rig.setup_h:g} h of"
        " set-up per specimen"
    )
    for plan in plans:
        yield ""
        yield from _describe_plan(plan)
    by_name = {plan.name: plan for plan in plans}
    grid = by_name[EVEN_GRID]
    yield ""
    for plan in plans:
        if plan.name not in (EVEN_GRID, NEXT_TEST) and known is None:
            less = 1 - np.log(plan.factor_for(grid.hours)) / np.log(grid.factor)
            yield (
                f"At equal rig hours the {plan.name} plan's interval of ln life is {percent(abs(float(less)))}"
                f" {'narrower' if less > 0 else 'wider'} than the even grid's."
            )


def _describe_plan(plan: LifePlan) -> Iterator[str]:
    worst = f"× {significant(plan.worst_factor)}" if plan.worst_factor < 1e4 else "open"
    yield (
        f"{plan.name[0].upper()}{plan.name[1:]}: {digits(plan.specimens, 'specimen')},"
        f" {significant(plan.failures)} failures expected,"
        f" {significant(plan.hours)} rig h"
    )
    yield f"  {'kV':>7} {'up to h':>9} {'specimens':>10} {'failures':>9} {'rig h':>8}"
    for test in plan.tests:
        yield (
            f"  {test.voltage_kv:>7.3g} {significant(test.duration_h):>9} {test.specimens:>10}"
            f" {significant(test.failures):>9}"
            f" {significant(test.hours):>8}"
        )
    yield f"  95 % limits apart by × {significant(plan.factor)}; under the least favourable lives: {worst}"


def _describe_sizes(sized: Comparison) -> Iterator[str]:
    yield (
        f"{digits(sized.specimens_each, 'specimen')} of each design tell lives apart that differ by a factor of"
        f" {sized.ratio:g}, at"
        f" {sized.voltage_kv:.3g} kV for {sized.duration_h:g} h"
    )
    yield (
        f"  power {percent(sized.power)} and false alarms {percent(sized.false_alarm)} of the log-rank test, in"
        f" simulated campaigns;"
        f" {significant(sized.failures)} failures, {significant(sized.hours)} rig h expected"
    )
    if sized.stopping is None:
        return
    yield "  Looks that may end it early (bounds that spend the error as O'Brien and Fleming's):"
    yield f"  {'failures':>9} {'stop if p <':>12} {'false alarms':>13} {'power':>7}"
    for look in sized.stopping.looks:
        bound = f"{look.p_value:.2g}" if look.p_value > 1e-12 else ABSENT
        yield (
            f"  {round(look.share * sized.failures):>9} {bound:>12} {percent(look.false_alarm):>13}"
            f" {percent(look.power):>7}"
        )
    yield f"  On average it ends after {percent(sized.stopping.expected_share)} of the failures where lives differ so."
