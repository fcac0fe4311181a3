"""Life regressions and Cox's model against published analyses, digit by digit; competing modes; named refusals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipeline.analyse.survival import analyse_survival
from pipeline.fit.survival import life_regression
from pipeline.fit.survival.cause_regression import fit_cause_regression, fit_fine_gray
from pipeline.fit.survival.covariates import Covariate, make_design
from pipeline.fit.survival.cox_regression import EFRON, EXACT, fit_cox
from pipeline.fit.survival.error_distributions import log_gamma
from pipeline.fit.survival.life_regression import FAMILIES, LifeRegression, fit_life_regression
from pipeline.fit.survival.lifetime_distributions import Lives, estimate_quantiles, fit_distribution
from pipeline.fit.survival.log_location_scale import NORMAL
from schemas.errors import DealabError
from schemas.life_covariates import CATEGORY, EXPONENTIAL_LAW, INVERSE_POWER
from schemas.lifetimes import LifetimeRow
from tests.helpers.published_lives import (
    BALL_BEARINGS,
    INSULATING_FLUID,
    SHOCK_ABSORBERS,
)

pytestmark = pytest.mark.quick

TREATED = "6+ 6 6 6 7 9+ 10+ 10 11+ 13 16 17+ 19+ 20+ 22 23 25+ 32+ 32+ 34+ 35+"
PLACEBO = "1 1 2 2 3 4 4 5 5 8 8 8 8 11 11 12 12 15 17 22 23"


def shown(fit: LifeRegression, *digits: int) -> list[str]:
    values = [*(c.value.value for c in fit.coefficients), fit.sigma.value, fit.log_likelihood]
    return [f"{value:.{d}f}" for value, d in zip(values, digits, strict=True)]


def test_insulating_fluid() -> None:
    """Nelson, Accelerated Testing (1990): Weibull, life over V^17.73 with the shape 1/1.288; no level departs."""
    voltage, limits = INSULATING_FLUID
    names = [str(v) for v in voltage]
    fit = fit_life_regression(Lives(*limits), [Covariate("voltage", INVERSE_POWER, voltage, "kV")], groups=names)
    assert shown(fit, 2, 2, 3, 1) == ["64.85", "-17.73", "1.288", "-300.8"]
    own = next(test for test in fit.tests if test.against == "location per group")
    assert (own.degrees_of_freedom, own.p_value > 0.5) == (5, True)
    assert all(group.p_value > 0.05 for group in fit.groups)
    assert fit.cox_snell.sum() == pytest.approx(76, rel=1e-6)


def test_ball_bearings() -> None:
    """Lawless, Statistical Models and Methods for Lifetime Data (1982): Weibull 81.88 and 2.102; generalised gamma after
    Meeker and Escobar (1998), section 11.3: μ 4.23, σ 0.51, λ 0.31."""
    lives = Lives(*BALL_BEARINGS)
    weibull = fit_life_regression(lives, [])
    assert f"{np.exp(weibull.coefficients[0].value.value):.2f} {1 / weibull.sigma.value:.3f}" == "81.88 2.102"
    normal = fit_life_regression(lives, [], "log-normal")
    assert shown(normal, 2, 3, 2) == ["4.15", "0.522", "-113.13"]
    gamma = fit_life_regression(lives, [], "generalised gamma")
    assert gamma.shape is not None
    assert "wide" in gamma.method
    assert [*shown(gamma, 2, 2, 2), f"{gamma.shape.value:.2f}"] == ["4.23", "0.51", "-112.97", "0.31"]


def test_shock_absorbers() -> None:
    """Meeker and Escobar (1998), table 8.1: Weibull 27 719 km and 3.16; log-normal 10.14 and 0.53."""
    weibull = fit_life_regression(Lives(*SHOCK_ABSORBERS), [])
    assert np.exp(weibull.coefficients[0].value.value) == pytest.approx(27719, abs=5)
    assert f"{1 / weibull.sigma.value:.2f}" == "3.16"
    normal = fit_life_regression(Lives(*SHOCK_ABSORBERS), [], "log-normal")
    assert [normal.coefficients[0].value.value, normal.sigma.value] == pytest.approx([10.14, 0.530], abs=0.006)


def leukaemia() -> tuple[Lives, np.ndarray]:
    words = f"{TREATED} {PLACEBO}".split()
    time = np.array([float(word.rstrip("+")) for word in words])
    upper = np.array([np.inf if word.endswith("+") else t for word, t in zip(words, time, strict=True)])
    return Lives(time, upper), np.repeat([0.0, 1.0], 21)


def test_leukaemia_by_cox() -> None:
    """R's coxph: Efron 1.5721 (0.4124), exact 1.6282 (0.4331). Freireich and others, Blood 21 (1963) 699."""
    lives, placebo = leukaemia()
    design = make_design([Covariate("placebo", EXPONENTIAL_LAW, placebo)], lives.exact)
    for ties, expected, error in ((EFRON, "1.5721", "0.4124"), (EXACT, "1.6282", "0.4331")):
        effect = fit_cox(lives, design, ties).effects[0]
        assert (f"{effect.value.value:.4f}", f"{effect.standard_error:.4f}") == (expected, error)
    assert f"{fit_cox(lives, design).likelihood_ratio:.2f}" == "16.35"


def test_cox_of_late_entries_is_that_of_the_risk_sets() -> None:
    """Against the sum over failures written out: no ties, so Efron's is Breslow's."""
    rng = np.random.default_rng(4)
    x, entered, life = rng.normal(size=80), rng.uniform(0, 1, 80), rng.exponential(size=80) + 0.3
    seen = life > entered
    x, entered, life = x[seen], entered[seen], life[seen]
    lives = Lives(life, np.where(rng.random(life.size) < 0.8, life, np.inf), entered)
    fit = fit_cox(lives, make_design([Covariate("x", EXPONENTIAL_LAW, x)], lives.exact))
    beta = fit.effects[0].value.value
    score = 0.0
    for i in np.flatnonzero(lives.exact):
        risk = (entered < life[i]) & (life >= life[i])
        weight = np.exp(beta * x[risk])
        score += x[i] - weight @ x[risk] / weight.sum()
    assert score == pytest.approx(0.0, abs=1e-6)


def draw(family: str, seed: int, n: int = 240) -> tuple[Lives, list[Covariate]]:
    """Lives of every kind of censoring with an exponent −6, 0.5 between categories, scatter 0.6."""
    rng = np.random.default_rng(seed)
    voltage, kind = rng.choice([4.0, 5.0, 6.0], n), rng.choice(["a", "b"], n)
    w = {
        "exponential": np.log(rng.exponential(size=n)) / 0.6,
        "weibull": np.log(rng.exponential(size=n)),
        "log-normal": rng.normal(size=n),
        "log-logistic": rng.logistic(size=n),
        "generalised gamma": rng.normal(size=n),
    }[family]
    life = np.exp(12 - 6 * np.log(voltage) + 0.5 * (kind == "b") + 0.6 * w)
    how = rng.integers(0, 4, n)
    entered = np.where(rng.random(n) < 0.2, life * rng.uniform(0, 0.5, n), 0.0)
    lower = np.select(
        [how == 0, how == 1, how == 2], [life, life * rng.uniform(0.5, 1, n), np.maximum(life * 0.8, entered)], life
    )
    upper = np.select([how == 0, how == 1, how == 2], [life, np.inf, life * 1.1], life)
    covariates = [Covariate("voltage", INVERSE_POWER, voltage, "kV"), Covariate("kind", CATEGORY, kind.tolist())]
    return Lives(lower, upper, np.minimum(entered, lower)), covariates


@pytest.mark.parametrize("family", FAMILIES)
def test_limits_hold_what_was_drawn(family: str) -> None:
    lives, covariates = draw(family, 11)
    fit = fit_life_regression(lives, covariates, family)
    for found, truth in zip(fit.coefficients[1:], (-6.0, 0.5), strict=True):
        assert found.value.lower < found.value.value < found.value.upper
        assert abs(found.value.value - truth) < 4 * found.standard_error
    assert fit.cox_snell.min() >= 0


@pytest.mark.parametrize("family", ["weibull", "log-normal"])
def test_scaled_times_move_the_intercept_only(family: str) -> None:
    lives, covariates = draw(family, 12)
    assert lives.entered is not None
    first = fit_life_regression(lives, covariates, family)
    other = fit_life_regression(Lives(60 * lives.lower, 60 * lives.upper, 60 * lives.entered), covariates, family)
    moved = [b.value.value - a.value.value for a, b in zip(first.coefficients, other.coefficients, strict=True)]
    assert moved == pytest.approx([np.log(60), 0, 0], abs=1e-6)
    assert other.sigma.value == pytest.approx(first.sigma.value, rel=1e-6)


def test_fine_gray_without_censoring_is_cox_with_the_others_immortal() -> None:
    rng = np.random.default_rng(5)
    x, life = rng.normal(size=120), rng.exponential(size=120)
    modes = np.where(rng.random(120) < 0.5, "film", "lead").tolist()
    own = np.array(modes) == "film"
    design = make_design([Covariate("x", EXPONENTIAL_LAW, x)], own)
    found = fit_fine_gray(Lives(life, life), own, design).effects[0]
    immortal = fit_cox(Lives(np.where(own, life, 1e9), np.where(own, life, np.inf)), design).effects[0]
    assert found.value.value == pytest.approx(immortal.value.value, abs=1e-8)


def test_covariate_of_one_mode_is_told_from_that_of_the_other() -> None:
    rng = np.random.default_rng(6)
    x = rng.integers(0, 2, 600).astype(float)
    film, lead = rng.exponential(size=600) * np.exp(-1.0 * x), rng.exponential(size=600)
    end = rng.uniform(0, 2, 600)
    life = np.minimum.reduce([film, lead, end])
    modes = np.select([film == life, lead == life], ["film", "lead"], "").tolist()
    lives = Lives(life, np.where(life < end, life, np.inf))
    covariates = [Covariate("x", EXPONENTIAL_LAW, x)]
    by_film = fit_cause_regression(lives, modes, covariates, "film")
    by_lead = fit_cause_regression(lives, modes, covariates, "lead")
    assert by_film.cause_specific.effects[0].value.lower < 1.0 < by_film.cause_specific.effects[0].value.upper
    assert by_lead.cause_specific.effects[0].value.lower < 0.0 < by_lead.cause_specific.effects[0].value.upper
    # The lead fails less often because the film fails first, although nothing acts on it.
    assert by_lead.fine_gray.effects[0].value.upper < 0.0


def test_shape_of_many_lives_is_found_with_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    lives, covariates = draw("generalised gamma", 21, 1200)
    plain = fit_life_regression(lives, covariates, "generalised gamma")
    monkeypatch.setattr(life_regression, "_MOST_SEARCHED", 300)
    sampled = fit_life_regression(lives, covariates, "generalised gamma")
    assert plain.shape is not None
    assert sampled.shape is not None
    assert sampled.shape.value == pytest.approx(plain.shape.value, abs=2e-5)
    assert sampled.log_likelihood == pytest.approx(plain.log_likelihood, abs=1e-8)
    first, second = (fit.life_at(np.array([np.log(4.0), 0.0])) for fit in (plain, sampled))
    assert [second.lower, second.upper] == pytest.approx([first.lower, first.upper], rel=1e-3)


@pytest.mark.parametrize("q", [-1e-3, 2e-4, 1e-3])
def test_log_gamma_goes_over_into_the_normal(q: float) -> None:
    z = np.linspace(-3, 3, 7)
    for near, limit in (
        (log_gamma(q).exact, NORMAL.exact),
        (log_gamma(q).right, NORMAL.right),
        (log_gamma(q).left, NORMAL.left),
    ):
        for found, expected in zip(near(z), limit(z), strict=True):
            assert found == pytest.approx(expected, abs=30 * abs(q))


def test_limits_of_complete_log_normal_lives_are_those_of_student() -> None:
    """The median's limits are mean ± t s/√n of ln t, those of the information as well as those of the profile."""
    logs = np.random.default_rng(9).normal(3.0, 0.7, 8)
    fit = fit_life_regression(Lives(np.exp(logs), np.exp(logs)), [], "log-normal")
    half = 2.3646242510103 * logs.std(ddof=1) / np.sqrt(8)  # t of 7 degrees of freedom
    expected = [logs.mean() - half, logs.mean() + half]
    median, intercept = fit.life_at(np.empty(0)), fit.coefficients[0].value
    assert np.log([median.lower, median.upper]) == pytest.approx(expected, abs=1e-6)
    assert [intercept.lower, intercept.upper] == pytest.approx(expected, abs=1e-4)


def test_quantile_at_the_scale_has_the_limits_of_the_scale() -> None:
    """The share 1 − 1/e of a Weibull law and the half of a log-normal one have failed at their scale parameters."""
    lives = Lives(*SHOCK_ABSORBERS)
    for name, parameter, share in (("weibull", "scale_s", 1 - np.exp(-1)), ("log-normal", "median_s", 0.5)):
        fit = fit_distribution(lives, name, goodness=False)
        (found,) = estimate_quantiles(lives, fit, [share])
        expected = fit.parameters[parameter]
        assert [found.time_s.value, found.time_s.lower, found.time_s.upper] == pytest.approx(
            [expected.value, expected.lower, expected.upper], rel=1e-5
        )


FIVE = np.array([1.0, 2.0, 3.0, 4.0, 5.0])


@pytest.mark.parametrize(
    ("covariate", "upper", "problem"),
    [
        (Covariate("voltage", INVERSE_POWER, np.full(5, 6.0), "kV"), FIVE, r"voltage has one value \(6 kV\)"),
        (Covariate("voltage", INVERSE_POWER, FIVE, "kV"), np.full(5, np.inf), "nobody failed"),
        (Covariate("kind", CATEGORY, list("aabbb")), np.array([1, 2, np.inf, np.inf, np.inf]), "separation"),
        (
            Covariate("voltage", INVERSE_POWER, np.array([5.0, 5, 4, 4, 4]), "kV"),
            np.array([1, 2, np.inf, np.inf, np.inf]),
            "all failures came at one value",
        ),
        (Covariate("voltage", INVERSE_POWER, np.array([0.0, 5, 4, 4, 4]), "kV"), FIVE, "voltage of 0 kV"),
        (Covariate("voltage", INVERSE_POWER, FIVE[:3], "kV"), FIVE, "voltage has 3 values"),
        (
            Covariate("kind", CATEGORY, list("abcab")),
            np.array([1, 2, 3, np.inf, np.inf]),
            "3 distinct failure times for 4",
        ),
    ],
)
def test_refusals_have_names(covariate: Covariate, upper: np.ndarray, problem: str) -> None:
    with pytest.raises(DealabError, match=problem):
        fit_life_regression(Lives(FIVE, upper), [covariate])


def test_covariates_that_change_together_and_modes_without_a_failure() -> None:
    both = [Covariate("voltage", INVERSE_POWER, FIVE), Covariate("field", INVERSE_POWER, 3 * FIVE)]
    with pytest.raises(DealabError, match="voltage and field change together"):
        fit_life_regression(Lives(FIVE, FIVE), both)
    with pytest.raises(DealabError, match="nobody failed by edge"):
        fit_cause_regression(Lives(FIVE, FIVE), ["film"] * 5, both[:1], "edge")
    inspected = Lives(FIVE, 2 * FIVE)
    with pytest.raises(DealabError, match="between inspections"):
        fit_cox(inspected, make_design(both[:1], np.ones(5, dtype=bool)))


def lives_of_a_campaign() -> list[LifetimeRow]:
    rng = np.random.default_rng(3)
    rows = []
    for voltage in (4.0, 5.0, 6.0):
        for electrode in ("carbon", "silver"):
            for k in range(5):
                life = float(
                    np.exp(18 - 7 * np.log(voltage) + 0.8 * (electrode == "silver") + 0.5 * np.log(rng.exponential()))
                )
                conditions: dict[str, Any] = {"voltage_kv": voltage, "electrode": electrode, "campaign": "C"}
                mode = str(rng.choice(["film", "lead"])) if life < 4000 else None
                rows.append(
                    LifetimeRow(
                        specimen_id=f"{voltage:g}{electrode}{k}",
                        lifetime_s=min(life, 4000.0),
                        failed=life < 4000,
                        failure_mode=mode,
                        **conditions,
                    )
                )
    return rows


def test_tables_of_a_campaign() -> None:
    tables = analyse_survival(lives_of_a_campaign()).joined()
    models = tables["life_regressions"].to_pylist()
    assert sum(bool(model["chosen"]) for model in models) == 1
    assert {model["stress_law"] for model in models} == {"inverse power", "exponential"}
    chosen = next(model for model in models if model["chosen"])
    coefficients = {
        row["coefficient"]: row["value"]
        for row in tables["life_coefficients"].to_pylist()
        if (row["family"], row["stress_law"]) == (chosen["family"], chosen["stress_law"])
    }
    assert set(coefficients) == {"intercept", "voltage_kv", "electrode: silver"}
    assert tables["life_residuals"].num_rows == 30
    assert any(row["extrapolated"] for row in tables["life_lines"].to_pylist())
    assert {row["model"] for row in tables["mode_effects"].to_pylist()} == {"cause-specific", "fine-gray"}


def test_effects_over_contrasts_and_hazards_of_residuals() -> None:
    tables = analyse_survival(lives_of_a_campaign()).joined()
    chosen = next(model for model in tables["life_regressions"].to_pylist() if model["chosen"])
    rows = {
        (row["family"], row["coefficient"]): row
        for row in tables["life_coefficients"].to_pylist()
        if row["stress_law"] == chosen["stress_law"]
    }
    change = np.log(6 / 4) if chosen["stress_law"] == "inverse power" else 2.0
    for family in (chosen["family"], "cox"):
        row = rows[family, "voltage_kv"]
        assert row["contrast"] == "6\u00a0kV over 4\u00a0kV"
        assert row["factor"] == pytest.approx(np.exp(change * row["value"]))
        assert row["factor_lower"] < row["factor"] < row["factor_upper"]
    assert rows[chosen["family"], "electrode: silver"]["contrast"] == "silver over carbon"
    residuals = sorted(tables["life_residuals"].to_pylist(), key=lambda r: r["cox_snell"])
    hazard = 0.0
    for i, row in enumerate(residuals):
        hazard += row["failed"] / (len(residuals) - i)
        assert row["observed_hazard"] == pytest.approx(hazard)


@pytest.mark.long
def test_batches_are_a_covariate_and_too_many_are_left_out_with_the_reason() -> None:
    rows = [replace(row, batch=f"B{i % 2}") for i, row in enumerate(lives_of_a_campaign())]
    found = analyse_survival(rows).joined()["life_coefficients"].to_pylist()
    assert "batch: B1" in {row["coefficient"] for row in found}
    rows = [replace(row, batch=f"B{i % 14}") for i, row in enumerate(lives_of_a_campaign())]
    models = analyse_survival(rows).joined()["life_regressions"].to_pylist()
    (text,) = {row["warnings"] for row in models if row["chosen"]}
    assert "batch is not in the regression: " in text


def test_many_small_batches_are_a_random_effect() -> None:
    drawn = np.random.default_rng(8).normal(size=10)
    rows = [
        replace(row, batch=f"B{b}", lifetime_s=row.lifetime_s * float(np.exp(1.2 * drawn[b])))
        for i, row in enumerate(lives_of_a_campaign())
        for b in [(i + 5 * (i // 10)) % 10]  # each batch has both electrodes
    ]
    tables = analyse_survival(rows).joined()
    (scatter,) = tables["batch_scatter"].to_pylist()
    assert scatter["batches"] == 10
    assert 0 < scatter["tau_lower"] < 1.2 < scatter["tau_upper"]
    assert scatter["p_value"] < 0.05
    factors = {row["batch"]: row["factor"] for row in tables["batch_effects"].to_pylist()}
    assert np.corrcoef(np.log([factors[f"B{i}"] for i in range(10)]), drawn)[0, 1] > 0.8
    # A category of many levels is one covariate among the tests, and a family is none.
    tests = [row["tests"] for row in tables["life_regressions"].to_pylist() if row["tests"]]
    assert not any("without exponential" in text or "without weibull" in text for text in tests)
    random = [row for row in tables["life_coefficients"].to_pylist() if row["family"] == "batches at random"]
    assert {row["coefficient"] for row in random} == {"intercept", "voltage_kv", "electrode: silver"}


@pytest.mark.long
def test_groups_of_few_failures_are_not_said_to_be_off_a_law_that_they_follow() -> None:
    rng = np.random.default_rng(4)
    group = np.repeat(np.arange(10), 3)
    voltage = 4 + 0.2 * group
    off = tested = 0
    for _ in range(60):
        life = np.exp(18 - 6 * np.log(voltage) + 0.6 * np.log(rng.exponential(size=30)))
        covariates = [Covariate("voltage", INVERSE_POWER, voltage)]
        fit = fit_life_regression(Lives(life, life), covariates, "weibull", groups=[str(g) for g in group])
        (test,) = [t for t in fit.tests if t.against == "location per group"]
        tested += 1
        off += test.p_value < 0.05
    assert tested == 60
    assert off <= 8  # 3 are due; the χ² distribution of many lives says it of 13

    alone = fit_life_regression(Lives(life, life), covariates, "weibull", groups=[f"g{k}" for k in range(30)])
    assert "location per group" not in {t.against for t in alone.tests}  # no scatter would be left to judge by


def life(name: str, lifetime_s: float, **more: Any) -> LifetimeRow:
    return LifetimeRow(
        **{"specimen_id": name, "lifetime_s": lifetime_s, "failed": True, "campaign": "C", "voltage_kv": 5.0} | more
    )


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([life("N", -4.0)], "N: negative lifetime -4 s; left out"),
        ([life("M", float("nan"))], "M: no lifetime; left out"),
        ([life("T", 40.0, staircase=True, voltage_kv=9.0)], "T: staircase test: no life at one voltage; left out"),
        ([life("B", 7.0, censored_because="end of test")], "B: failed and censored at once (end of test); left out"),
    ],
)
def test_rows_left_out_are_in_the_notes(rows: list[LifetimeRow], said: str) -> None:
    notes = analyse_survival([*(life(f"g{k}", 10.0 + k) for k in range(3)), *rows]).joined()["survival_notes"]
    assert [(n["campaign"], n["specimen_id"], n["statement"]) for n in notes.to_pylist()] == [
        ("C", rows[0].specimen_id, said)
    ]


@pytest.mark.long_after(4)
@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([life(f"g{k}", 10.0 + k) for k in range(4)], None),
        ([life(f"a{k}", 10.0 + k, electrode="a" if k < 4 else "b", failed=k < 4) for k in range(8)], "none of its 4 specimens failed"),
        ([life(f"v{k}", 10.0 + k, voltage_kv=5.0 + (k > 3), failed=k > 3) for k in range(8)], "all failures came at one value of voltage_kv"),
        ([life(f"n{k}", 10.0 + k, voltage_kv=5.0 * (k > 3)) for k in range(8)], "voltage_kv of 0 kV"),
        ([life(f"f{k}", 10.0 + k, voltage_kv=5.0 + k % 2) for k in range(3)], "3 distinct failures do not carry 1 effects"),
        ([life(f"z{k}", 0.0 if k % 2 else 10.0 + k, voltage_kv=5.0 + (k > 3)) for k in range(8)], None),
    ],
    ids=["one group", "separation", "one stress failed", "no voltage", "too few", "failures at zero"],
)  # fmt: skip
def test_why_a_campaign_has_no_regression(rows: list[LifetimeRow], said: str | None) -> None:
    models = analyse_survival(rows).joined()["life_regressions"].to_pylist()
    if said is None:
        assert all(model["family"] != "none" for model in models)
    else:
        assert said in next(model["warnings"] for model in models if model["warnings"])


def test_limits_in_the_wrong_order_and_late_entries_after_the_end_are_refused() -> None:
    with pytest.raises(DealabError, match="lifetime between 5 and 3 s"):
        Lives(np.array([5.0]), np.array([3.0]))
    with pytest.raises(DealabError, match="came under watch at 9 s"):
        Lives(np.array([5.0]), np.array([5.0]), np.array([9.0]))


def test_a_campaign_of_survivors_says_why_it_has_no_regression() -> None:
    rows = [
        LifetimeRow(specimen_id=f"s{k}", lifetime_s=10.0, failed=False, voltage_kv=4.0 + k, campaign="C")
        for k in range(3)
    ]
    (model,) = analyse_survival(rows).joined()["life_regressions"].to_pylist()
    assert (model["family"], model["warnings"]) == ("none", "nobody failed: no regression")
