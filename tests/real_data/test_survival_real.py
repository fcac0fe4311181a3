"""Survival on public lifetimes: published numbers to all printed digits, and what the data contradict."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.fit.survival.groups import survival_group
from pipeline.fit.survival.kaplan_meier import kaplan_meier
from pipeline.fit.survival.lifetime_distributions import WEIBULL, Lives, fit_distribution
from pipeline.fit.survival.tests import GEHAN, PETO, TARONE_WARE, rank_test
from pipeline.fit.survival.voltage_life import fit_inverse_power_law
from schemas.errors import NotIdentifiableError, RefusedError
from schemas.lifetimes import LifetimeRow

HOUR = 3600.0


@pytest.fixture(scope="module")
def leukaemia(real_data: Path) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    table = pd.read_csv(real_data / "lifelines_km" / "anderson.csv", sep=r"\s+")
    return {arm: (rows["t"].to_numpy(float), rows["status"].to_numpy() == 1) for arm, rows in table.groupby("Rx")}


@pytest.fixture(scope="module")
def film(real_data: Path) -> pd.DataFrame:
    """PET film. `cens` is 1 for a failure, although the data's help page says the opposite."""
    table = pd.read_csv(real_data / "hirose_pet_film" / "hirose.csv")
    table["failed"] = table["cens"] == 1
    return table


def test_leukaemia(leukaemia: dict[int, tuple[np.ndarray, np.ndarray]]) -> None:
    treated, placebo = kaplan_meier(*leukaemia[0]), kaplan_meier(*leukaemia[1])
    shown = [f"{s:.4f}" for s in treated.survival_at([6, 7, 10, 13, 16, 22, 23])]
    assert shown == ["0.8571", "0.8067", "0.7529", "0.6902", "0.6275", "0.5378", "0.4482"]
    errors = treated.standard_error[np.isin(treated.time, [6, 23])]
    assert [f"{e:.4f}" for e in errors] == ["0.0764", "0.1346"]
    six, ten = treated.at(6), treated.at(10)
    assert [f"{x:.4f}" for x in (six.lower, six.upper, ten.lower, ten.upper)] == [
        "0.6197",
        "0.9516",
        "0.5032",
        "0.8894",
    ]
    assert (treated.median().value, treated.median().lower, placebo.median().value) == (23, 13, 8)
    means = treated.restricted_mean(23), placebo.restricted_mean(23), treated.restricted_mean(35)
    assert [f"{m.value:.4f}" for m in means] == ["17.9092", "8.6667", "23.2874"]
    arms = [leukaemia[0], leukaemia[1]]
    test = rank_test(arms)
    assert f"{test.statistic:.5f}" == "16.79294"
    assert f"{test.p_value:.4e}" == "4.1688e-05"
    assert (test.observed[0], f"{test.expected[0]:.2f}") == (9, "19.25")
    assert [f"{rank_test(arms, name).statistic:.4f}" for name in (GEHAN, TARONE_WARE, PETO)] == [
        "13.4579",
        "15.1236",
        "14.0841",
    ]
    weibull = fit_distribution(Lives.right_censored(*leukaemia[0]), WEIBULL)
    assert f"{weibull.parameters['scale_s'].value:.4f}" == "33.7652"
    assert f"{weibull.parameters['shape'].value:.5f}" == "1.35373"
    assert f"{weibull.log_likelihood:.4f}" == "-41.6587"


def test_walton(real_data: Path) -> None:
    table = pd.read_csv(real_data / "lifelines_km" / "waltons_dataset.csv")
    time, failed = table["T"].to_numpy(float), table["E"].to_numpy() == 1
    curve = kaplan_meier(time, failed)
    assert (curve.specimens, curve.failed, curve.median().value) == (163, 156, 56)
    assert f"{curve.at(50).value:.6f}" == "0.616817"
    groups = [(rows["T"].to_numpy(float), rows["E"].to_numpy() == 1) for _, rows in table.groupby("group")]
    assert f"{rank_test(groups).statistic:.3f}" == "122.249"
    weibull = fit_distribution(Lives.right_censored(time, failed), WEIBULL)
    assert f"{weibull.parameters['scale_s'].value:.4f}" == "55.7331"
    assert f"{weibull.parameters['shape'].value:.5f}" == "3.45051"
    assert f"{weibull.log_likelihood:.3f}" == "-672.062"


def test_film_by_voltage(film: pd.DataFrame) -> None:
    medians, scales, shapes = [], [], []
    for _, rows in film.groupby("volt"):
        time, failed = rows["time"].to_numpy(float), rows["failed"].to_numpy()
        curve = kaplan_meier(time, failed)
        medians.append(curve.median().value)
        parameters = fit_distribution(Lives.right_censored(time, failed), WEIBULL, goodness=False).parameters
        scales.append(parameters["scale_s"].value)
        shapes.append(parameters["shape"].value)
    assert [f"{m:.4g}" for m in medians] == ["9026", "108.3", "21.88", "4.65"]
    assert [f"{s:.5g}" for s in scales] == ["9086.3", "114.06", "24.222", "5.1935"]
    assert [f"{s:.4g}" for s in shapes] == ["19.53", "5.649", "6.19", "2.985"]
    low = film[film["volt"] == 5]
    assert kaplan_meier(low["time"], low["failed"]).at(9104.25).value == pytest.approx(0.30, abs=1e-12)


def test_film_one_power_law_fails_at_5_kv(film: pd.DataFrame) -> None:
    law = fit_inverse_power_law(Lives.right_censored(film["time"], film["failed"]), film["volt"])
    shown = f"{law.intercept.value:.4f} {law.exponent.value:.4f} {law.sigma.value:.4f} {law.log_likelihood:.3f}"
    assert shown == "19.6401 -6.8764 0.8793 -240.183"
    assert law.holds is False
    assert "It fails at 5 kV" in law.statement
    rest = film[film["volt"] > 5]
    other = fit_inverse_power_law(Lives.right_censored(rest["time"], rest["failed"]), rest["volt"])
    shown = f"{other.intercept.value:.4f} {other.exponent.value:.4f} {other.sigma.value:.4f} {other.log_likelihood:.3f}"
    assert shown == "12.4238 -3.9742 0.2298 -117.168"
    assert other.holds is True
    by_voltage = {r.voltage_kv: r for r in law.residuals}
    assert by_voltage[5.0].p_value_without > 0.05 > max(by_voltage[v].p_value_without for v in (7.0, 10.0, 15.0))


def test_film_as_a_campaign(film: pd.DataFrame) -> None:
    rows = [
        LifetimeRow(
            specimen_id=f"{r.volt}-{r.Index}",
            lifetime_s=r.time * HOUR,
            failed=bool(r.failed),
            configuration="PET",
            voltage_kv=float(r.volt),
        )
        for r in film.itertuples()
    ]
    results = survival_group(rows)
    assert [g.voltage_kv for g in results.groups] == [5, 7, 10, 15]
    assert any("PET was tested at 5 kV, 7 kV, 10 kV, 15 kV" in text for text in results.warnings)
    ((_, _, law),) = results.voltage_life
    assert law.holds is False
    assert law.exponent.value == pytest.approx(-6.8764, abs=5e-5)
    assert results.groups[0].summary.survival_at_end.value == pytest.approx(0.3)


def test_left_censored_rows_are_treated_as_such(real_data: Path) -> None:
    """CuZn: E = 0 means below the detection limit. As right-censored rows the fit would be about another population."""
    table = pd.read_csv(real_data / "lifelines_km" / "CuZn-LeftCensoredDataset.csv")
    rows = table[table["group"] == table["group"].unique()[0]]
    upper = rows["T"].to_numpy(float)
    known = rows["E"].to_numpy() == 1
    left = fit_distribution(Lives(np.where(known, upper, 0.0), upper), "log-normal").parameters["median_s"].value
    wrong = fit_distribution(Lives.right_censored(upper, known), "log-normal").parameters["median_s"].value
    from scipy import stats

    data = stats.CensoredData(uncensored=np.log(upper[known]), left=np.log(upper[~known]))
    assert np.log(left) == pytest.approx(stats.norm.fit(data)[0], abs=1e-4)
    assert wrong > left


def test_wrong_flag_is_not_silently_taken(film: pd.DataFrame) -> None:
    with pytest.raises(RefusedError, match="failure flag 3"):
        kaplan_meier(film["time"], film["cens"].replace(0, 3))
    with pytest.raises(NotIdentifiableError):
        fit_distribution(Lives.right_censored(film["time"], np.zeros(len(film))), WEIBULL)
