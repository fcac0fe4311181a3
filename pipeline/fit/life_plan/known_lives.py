"""Plans for campaigns whose lives are known so far: the next test, and the tests that as many rig hours again carry."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.fit.life_plan.assumptions import ERRORS, LifeAssumptions, assume_as_fitted, doubt
from pipeline.fit.life_plan.designs import Known, LifePlan, Planner, Rig
from pipeline.fit.survival.covariates import Covariate
from pipeline.fit.survival.kaplan_meier import Estimate
from pipeline.fit.survival.life_regression import LifeRegression, fit_life_regression
from pipeline.fit.survival.lifetime_distributions import LOG_NORMAL, WEIBULL, Lives
from schemas.arrays import Float
from schemas.errors import DealabError, NotIdentifiableError
from schemas.life_covariates import INVERSE_POWER
from schemas.lifetimes import LifetimeRow
from schemas.numbers import significant

USE_SHARE = 0.6
"""Use conditions where nobody said them: this share of the lowest voltage tested, where lines of life end as well."""
SETUP_H = 0.25
"""Rig hours that a specimen costs beside its test, where nobody said them."""


@dataclass(frozen=True)
class KnownLives:
    """The lives of a campaign's configuration, their regression on the voltage, and the rig hours that they took."""

    campaign: str | None
    configuration: str | None
    fit: LifeRegression
    voltages_kv: tuple[float, ...]
    hours: float
    longest_h: float

    @property
    def assumed(self) -> LifeAssumptions:
        """What a plan may take for true, with the doubt that the lives leave, and about their family."""
        return doubt(assume_as_fitted(self.fit, self._middle_kv), (WEIBULL, LOG_NORMAL))

    @property
    def known(self) -> Known:
        at = np.log(self._middle_kv)
        change = np.array([[1.0, at, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        return Known(np.linalg.inv(change @ self.fit.covariance @ change.T), self.fit.failures)

    @property
    def specimens(self) -> int:
        return self.fit.specimens

    @property
    def _middle_kv(self) -> float:
        return float(np.exp(np.log(self.voltages_kv).mean()))

    def rig(self, use_kv: float | None = None, failed_share: float = 0.5, setup_h: float = SETUP_H) -> Rig:
        """Tests from use conditions up to the highest voltage so far, none longer than the longest so far."""
        lowest = self.voltages_kv[0]
        use = USE_SHARE * lowest if use_kv is None else use_kv
        return Rig(use, min(use, lowest), self.voltages_kv[-1], self.longest_h, setup_h, failed_share)

    def life_at(self, rig: Rig) -> Estimate:
        """Life at use in s by which the share that the rig is asked for has failed."""
        return self.fit.life_at(np.log([rig.use_kv]), rig.failed_share)


@dataclass(frozen=True)
class CampaignPlan:
    """What to test next in a campaign's configuration; no plans and the reason where there can be none."""

    campaign: str | None
    configuration: str | None
    rig: Rig | None
    life_at_use: Estimate | None
    budget_h: float | None
    plans: tuple[LifePlan, ...]
    refused: str = ""


def plan_campaigns(rows: Sequence[LifetimeRow]) -> tuple[CampaignPlan, ...]:
    """The next test and plans for as many rig hours and specimens again, for each configuration tested at several
    voltages.
    """
    found: list[CampaignPlan] = []
    for (campaign, configuration), members in group_rows(rows).items():
        if len({row.voltage_kv for row in members}) < 2:
            continue
        try:
            found.append(plan_known(know_lives(members)))
        except DealabError as error:
            found.append(CampaignPlan(campaign, configuration, None, None, None, (), error.shortcoming))
    return tuple(found)


def group_rows(rows: Sequence[LifetimeRow]) -> dict[tuple[str | None, str | None], list[LifetimeRow]]:
    """Lives with a voltage, by campaign and configuration."""
    grouped: dict[tuple[str | None, str | None], list[LifetimeRow]] = defaultdict(list)
    for row in rows:
        if row.voltage_kv is not None and row.upper_s > 0 and (row.failed or row.lifetime_s > 0):
            grouped[row.campaign or None, row.configuration].append(row)
    return dict(sorted(grouped.items(), key=lambda item: (item[0][0] or "", item[0][1] or "")))


def plan_known(lives: KnownLives) -> CampaignPlan:
    """The next test and the robust plan of one configuration, at the use conditions that are taken where nobody said
    them.
    """
    rig = lives.rig()
    budget = lives.hours + lives.specimens * rig.setup_h
    planner = Planner(lives.assumed, rig, lives.known)
    plans = (
        planner.next_test(worth_h=budget / lives.specimens),
        planner.robust(budget, lives.specimens),
        planner.even_grid(budget, lives.specimens),
    )
    return CampaignPlan(lives.campaign, lives.configuration, rig, lives.life_at(rig), budget, plans)


def know_lives(rows: Sequence[LifetimeRow]) -> KnownLives:
    """The lives of one configuration of a campaign and the regression of the family that describes them best.

    Raises
    ------
    NotIdentifiableError
        The lives carry no regression on the voltage, or do not fall with it.
    """
    voltage = np.array([row.voltage_kv for row in rows], dtype=np.float64)
    entered = np.array([row.entered_s or 0.0 for row in rows])
    lower, upper = (np.array([getattr(row, name) for row in rows]) for name in ("lower_s", "upper_s"))
    lives = Lives(lower, upper, entered if entered.any() else None)
    fit = _fit_best(lives, voltage)
    exponent = fit.coefficients[1].value.value
    if not exponent < 0:
        raise NotIdentifiableError(
            f"life does not fall with voltage (exponent {significant(exponent)}): no plan",
            expected="an exponent below 0",
        )
    ended = np.where(np.isfinite(upper), upper, lower)
    return KnownLives(
        rows[0].campaign or None,
        rows[0].configuration,
        fit,
        tuple(float(v) for v in np.unique(voltage)),
        float(ended.sum() / 3600),
        float(max(ended.max(), *(row.test_duration_s or 0.0 for row in rows)) / 3600),
    )


def _fit_best(lives: Lives, voltage_kv: Float) -> LifeRegression:
    covariate = Covariate("voltage_kv", INVERSE_POWER, voltage_kv, "kV")
    fits, errors = [], []
    for family in ERRORS:
        try:
            fits.append(fit_life_regression(lives, [covariate], family))
        except DealabError as error:
            errors.append(error)
    if not fits:
        raise errors[0]
    return min(fits, key=lambda fit: fit.aic)
