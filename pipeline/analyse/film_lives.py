"""The law of life of a film over rods from several electrode layouts, and each layout as the others predict it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.fit.survival.film_life import (
    PLAUSIBLE_EXPONENT,
    FilmLayout,
    FilmLives,
    fit_film_life,
    predict_film_life,
)
from pipeline.fit.survival.groups import usable_lives
from pipeline.fit.survival.kaplan_meier import kaplan_meier
from pipeline.fit.survival.lifetime_distributions import Lives
from schemas.errors import DealabError
from schemas.lifetimes import OUTSIDE_THE_FILM, LifetimeRow
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

_ASSUMED = (
    "the exponent of the hazard is taken to lie between 8 and 15 with 90 % before the lives are looked at;"
    " thickness scatter from specimen to specimen is not known and not taken into account"
)


@dataclass(frozen=True)
class LayoutLives:
    """A configuration's film under its electrodes, and all its lives."""

    layout: FilmLayout
    rows: Sequence[LifetimeRow]

    def groups(self) -> list[FilmLives]:
        """Its lives by voltage; failures outside of the film say that the film lived longer."""
        by_voltage: dict[float, list[LifetimeRow]] = defaultdict(list)
        for row in usable_lives(self.rows):
            if row.voltage_kv is not None and row.lifetime_s > 0:
                by_voltage[row.voltage_kv].append(row)
        return [FilmLives(self.layout, voltage, _limits(rows)) for voltage, rows in sorted(by_voltage.items())]


def _limits(rows: Sequence[LifetimeRow]) -> Lives:
    in_film = np.array([row.failed and row.failure_site not in OUTSIDE_THE_FILM for row in rows])
    entered = np.array([row.entered_s or 0.0 for row in rows])
    return Lives(
        np.array([row.lower_s for row in rows]),
        np.where(in_film, [row.upper_s for row in rows], np.inf),
        entered if entered.any() else None,
    )


def film_life_tables(campaign: str | None, layouts: Sequence[LayoutLives]) -> dict[str, pa.Table]:
    """Tables `film_lives` and `film_life_predictions` of a campaign; no rows where there are not two layouts."""
    names = "film_lives", "film_life_predictions"
    if len(layouts) < 2:
        return {name: TABLES[name].rows(()) for name in names}
    predicted = [row for one in layouts for row in _predictions(one, [o for o in layouts if o is not one])]
    found = ([_law(layouts)], predicted)
    return {
        name: TABLES[name].rows({"campaign": campaign, **row} for row in rows)
        for name, rows in zip(names, found, strict=True)
    }


def _law(layouts: Sequence[LayoutLives]) -> dict[str, Any]:
    groups = [group for one in layouts for group in one.groups()]
    shown: dict[str, Any] = {"layouts": ", ".join(one.layout.name for one in layouts)}
    try:
        fit = fit_film_life(groups, PLAUSIBLE_EXPONENT)
    except DealabError as error:
        return {**shown, "failures": sum(g.lives.failures for g in groups), "warnings": error.shortcoming}
    for name in ("life_s", "exponent", "shape"):
        value = getattr(fit, name)
        shown |= {name: value.value, f"{name}_lower": value.lower, f"{name}_upper": value.upper}
    return {
        **shown,
        "failures": fit.failures,
        "reference_mv_per_m": fit.reference_mv_per_m,
        "warnings": _ASSUMED,
    }


def _predictions(one: LayoutLives, others: Sequence[LayoutLives]) -> list[dict[str, Any]]:
    """The layout at each voltage that it was tested at, by the law of the others."""
    try:
        fit = fit_film_life([group for other in others for group in other.groups()], PLAUSIBLE_EXPONENT)
    except DealabError as error:
        return [{"configuration": one.layout.name, "warnings": error.shortcoming}]
    rows = []
    for group in one.groups():
        lives = group.lives
        ended = np.where(np.isfinite(lives.upper), lives.upper, lives.lower)
        end = float(ended.max())
        found = predict_film_life(fit, one.layout, group.voltage_kv, ended.size, end)
        curve = kaplan_meier(ended, np.isfinite(lives.upper))
        median, failed = curve.median().value, 1 - float(curve.survival_at([end])[0])
        share, sample = found.failed_share, found.sample_median_s
        assert share is not None
        reached = bool(np.isfinite(median))
        within = sample.lower <= median <= sample.upper if reached else share.lower <= failed <= share.upper
        rows.append(
            {
                "configuration": one.layout.name,
                "voltage_kv": group.voltage_kv,
                "fitted_on": ", ".join(other.layout.name for other in others),
                "specimens": ended.size,
                "predicted_median_s": found.median_s.value,
                "predicted_median_s_low": sample.lower,
                "predicted_median_s_high": sample.upper,
                "observed_median_s": median if reached else None,
                "end_s": end,
                "predicted_failed": share.value,
                "predicted_failed_low": share.lower,
                "predicted_failed_high": share.upper,
                "observed_failed": failed,
                "within": bool(within),
            }
        )
    return rows
