"""Life regressions of each campaign: which covariates its lives can tell about, which family describes them, Cox's check.

Belongs here: the choice of covariates and of the model, and what is asked of it. A covariate that the lives tell nothing
about is left out with its reason. The regressions themselves are in `life_regression`, `cox_regression`,
`cause_regression`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.fit.survival.batch_scatter import BatchScatter, fit_batch_scatter
from pipeline.fit.survival.cause_regression import CauseRegression, fit_cause_regression
from pipeline.fit.survival.covariates import LAWS, Covariate, make_design
from pipeline.fit.survival.cox_regression import CoxRegression, fit_cox
from pipeline.fit.survival.endurance_limit import EnduranceLimit, find_endurance_limit
from pipeline.fit.survival.kaplan_meier import Estimate
from pipeline.fit.survival.life_regression import FAMILIES, GENERALISED_GAMMA, LifeRegression, fit_life_regression
from pipeline.fit.survival.lifetime_distributions import WEIBULL, Lives
from pipeline.fit.survival.proportional_hazards import ProportionalityTest, check_proportional_hazards
from schemas.arrays import Float
from schemas.errors import DealabError, NotIdentifiableError, RefusedError
from schemas.life_covariates import ARRHENIUS, CATEGORY, EXPONENTIAL_LAW, INVERSE_POWER
from schemas.lifetimes import LifetimeRow
from schemas.numbers import compact, digits, joined, with_unit

NO_FAMILY = "none"
_STRESSES = (
    ("voltage_kv", INVERSE_POWER, "kV"),
    ("temperature_c", ARRHENIUS, "°C"),
    ("humidity", INVERSE_POWER, ""),
    ("frequency_hz", INVERSE_POWER, "Hz"),
)
"""Humidity by a power law is Peck's, in ln of the relative humidity."""
_CATEGORIES = ("configuration", "electrode", "batch")
"""A batch is also looked at as a random effect, which many batches of few specimens can carry."""
_CONDITIONS = (*(name for name, *_ in _STRESSES), *_CATEGORIES)
_BATCH = "batch"
_PER_COLUMN = 2
"""Distinct failures that a column of the design needs: with fewer, profiles of all coefficients are open."""
_POINTS = 11
"""Of a life–stress line below the lowest stress that was tested; between the tests there are twice as many."""
_BELOW, _BEYOND = 0.6, 0.4
"""A line goes down to this share of the lowest stress, of one with a zero of no meaning by this share of the tested range: use
conditions lie there."""


@dataclass(frozen=True)
class LifeModel:
    """A regression of a campaign's lives by a family, with the voltage by a law ("" where it is no covariate)."""

    stress_law: str
    regression: LifeRegression
    chosen: bool = False


@dataclass(frozen=True)
class LifePoint:
    """Median life in s by the chosen model at a stress, all other stresses at their mean; outside of the tests or not."""

    group: str
    stress: str
    value: float
    life_s: Estimate
    is_extrapolated: bool
    stress_law: str
    stress_unit: str


@dataclass(frozen=True)
class GroupPoint:
    """Where a group of specimens stands against the chosen model: its stress, and its own median life in s.

    `line_life_s` is that life moved to where the line of its `category` is drawn, with all other covariates at their mean.
    """

    group: str
    stress: str
    value: float
    life_s: float
    category: str
    line_life_s: float


@dataclass(frozen=True)
class Contrast:
    """What a column of the chosen regression is read over: `change` of its values, `words` such as "6 kV over 4 kV"."""

    coefficient: str
    words: str
    change: float


@dataclass(frozen=True)
class CampaignLives:
    """Everything the regressions tell about a campaign.

    `rows` are the lives that were used, in the order of the residuals; `refused` says what could not be had, and why.
    `proportionality` tests what Cox's model assumes, `limit` is the voltage below which nothing may ever fail,
    `batches` the scatter between batches beside all other covariates. `covariates` are those of the chosen model.
    """

    campaign: str | None
    rows: tuple[LifetimeRow, ...]
    models: tuple[LifeModel, ...]
    cox: CoxRegression | None
    points: tuple[LifePoint, ...]
    group_points: tuple[GroupPoint, ...]
    modes: tuple[CauseRegression, ...]
    refused: tuple[str, ...]
    contrasts: tuple[Contrast, ...] = ()
    proportionality: tuple[ProportionalityTest, ...] = ()
    limit: EnduranceLimit | None = None
    batches: BatchScatter | None = None
    covariates: tuple[Covariate, ...] = ()

    @property
    def lives(self) -> Lives:
        """What the regressions were fitted to."""
        return _limits(self.rows)

    @property
    def observed_hazards(self) -> Float:
        """(n,) Nelson and Aalen's cumulative hazard of the Cox–Snell residuals of the chosen model, at each of them."""
        fit = self.chosen.regression if self.chosen else None
        if fit is None:
            return np.empty(0)
        failed = np.array([row.failed for row in self.rows])
        ends, place = np.unique(fit.cox_snell, return_inverse=True)
        at_risk = failed.size - np.searchsorted(np.sort(fit.cox_snell), ends, side="left")
        return np.asarray(np.cumsum(np.bincount(place[failed], minlength=ends.size) / at_risk)[place])

    @property
    def conditions(self) -> tuple[str, ...]:
        """Of each row, as the groups of the regressions are called."""
        return tuple(_describe_conditions(row) for row in self.rows)

    @property
    def chosen(self) -> LifeModel | None:
        return next((model for model in self.models if model.chosen), None)


def fit_life_models(rows: Sequence[LifetimeRow]) -> tuple[CampaignLives, ...]:
    """Regressions of every campaign whose lives were tested under more than one condition.

    Parameters
    ----------
    rows : usable lives of all campaigns

    Returns
    -------
    tuple of CampaignLives
        Campaigns in which nothing was varied are not among them.
    """
    campaigns: dict[str | None, list[LifetimeRow]] = defaultdict(list)
    for row in rows:
        if row.failed or row.lifetime_s > 0:
            campaigns[row.campaign or None].append(row)
    found = (_Campaign(name, members).fit() for name, members in sorted(campaigns.items(), key=lambda c: c[0] or ""))
    return tuple(one for one in found if one is not None)


@dataclass
class _Campaign:
    """The lives of a campaign on their way to a `CampaignLives`."""

    name: str | None
    rows: list[LifetimeRow]
    refused: list[str] = field(default_factory=list)

    def fit(self) -> CampaignLives | None:
        varied = [name for name in name_conditions(self.rows) if self._values(name) > 1]
        if not varied:
            return None
        for name in varied:
            self._keep_those_with(name)
        if not any(row.failed for row in self.rows):
            return self._without("nobody failed: no regression")
        lives = _limits(self.rows)
        covariates = self._informative(varied, np.isfinite(lives.upper), lives.distinct_failures)
        models = self._models(lives, covariates) if covariates else []
        batches = self._batches(lives, covariates, models) if _BATCH in varied else None
        if not models:
            return self._without(batches=batches)
        limit = self._limit(lives, covariates, models)
        best = min(range(len(models)), key=lambda i: models[i].regression.aic)
        models = [LifeModel(m.stress_law, m.regression, i == best) for i, m in enumerate(models)]
        if models[best].stress_law == EXPONENTIAL_LAW:
            covariates = _with_law(covariates, EXPONENTIAL_LAW)
        points, group_points = _stress_lines(models[best].regression, covariates, self._groups())
        cox, proportionality = self._cox(lives, covariates)
        return CampaignLives(
            self.name,
            tuple(self.rows),
            tuple(models),
            cox,
            points,
            group_points,
            self._modes(lives, covariates),
            tuple(self.refused),
            tuple(contrast for one in covariates for contrast in _contrasts(one)),
            proportionality,
            limit,
            batches,
            tuple(covariates),
        )

    def _without(self, *reasons: str, batches: BatchScatter | None = None) -> CampaignLives:
        self.refused += reasons
        return CampaignLives(self.name, tuple(self.rows), (), None, (), (), (), tuple(self.refused), batches=batches)

    def _values(self, name: str) -> int:
        return len({row.condition(name) for row in self.rows} - {None})

    def _keep_those_with(self, name: str) -> None:
        without = [row for row in self.rows if row.condition(name) is None]
        if without:
            self.rows = [row for row in self.rows if row.condition(name) is not None]
            self.refused.append(
                f"{digits(len(without), 'life has', 'lives have')} no {name}: left out of the regression"
            )

    def _informative(self, varied: Sequence[str], failed: np.ndarray, distinct: int) -> list[Covariate]:
        """The covariates that the lives tell something about; the reasons of the others are kept."""
        kept: list[Covariate] = []
        for name in varied:
            try:
                one = _covariate(name, self.rows)
                design = make_design([*kept, one], failed)
                if distinct < _PER_COLUMN * design.x.shape[1] + 2:
                    raise NotIdentifiableError(f"{distinct} distinct failures do not carry {design.x.shape[1]} effects")
            except DealabError as error:
                self.refused.append(f"{name} is not in the regression: {error.problem}")
            else:
                kept.append(one)
        return kept

    def _groups(self) -> list[str]:
        """One name for each different set of conditions."""
        return [_describe_conditions(row) for row in self.rows]

    def _models(self, lives: Lives, covariates: Sequence[Covariate]) -> list[LifeModel]:
        by_voltage = covariates[0].name == "voltage_kv"
        law = INVERSE_POWER if by_voltage else ""
        found = [
            LifeModel(law, fit)
            for family in FAMILIES
            if (fit := self._regression(lives, covariates, family)) is not None
        ]
        if by_voltage and found:
            family = min(found, key=lambda m: m.regression.aic).regression.family
            other = self._regression(lives, _with_law(covariates, EXPONENTIAL_LAW), family)
            found += [LifeModel(EXPONENTIAL_LAW, other)] if other is not None else []
        return found

    def _regression(self, lives: Lives, covariates: Sequence[Covariate], family: str) -> LifeRegression | None:
        try:
            return fit_life_regression(lives, covariates, family, groups=self._groups())
        except DealabError as error:
            self.refused.append(f"{family}: {error.problem}")
        except np.linalg.LinAlgError:
            self.refused.append(f"{family}: the lives do not tell its parameters apart")
        return None

    def _cox(
        self, lives: Lives, covariates: Sequence[Covariate]
    ) -> tuple[CoxRegression | None, tuple[ProportionalityTest, ...]]:
        try:
            design = make_design(covariates, np.isfinite(lives.upper))
            fit = fit_cox(lives, design)
        except DealabError as error:
            self.refused.append(f"Cox's model: {error.problem}")
            return None, ()
        return fit, check_proportional_hazards(lives, design, fit)

    def _limit(
        self, lives: Lives, covariates: Sequence[Covariate], models: Sequence[LifeModel]
    ) -> EnduranceLimit | None:
        """The voltage below which nothing fails."""
        family = _best_without_shape(models)
        if family is None or models[0].stress_law != INVERSE_POWER:
            return None
        try:
            return find_endurance_limit(lives, covariates, family)
        except DealabError as error:
            self.refused.append(f"endurance limit: {error.problem}")
        return None

    def _batches(
        self, lives: Lives, covariates: Sequence[Covariate], models: Sequence[LifeModel]
    ) -> BatchScatter | None:
        """The scatter between batches; without any other regression that of Weibull lives."""
        others = [one for one in covariates if one.name != _BATCH]
        names = [str(row.batch) for row in self.rows]
        try:
            return fit_batch_scatter(lives, others, names, _best_without_shape(models) or WEIBULL)
        except DealabError as error:
            self.refused.append(f"scatter between batches: {error.problem}")
        except np.linalg.LinAlgError:
            self.refused.append("scatter between batches: the lives do not tell its parameters apart")
        return None

    def _modes(self, lives: Lives, covariates: Sequence[Covariate]) -> tuple[CauseRegression, ...]:
        modes = [row.mode for row in self.rows]
        named = sorted({mode for mode in modes if mode})
        found = []
        for mode in named if len(named) > 1 else ():
            try:
                found.append(fit_cause_regression(lives, modes, covariates, mode))
            except DealabError as error:
                self.refused.append(f"effects on the mode {mode}: {error.problem}")
        return tuple(found)


def _best_without_shape(models: Sequence[LifeModel]) -> str | None:
    """The family that describes the lives best among those without a shape."""
    able = [model.regression for model in models if model.regression.family != GENERALISED_GAMMA]
    return min(able, key=lambda fit: fit.aic).family if able else None


def name_conditions(rows: Sequence[LifetimeRow]) -> tuple[str, ...]:
    """Everything that the lives may depend on: what every life has a place for, and the laboratory's own covariates."""
    own = {one.name for row in rows for one in row.covariates}
    return (*_CONDITIONS, *sorted(own - set(LifetimeRow.__dataclass_fields__)))


def _covariate(name: str, rows: Sequence[LifetimeRow]) -> Covariate:
    """A condition of lives that all have it.

    Raises
    ------
    RefusedError
        The tables and recordings of the campaign give a covariate of the laboratory's own in different ways.
    """
    law, unit = next(((law, unit) for n, law, unit in _STRESSES if n == name), (CATEGORY, ""))
    if name not in _CONDITIONS:
        given = sorted({(one.law, one.unit) for row in rows for one in row.covariates if one.name == name})
        if len(given) > 1:
            ways = joined([f"{law} in {unit}" if unit else f"{law} without a unit" for law, unit in given])
            raise RefusedError(f"it is given in different ways ({ways})", expected="one law and one unit")
        law, unit = given[0]
    values = [row.condition(name) for row in rows]
    return Covariate(name, law, list(map(str, values)) if law == CATEGORY else np.array(values, dtype=float), unit)


def _limits(rows: Sequence[LifetimeRow]) -> Lives:
    """What is known of the lives; a failure at 0 s came before the shortest life above 0."""
    shortest = min(row.lifetime_s for row in rows if row.lifetime_s > 0)
    entered = np.array([row.entered_s or 0.0 for row in rows])
    return Lives(
        np.array([row.lower_s for row in rows]),
        np.array([row.upper_s or shortest for row in rows]),
        entered if entered.any() else None,
    )


def _describe_conditions(row: LifetimeRow) -> str:
    shown = [] if row.configuration is None else [row.configuration]
    shown += [] if row.electrode is None else [row.electrode]
    for name, _, unit in _STRESSES:
        value = getattr(row, name)
        shown += [] if value is None else [f"{value:g} {unit or name}"]
    shown += [one.words for one in row.covariates]
    return ", ".join(shown)


def _contrasts(one: Covariate) -> list[Contrast]:
    """Of a category each level over the first one, of a stress its highest value over its lowest."""
    names, x = one.columns()
    if one.is_category:
        first, *others = one.levels
        return [Contrast(name, f"{level} over {first}", 1.0) for name, level in zip(names, others, strict=True)]
    values = np.asarray(one.values, dtype=np.float64)
    low, high = int(np.argmin(values)), int(np.argmax(values))
    words = f"{with_unit(compact(values[high]), one.unit)} over {with_unit(compact(values[low]), one.unit)}"
    return [Contrast(names[0], words, float(x[high, 0] - x[low, 0]))]


def _with_law(covariates: Sequence[Covariate], law: str) -> list[Covariate]:
    first, *others = covariates
    return [Covariate(first.name, law, first.values, first.unit), *others]


def _stress_lines(
    fit: LifeRegression, covariates: Sequence[Covariate], groups: Sequence[str]
) -> tuple[tuple[LifePoint, ...], tuple[GroupPoint, ...]]:
    """Median life over the first stress for each category, and each group's own; nothing where no stress was varied."""
    stress = next((c for c in covariates if not c.is_category), None)
    if stress is None:
        return (), ()
    design = make_design(covariates, np.ones(len(groups), dtype=bool))
    column = design.names.index(stress.name)
    category = next((c for c in covariates if c.is_category), None)
    own = np.asarray(stress.values, dtype=np.float64)
    low, high = float(own.min()), float(own.max())
    is_ratio = LAWS[stress.law].above == 0.0 or stress.name == "voltage_kv"
    spread: Callable[..., Float] = np.geomspace if is_ratio else np.linspace
    below = _BELOW * low if is_ratio else low - _BEYOND * (high - low)
    if low >= 0 and stress.law == EXPONENTIAL_LAW:  # of what is never negative, such as a time or a count
        below = max(below, 0.0)
    reach = np.concatenate((spread(below, low, _POINTS)[:-1], spread(low, high, 2 * _POINTS)))
    points: list[LifePoint] = []

    def on_line(level: str) -> Float:
        """Conditions of the line of a category."""
        x = design.x.mean(axis=0)
        for i, name in enumerate(design.names):
            if category and design.owners[i] == category.name:
                x[i] = float(name == f"{category.name}: {level}")
        return np.asarray(x)

    for level in category.levels if category else ("",):
        x = on_line(level)
        for value, entered in zip(reach, LAWS[stress.law].transform(reach), strict=True):
            x[column] = entered
            outside = not low * (1 - 1e-9) <= value <= high * (1 + 1e-9)
            life = fit.life_at(x)
            points.append(LifePoint(level, stress.name, float(value), life, outside, stress.law, stress.unit))
    names = np.array(groups)
    found = []
    for group in fit.groups:
        first = int(np.argmax(names == group.name))
        median = fit.life_at(design.x[first]).value
        level = str(category.values[first]) if category else ""
        x = on_line(level)
        x[column] = design.x[first, column]
        moved = fit.life_at(x).value
        found.append(
            GroupPoint(group.name, stress.name, float(own[first]), median * group.factor, level, moved * group.factor)
        )
    return tuple(points), tuple(found)
