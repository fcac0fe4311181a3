"""What published analyses of lifetimes print, each with its source, and what the pipeline finds for the same.

`ANALYSES` has a row for each printed number; `as_printed` writes a value with the digits of the publication. Used by the test of
these numbers and by the study that shows them. Sources that begin with "R survival" or "R lme4" are outputs and tests that these
packages are released with, read there; the others are the books and papers named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from pipeline.fit.survival.batch_scatter import BatchScatter, fit_batch_scatter
from pipeline.fit.survival.covariates import Covariate, make_design
from pipeline.fit.survival.cox_regression import EFRON, EXACT, CoxRegression, fit_cox
from pipeline.fit.survival.kaplan_meier import kaplan_meier
from pipeline.fit.survival.life_regression import LifeRegression, fit_life_regression
from pipeline.fit.survival.lifetime_distributions import EXPONENTIAL, LOG_NORMAL, WEIBULL, Lives, fit_distribution
from pipeline.fit.survival.profile_likelihood import LARGE_SAMPLE_DROP
from pipeline.fit.survival.proportional_hazards import ALL_COVARIATES, check_proportional_hazards
from pipeline.fit.survival.tests import rank_test
from pipeline.fit.survival.turnbull import estimate_turnbull
from schemas.life_covariates import ARRHENIUS, EXPONENTIAL_LAW, INVERSE_POWER
from tests.helpers.published_lives import (
    BALL_BEARINGS,
    DEVICE_A,
    DYESTUFF,
    INSULATING_FLUID,
    LEUKAEMIA_AML,
    MOTORETTES,
    MYLAR,
    OVARIAN,
    SHOCK_ABSORBERS,
    THERNEAU_SIX,
    TURBINE_WHEELS,
    TURNBULL_DRIVERS,
    capacitors,
)
from tests.helpers.survival_data import PLACEBO, TREATED

_KILO = 1000.0
_BOLTZMANN_EV_PER_MK = 8.617333262e-5 * 1000


@dataclass(frozen=True)
class Published:
    """A number as `printed` in a publication, and `find` for ours."""

    dataset: str
    source: str
    statistic: str
    printed: str
    find: Callable[[], float]

    @property
    def ours(self) -> str:
        return as_printed(self.find(), self.printed)

    def __str__(self) -> str:
        return f"{self.dataset}: {self.statistic}"


def as_printed(value: float, printed: str) -> str:
    """The value with as many decimals as the publication gives."""
    return f"{value:.{len(printed.partition('.')[2])}f}"


def _flagged(time: np.ndarray, failed: np.ndarray) -> Lives:
    return Lives(time, np.where(failed, time, np.inf))


@cache
def _capacitors() -> LifeRegression:
    celsius, volts, limits = capacitors()
    stresses = [Covariate("temperature", EXPONENTIAL_LAW, celsius), Covariate("voltage", EXPONENTIAL_LAW, volts)]
    return fit_life_regression(Lives(*limits), stresses)


@cache
def _motorettes() -> LifeRegression:
    celsius, limits = MOTORETTES
    # The publication has 273.2 where Celsius' zero is 273.15 K.
    return fit_life_regression(Lives(*limits), [Covariate("temperature", ARRHENIUS, celsius + 0.05, "°C")], LOG_NORMAL)


@cache
def _fluid(kilovolts: float) -> LifeRegression:
    voltage, (lower, upper) = INSULATING_FLUID
    here = voltage == kilovolts
    return fit_life_regression(Lives(lower[here], upper[here]), [])


@cache
def _fluid_law() -> LifeRegression:
    voltage, limits = INSULATING_FLUID
    return fit_life_regression(Lives(*limits), [Covariate("voltage", INVERSE_POWER, voltage, "kV")])


@cache
def _turbine() -> LifeRegression:
    return fit_life_regression(Lives(*TURBINE_WHEELS), [], LOG_NORMAL)


@cache
def _six(family: str) -> LifeRegression:
    time, failed, x = THERNEAU_SIX
    return fit_life_regression(_flagged(time, failed), [Covariate("x", EXPONENTIAL_LAW, x)], family)


@cache
def _ovarian(family: str, *names: str) -> LifeRegression:
    days, died, *_ = OVARIAN.T
    return fit_life_regression(_flagged(days, died > 0), _ovarian_covariates(*names), family)


def _ovarian_covariates(*names: str) -> list[Covariate]:
    columns = dict(zip(("age", "rx", "ecog.ps"), OVARIAN.T[2:], strict=True))
    return [Covariate(name, EXPONENTIAL_LAW, columns[name]) for name in names]


@cache
def _ovarian_cox(*names: str) -> CoxRegression:
    days, died, *_ = OVARIAN.T
    return fit_cox(_flagged(days, died > 0), make_design(_ovarian_covariates(*names), died > 0))


@cache
def _ovarian_proportionality() -> dict[str, tuple[float, float]]:
    days, died, *_ = OVARIAN.T
    design = make_design(_ovarian_covariates("age", "ecog.ps"), died > 0)
    tests = check_proportional_hazards(_flagged(days, died > 0), design, _ovarian_cox("age", "ecog.ps"))
    return {test.covariate: (test.statistic, test.p_value) for test in tests}


@cache
def _turnbull() -> np.ndarray:
    lower, upper = [], []
    for time, (failed, right, left) in TURNBULL_DRIVERS.items():
        lower += [time] * (failed + right) + [0.0] * left
        upper += [time] * failed + [np.inf] * right + [time] * left
    return estimate_turnbull(Lives(np.array(lower, dtype=float), np.array(upper, dtype=float))).survival


def _aml(group: int, time: float) -> float:
    lower, upper = LEUKAEMIA_AML[group]
    return float(kaplan_meier(lower, np.isfinite(upper)).survival_at([time])[0])


def _aml_log_rank() -> float:
    groups = [(lower, np.isfinite(upper)) for lower, upper in LEUKAEMIA_AML]
    return rank_test(groups).statistic


@cache
def _remission(ties: str) -> CoxRegression:
    time, failed = (np.concatenate(pair) for pair in zip(TREATED, PLACEBO, strict=True))
    placebo = np.repeat([0.0, 1.0], 21)
    return fit_cox(_flagged(time, failed), make_design([Covariate("placebo", EXPONENTIAL_LAW, placebo)], failed), ties)


@cache
def _dyestuff() -> BatchScatter:
    logs = DYESTUFF.ravel() / _KILO
    return fit_batch_scatter(
        Lives(np.exp(logs), np.exp(logs)), [], np.repeat(list("ABCDEF"), 5).tolist(), LOG_NORMAL, drop=LARGE_SAMPLE_DROP
    )


def _dyestuff_deviance() -> float:
    logs = DYESTUFF.ravel() / _KILO
    return float(-2 * (_dyestuff().log_likelihood + logs.sum()) + 2 * logs.size * np.log(_KILO))


@cache
def _alone(lives: str, family: str) -> LifeRegression:
    data = {"bearings": BALL_BEARINGS, "absorbers": SHOCK_ABSORBERS}[lives]
    return fit_life_regression(Lives(*data), [], family)


@cache
def _stressed(lives: str) -> LifeRegression:
    if lives == "device":
        return fit_life_regression(Lives(*DEVICE_A[1]), [Covariate("temperature", ARRHENIUS, DEVICE_A[0])], LOG_NORMAL)
    return fit_life_regression(Lives(*MYLAR[1]), [Covariate("field", INVERSE_POWER, MYLAR[0])], LOG_NORMAL)


def _c(fit: LifeRegression, column: int) -> float:
    return fit.coefficients[column].value.value


def _without(fit: LifeRegression, *covariates: str) -> float:
    """Likelihood-ratio statistic of a covariate."""
    return next(test.statistic for test in fit.tests if test.against in covariates)


def _of_regression(
    dataset: str, source: str, fit: Callable[[], LifeRegression], printed: dict[str, str]
) -> Iterator[Published]:
    """Rows of a regression by the names `intercept`, those of its covariates, `scale`, `log-likelihood`, `s.e. of …`."""

    def find(name: str) -> float:
        found = fit()
        if name == "scale":
            return found.sigma.value
        if name == "log-likelihood":
            return found.log_likelihood
        error = name.startswith("s.e. of ")
        one = next(c for c in found.coefficients if c.name == name.removeprefix("s.e. of "))
        return one.standard_error if error else one.value.value

    for name, number in printed.items():
        yield Published(dataset, source, name, number, lambda name=name: find(name))  # type: ignore[misc]


def _collect() -> Iterator[Published]:
    example, sas = "R survival 3.8, output of its examples", "R survival, tests/r_sas.Rout.save"
    reg = "R survival, tests/testreg.Rout.save (after SAS)"
    yield from _of_regression(
        "glass capacitors, Weibull over °C and V", example, _capacitors,
        {"intercept": "13.40701688", "temperature": "-0.02890466", "voltage": "-0.00591082", "scale": "0.3638092",
         "log-likelihood": "-244.2"},
    )  # fmt: skip
    name = "motorettes, log-normal after Arrhenius"
    yield from _of_regression(
        name, sas, _motorettes,
        {"intercept": "-10.471", "s.e. of intercept": "2.772", "scale": "0.604", "log-likelihood": "-145.9"},
    )  # fmt: skip
    # Slope over 1000/K: that over 1/(k T) in 1/eV times k.
    yield Published(name, sas, "slope", "8.322", lambda: _c(_motorettes(), 1) / _BOLTZMANN_EV_PER_MK)
    yield Published(
        name, sas, "s.e. of slope", "1.284", lambda: _motorettes().coefficients[1].standard_error / _BOLTZMANN_EV_PER_MK
    )
    yield Published(
        name, sas, "likelihood ratio of temperature", "18.3", lambda: _without(_motorettes(), "temperature")
    )
    at_130 = np.array([1 / (8.617333262e-5 * (130 + 273.2))])
    for share, hours in ((0.1, "12033"), (0.5, "26096"), (0.9, "56592")):
        yield Published(
            name, sas, f"hours at 130 °C until {100 * share:g} % failed", hours,
            lambda share=share: _motorettes().life_at(at_130, share).value,  # type: ignore[misc]
        )  # fmt: skip
    for kilovolts, location, scale in (
        (26, "6.86249", "1.83423"), (30, "4.35133", "0.94446"), (34, "2.50326", "1.29732"), (38, "0.00093", "0.73368"),
    ):  # fmt: skip
        yield from _of_regression(
            f"insulating fluid at {kilovolts} kV, Weibull", sas,
            lambda kilovolts=kilovolts: _fluid(kilovolts),  # type: ignore[misc]
            {"intercept": location, "scale": scale},
        )  # fmt: skip
    yield from _of_regression(
        "insulating fluid, Weibull over ln kV", "W. Nelson, Accelerated Testing (1990)", _fluid_law,
        {"intercept": "64.85", "voltage": "-17.73", "scale": "1.288"},
    )  # fmt: skip
    yield from _of_regression(
        "turbine wheels inspected once, log-normal", sas, _turbine,
        {"intercept": "3.700", "s.e. of intercept": "0.0708", "scale": "0.72", "log-likelihood": "-190.7"},
    )  # fmt: skip
    for family, printed in {
        WEIBULL: {"intercept": "2.2373335", "x": "-0.7442249", "scale": "0.4563163", "log-likelihood": "-10.3",
                  "s.e. of intercept": "0.330", "s.e. of x": "0.486"},
        EXPONENTIAL: {"intercept": "2.442347", "x": "-1.056053", "log-likelihood": "-11.7", "s.e. of x": "1.000"},
        "log-logistic": {"intercept": "2.177208", "x": "-1.195672", "scale": "0.3847582", "log-likelihood": "-10.7",
                         "s.e. of x": "0.711"},
        LOG_NORMAL: {"intercept": "2.210", "x": "-1.268", "scale": "0.64", "log-likelihood": "-10.5", "s.e. of x": "0.585"},
    }.items():  # fmt: skip
        yield from _of_regression(
            f"Therneau and Grambsch's six lives, {family}", reg,
            lambda family=family: _six(family), printed,  # type: ignore[misc]
        )  # fmt: skip
    for family, names, source, printed in (
        (WEIBULL, ("age", "ecog.ps"), reg,
         {"intercept": "12.28496723", "age": "-0.09702669", "ecog.ps": "0.09977342", "scale": "0.6032744"}),
        ("log-logistic", ("age", "ecog.ps"), reg,
         {"intercept": "11.50853384", "age": "-0.08876814", "ecog.ps": "0.09033348", "scale": "0.4464064"}),
        (EXPONENTIAL, ("ecog.ps", "rx"), example,
         {"intercept": "6.9618376", "ecog.ps": "-0.4331347", "rx": "0.5815027", "log-likelihood": "-97.2"}),
    ):  # fmt: skip
        yield from _of_regression(
            f"ovarian cancer, {family} over {' and '.join(names)}", source,
            lambda family=family, names=names: _ovarian(family, *names), printed,  # type: ignore[misc]
        )  # fmt: skip
    cox = "R survival, tests/ovarian.Rout.save"
    for names, effects in (
        (("age",), (("0.16162", "0.04974"),)),
        (("age", "rx", "ecog.ps"), (("0.1470", "0.0463"), ("-0.8146", "0.6342"), ("0.1032", "0.6064"))),
    ):
        for i, (effect, error) in enumerate(effects):
            label = f"ovarian cancer, Cox over {' and '.join(names)}"
            yield Published(
                label, cox, names[i], effect,
                lambda names=names, i=i: _ovarian_cox(*names).effects[i].value.value,  # type: ignore[misc]
            )  # fmt: skip
            yield Published(
                label, cox, f"s.e. of {names[i]}", error,
                lambda names=names, i=i: _ovarian_cox(*names).effects[i].standard_error,  # type: ignore[misc]
            )  # fmt: skip
    for covariate, statistic, p_value in (
        ("age", "0.698", "0.40"), ("ecog.ps", "2.371", "0.12"), (ALL_COVARIATES, "3.633", "0.16"),
    ):  # fmt: skip
        for i, (what, number) in enumerate((("χ²", statistic), ("p", p_value))):
            yield Published(
                "ovarian cancer, proportional hazards", example, f"{what} of {covariate}", number,
                lambda covariate=covariate, i=i: _ovarian_proportionality()[covariate][i],  # type: ignore[misc]
            )  # fmt: skip
    for i, survival in enumerate(("0.538", "0.295", "0.210", "0.095")):
        yield Published(
            "Turnbull's doubly censored lives", "R survival, tests/turnbull.Rout.save", f"survival at {i + 1}", survival,
            lambda i=i: float(_turnbull()[i]),  # type: ignore[misc]
        )  # fmt: skip
    aml = "R survival, tests/doaml.Rout.save (after Miller, 1981)"
    for group, curve in enumerate(
        (
            {9: "0.909", 13: "0.818", 18: "0.716", 23: "0.614", 31: "0.491", 34: "0.368", 48: "0.184"},
            {
                5: "0.8333",
                8: "0.6667",
                12: "0.5833",
                23: "0.4861",
                27: "0.3889",
                30: "0.2917",
                33: "0.1944",
                43: "0.0972",
            },
        )
    ):
        for time, survival in curve.items():
            yield Published(
                f"leukaemia, {'without' if group else 'with'} maintenance, Kaplan–Meier", aml, f"survival at {time} weeks",
                survival, lambda group=group, time=time: _aml(group, time),  # type: ignore[misc]
            )  # fmt: skip
    yield Published("leukaemia, log-rank", aml, "χ²", "3.4", _aml_log_rank)
    for ties, effect, error in ((EFRON, "1.5721", "0.4124"), (EXACT, "1.6282", "0.4331")):
        label, source = f"remission of leukaemia, Cox, {ties} ties", "Freireich (1963), R's coxph"
        yield Published(label, source, "effect", effect, lambda ties=ties: _remission(ties).effects[0].value.value)  # type: ignore[misc]
        yield Published(label, source, "s.e.", error, lambda ties=ties: _remission(ties).effects[0].standard_error)  # type: ignore[misc]
    lme4 = "R lme4, example of profile-methods"
    for what, printed_number, find in (
        ("scatter between batches", "37.26", lambda: _KILO * _dyestuff().tau.value),
        ("its lower 95 % limit", "12.20", lambda: _KILO * _dyestuff().tau.lower),
        ("its upper 95 % limit", "84.063", lambda: _KILO * _dyestuff().tau.upper),
        ("scatter within batches", "49.51", lambda: _KILO * _dyestuff().sigma),
        ("mean", "1527.5", lambda: _KILO * _dyestuff().coefficients[0].value.value),
        ("s.e. of the mean", "17.69", lambda: _KILO * _dyestuff().coefficients[0].standard_error),
        ("deviance", "327.3271", _dyestuff_deviance),
    ):
        yield Published("dyestuff, batches at random", lme4, what, printed_number, find)
    lawless, meeker = "J. Lawless (1982), p. 170; K. Leemis, Reliability (2009)", "W. Meeker, L. Escobar (1998)"
    yield Published(
        "ball bearings, Weibull", lawless, "scale", "81.88", lambda: float(np.exp(_c(_alone("bearings", WEIBULL), 0)))
    )
    yield Published(
        "ball bearings, Weibull", lawless, "shape", "2.102", lambda: 1 / _alone("bearings", WEIBULL).sigma.value
    )
    yield from _of_regression(
        "ball bearings, log-normal", meeker, lambda: _alone("bearings", LOG_NORMAL),
        {"intercept": "4.15", "scale": "0.522", "log-likelihood": "-113.13"},
    )  # fmt: skip
    yield Published(
        "shock absorbers, Weibull", meeker, "shape", "3.16", lambda: 1 / _alone("absorbers", WEIBULL).sigma.value
    )
    yield from _of_regression(
        "device A, log-normal after Arrhenius", meeker, lambda: _stressed("device"),
        {"intercept": "-13.5", "s.e. of intercept": "2.9", "temperature": "0.63", "s.e. of temperature": "0.083", "scale": "0.98", "log-likelihood": "-321.7"},
    )  # fmt: skip
    yield from _of_regression(
        "Mylar insulation, log-normal over ln field", meeker, lambda: _stressed("mylar"),
        {"intercept": "27.5", "s.e. of intercept": "3.00", "field": "-4.29", "s.e. of field": "0.60", "scale": "1.05", "log-likelihood": "-271.4"},
    )  # fmt: skip
    yield Published(
        "remission of leukaemia, Weibull", "Freireich (1963); R's survreg", "shape", "1.35373",
        lambda: fit_distribution(Lives.right_censored(*TREATED), WEIBULL, goodness=False).parameters["shape"].value,
    )  # fmt: skip


ANALYSES: tuple[Published, ...] = tuple(_collect())
