"""Do the 95 % intervals of the life regressions hold their level, family by family, down to ten specimens per group?

    python -m tests.studies.study_lives [--draws N] [--seed N]

Batches are drawn with a scatter of their own, and lives with and without a voltage below which nothing fails. Where limits are those
of the information of few failures, or of the likelihood of ten per group, those by simulation stand beside them.

Lives are drawn at three voltages by each family, and fitted by the family that they were drawn by; the shares of draws whose
interval contains the truth are printed for the exponent, the scatter, the shape, and the median life at a voltage below the
lowest one tested.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import dataclass

import numpy as np

from pipeline.fit.survival.batch_scatter import fit_batch_scatter
from pipeline.fit.survival.covariates import Covariate, make_design
from pipeline.fit.survival.cox_regression import fit_cox
from pipeline.fit.survival.endurance_limit import find_endurance_limit
from pipeline.fit.survival.error_distributions import LOGISTIC, log_gamma
from pipeline.fit.survival.kaplan_meier import Estimate
from pipeline.fit.survival.life_regression import (
    FAMILIES,
    GENERALISED_GAMMA,
    fit_life_regression,
    limit_deviations,
    limit_drop,
)
from pipeline.fit.survival.lifetime_distributions import EXPONENTIAL, WEIBULL, Lives
from pipeline.fit.survival.log_location_scale import (
    NORMAL,
    SMALLEST_EXTREME_VALUE,
    LogLives,
    differentiate,
    maximise,
)
from pipeline.fit.survival.resampling import CORRECTED, PIVOTS, simulate_limits
from schemas.arrays import Float
from schemas.errors import DealabError
from schemas.life_covariates import CATEGORY, INVERSE_POWER

VOLTAGES_KV, USE_KV = (4.0, 5.0, 6.0), 3.0
INTERCEPT, EXPONENT, SIGMA, SHAPE = 18.0, -6.0, 0.6, 0.5
ESTIMATES = ("exponent", "scatter", "shape", f"median life at {USE_KV:g} kV")
ERRORS = {
    "exponential": SMALLEST_EXTREME_VALUE,
    "weibull": SMALLEST_EXTREME_VALUE,
    "log-normal": NORMAL,
    "log-logistic": LOGISTIC,
    "generalised gamma": log_gamma(SHAPE),
}


@dataclass(frozen=True)
class Design:
    """Specimens per voltage, share of all lives that the end of the test cuts off, and whether failures are inspected."""

    specimens: int
    censored: float
    inspected: bool = False

    def __str__(self) -> str:
        how = "found at inspections" if self.inspected else "timed"
        return f"{self.specimens} per voltage, {100 * self.censored:.0f} % censored, {how}"


BATCHES = ((0.0, 8), (0.5, 5), (0.5, 8), (0.5, 20))
LIMITS_KV = (0.0, 3.0)
SLOW_SHARE = 0.1
"""Of the draws that are fitted alone, for those with batches or a limit, and for limits by simulation of generalised gammas."""
SIMULATED = {False: 400, True: 100}
"""Tests by which limits are simulated, without and with a shape to be fitted."""
DESIGNS = (Design(10, 0.0), Design(10, 0.3), Design(10, 0.3, inspected=True), Design(40, 0.3))


def draw(family: str, design: Design, rng: np.random.Generator) -> tuple[Lives, Float, Float]:
    """Lives in s of one campaign, their voltages in kV, and w: standardised lives."""
    voltage = np.repeat(VOLTAGES_KV, design.specimens)
    w = ERRORS[family].quantile_of_survival(rng.uniform(size=voltage.size))
    sigma = 1.0 if family == EXPONENTIAL else SIGMA
    life = np.exp(INTERCEPT + EXPONENT * np.log(voltage) + sigma * w)
    # Each voltage has an end of its own, at the same share of its lives.
    end = np.inf
    if design.censored:
        cut = float(ERRORS[family].quantile_of_survival(np.array(design.censored)))
        end = np.exp(INTERCEPT + EXPONENT * np.log(voltage) + sigma * cut)
    failed = life <= end
    if not design.inspected:
        return Lives(np.minimum(life, end), np.where(failed, life, np.inf)), voltage, w
    step = np.exp(INTERCEPT + EXPONENT * np.log(voltage)) / 8
    before = np.floor(np.minimum(life, end) / step) * step
    return Lives(np.where(failed, before, end), np.where(failed, before + step, np.inf)), voltage, w


def judge(family: str, design: Design, draws: int, seed: int) -> tuple[dict[str, float], int, str]:
    """Share of the intervals that hold the truth by estimate, how many draws were refused, and the method in use."""
    rng = np.random.default_rng((seed, FAMILIES.index(family), DESIGNS.index(design)))
    sigma = 1.0 if family == EXPONENTIAL else SIGMA
    middle = float(ERRORS[family].quantile_of_survival(np.array(0.5)))
    life = float(np.exp(INTERCEPT + EXPONENT * np.log(USE_KV) + sigma * middle))
    truth = dict(zip(ESTIMATES, (EXPONENT, sigma, SHAPE, life), strict=True))
    held: Counter[str] = Counter()
    counted: Counter[str] = Counter()
    refused, methods = 0, set()
    for _ in range(draws):
        lives, voltage, _ = draw(family, design, rng)
        try:
            fit = fit_life_regression(lives, [Covariate("voltage", INVERSE_POWER, voltage, "kV")], family)
        except DealabError:
            refused += 1
            continue
        methods.add(fit.method)
        found: tuple[Estimate | None, ...] = (
            fit.coefficients[1].value,
            None if family == EXPONENTIAL else fit.sigma,
            fit.shape,
            fit.life_at(np.log([USE_KV])),
        )
        for name, one in zip(ESTIMATES, found, strict=True):
            if one is not None:
                counted[name] += 1
                held[name] += not one.lower > truth[name] and not one.upper < truth[name]
    return {name: held[name] / number for name, number in counted.items()}, refused, " or ".join(sorted(methods))


def judge_together(family: str, design: Design, draws: int, seed: int) -> tuple[dict[str, float], int, str]:
    """As `judge`, for families with profile intervals, all draws in one fit.

    A profile interval holds the truth exactly where the profile there has not fallen by the critical drop, so that its
    limits need not be searched; the median life has those of the information, as `LifeRegression.life_at`.
    """
    rng = np.random.default_rng((seed, FAMILIES.index(family), DESIGNS.index(design)))
    drawn = [draw(family, design, rng) for _ in range(draws)]
    with np.errstate(divide="ignore"):
        limits = [np.log([getattr(lives, name) for lives, _, _ in drawn]) for name in ("lower", "upper")]
    logs, error = LogLives(*limits), ERRORS[family]
    x = np.log(drawn[0][1]) - np.log(USE_KV)
    matrix = np.column_stack((np.ones(x.size), x))
    sigma = 1.0 if family == EXPONENTIAL else SIGMA
    held_sigma = 1.0 if family == EXPONENTIAL else None
    best = maximise(logs, matrix, error, sigma=held_sigma)
    failures = np.isfinite(limits[1]).sum(axis=1)
    drop, deviations = (
        np.array([critical(family, int(r), 2) for r in failures]) for critical in (limit_drop, limit_deviations)
    )
    at_exponent = maximise(logs.shifted(EXPONENT * x[None, :]), matrix[:, :1], error, sigma=held_sigma)
    held = {"exponent": best.log_likelihood - at_exponent.log_likelihood <= drop}
    if family != EXPONENTIAL:
        held["scatter"] = best.log_likelihood - maximise(logs, matrix, error, sigma=SIGMA).log_likelihood <= drop
    w = float(error.quantile_of_survival(np.array(0.5)))
    found = np.column_stack((best.alpha, best.gamma))
    information = -differentiate(logs, matrix, error, found)[2]
    centre = (best.gamma[:, 0] + w) / best.alpha
    slope = np.column_stack((-centre / best.alpha, 1 / best.alpha, np.zeros(draws)))
    free = slice(1 if family == EXPONENTIAL else 0, None)
    towards = np.linalg.solve(information[:, free, free], slope[:, free, None])[:, :, 0]
    half = deviations * np.sqrt((towards * slope[:, free]).sum(axis=1))
    truth = INTERCEPT + EXPONENT * np.log(USE_KV) + sigma * w
    held[ESTIMATES[-1]] = np.abs(centre - truth) <= half
    fitted = best.converged & at_exponent.converged
    return {name: float(one[fitted].mean()) for name, one in held.items()}, int((~fitted).sum()), "profile likelihood"


def judge_simulated(
    family: str, design: Design, draws: int, simulated: int, seed: int
) -> tuple[dict[str, float], int, str]:
    """As `judge`, for limits by simulation of `simulated` tests each."""
    rng = np.random.default_rng((seed, FAMILIES.index(family), DESIGNS.index(design), 1))
    sigma = 1.0 if family == EXPONENTIAL else SIGMA
    w = float(ERRORS[family].quantile_of_survival(np.array(0.5)))
    truth = (EXPONENT, sigma, SHAPE, float(np.exp(INTERCEPT + EXPONENT * np.log(USE_KV) + sigma * w)))
    held: Counter[str] = Counter()
    counted: Counter[str] = Counter()
    refused = 0
    for number in range(draws):
        lives, voltage, _ = draw(family, design, rng)
        covariates = [Covariate("voltage", INVERSE_POWER, voltage, "kV")]
        try:
            found = simulate_limits(lives, covariates, family, at=np.log([USE_KV]), draws=simulated, seed=number)
        except (DealabError, np.linalg.LinAlgError):
            refused += 1
            continue
        estimates = (
            found.coefficients["voltage"], None if family == EXPONENTIAL else found.sigma, found.shape, found.median_s,
        )  # fmt: skip
        for name, one, value in zip(ESTIMATES, estimates, truth, strict=True):
            if one is not None:
                counted[name] += 1
                held[name] += one.lower <= value <= one.upper
    method = CORRECTED if family == GENERALISED_GAMMA else PIVOTS
    return {name: held[name] / number for name, number in counted.items()}, refused, f"{method}, {simulated} each"


def judge_cox(design: Design, draws: int, seed: int) -> tuple[int, int, int]:
    """(held, counted, refused) of the logarithm of Cox's hazard ratio between two electrodes, of Weibull lives."""
    rng = np.random.default_rng((seed, len(FAMILIES), DESIGNS.index(design)))
    held = counted = refused = 0
    for _ in range(draws):
        lives, voltage, _ = draw(WEIBULL, design, rng)
        kind = rng.permutation(np.repeat([0.0, 1.0], [voltage.size // 2, voltage.size - voltage.size // 2]))
        # A life longer by 0.5 in ln t is a hazard lower by 0.5/σ; the end of the test moves along.
        longer = np.exp(0.5 * kind)
        moved = Lives(lives.lower * longer, lives.upper * longer)
        covariates = [
            Covariate("voltage", INVERSE_POWER, voltage, "kV"),
            Covariate("electrode", CATEGORY, np.where(kind > 0, "b", "a").tolist()),
        ]
        try:
            effect = fit_cox(moved, make_design(covariates, moved.exact)).effects[1].value
        except DealabError:
            refused += 1
            continue
        counted += 1
        held += effect.lower <= -0.5 / SIGMA <= effect.upper
    return held, counted, refused


def judge_batches(tau: float, batches: int, draws: int, seed: int) -> str:
    """Weibull lives in batches of six, a third censored; the voltage varies within a batch, the electrode between them."""
    rng = np.random.default_rng((seed, batches, int(10 * tau)))
    place = np.repeat(np.arange(batches), 6)
    voltage, kind = np.tile(VOLTAGES_KV, 2 * batches), place % 2
    held: Counter[str] = Counter()
    for _ in range(draws):
        location = INTERCEPT + EXPONENT * np.log(voltage) + 0.5 * kind + tau * rng.normal(size=batches)[place]
        life = np.exp(location + SIGMA * np.log(rng.exponential(size=place.size)))
        end = np.exp(INTERCEPT + EXPONENT * np.log(voltage) + 0.4)
        lives = Lives(np.minimum(life, end), np.where(life <= end, life, np.inf))
        covariates = [
            Covariate("voltage", INVERSE_POWER, voltage, "kV"),
            Covariate("electrode", CATEGORY, np.where(kind > 0, "b", "a").tolist()),
        ]
        try:
            fit = fit_batch_scatter(lives, covariates, place.astype(str).tolist(), WEIBULL)
        except (DealabError, np.linalg.LinAlgError):
            held["refused"] += 1
            continue
        _, slope, effect = (one.value for one in fit.coefficients)
        held["tau"] += fit.tau.lower <= tau <= fit.tau.upper
        held["slope"] += slope.lower <= EXPONENT <= slope.upper
        held["effect"] += effect.lower <= 0.5 <= effect.upper
        held["seen"] += fit.p_value < 0.05
    n = draws - held["refused"]
    shares = "; ".join(
        f"{words} {100 * held[name] / n:.1f} %"
        for name, words in (
            ("tau", "scatter of batches held"), ("slope", "exponent held"), ("effect", "electrode held"), ("seen", "p below 5 %"),
        )
    )  # fmt: skip
    return f"- {batches} batches of 6, scatter {tau:g} between them: {shares}; {held['refused']} of {draws} not fitted"


def judge_limit(limit: float, draws: int, seed: int) -> str:
    """Weibull lives over (voltage − limit)^−3, ten at each of six voltages, cut off by the end of the test."""
    rng = np.random.default_rng((seed, 77, int(10 * limit)))
    voltage = np.repeat([2.0, 3.2, 3.6, 4.0, 5.0, 6.0], 10)
    held = seen = 0
    for _ in range(draws):
        scale = 9 - 3 * np.log(np.maximum(voltage - limit, 1e-12))
        life, end = np.exp(scale + 0.4 * np.log(rng.exponential(size=voltage.size))), 1e5
        lives = Lives(np.minimum(life, end), np.where(life <= end, life, np.inf))
        found = find_endurance_limit(lives, [Covariate("voltage", INVERSE_POWER, voltage, "kV")], WEIBULL)
        held += found.limit.lower <= limit <= found.limit.upper
        seen += found.p_value < 0.05
    shares = f"held {100 * held / draws:.1f} %; p below 5 % {100 * seen / draws:.1f} %"
    return f"- endurance limit of {limit:g} kV: {shares} of {draws}"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--draws", type=int, default=4000, help="draws per family and design; a quarter where each is fitted alone"
    )
    parser.add_argument("--seed", type=int, default=3)
    arguments = parser.parse_args()
    print(
        f"| family | specimens | {' | '.join(ESTIMATES)} | not fitted | method |\n|---|---|{'---:|' * (len(ESTIMATES) + 1)}---|"
    )
    few, slow = arguments.draws // 4, round(SLOW_SHARE * arguments.draws / 4)
    for family in FAMILIES:
        for design in DESIGNS:
            has_shape = family == GENERALISED_GAMMA
            if has_shape and design.inspected:
                continue  # its limits are those of the information whatever is known of the lives
            how, draws = (judge, few) if has_shape else (judge_together, arguments.draws)
            print_row(family, design, draws, *how(family, design, draws, arguments.seed))
        # With shapes a tenth, else a half of the draws that are fitted alone.
        draws = slow if family == GENERALISED_GAMMA else few // 2
        tests = SIMULATED[family == GENERALISED_GAMMA]
        print_row(family, DESIGNS[1], draws, *judge_simulated(family, DESIGNS[1], draws, tests, arguments.seed))
    for design in DESIGNS:
        if not design.inspected:
            held, counted, refused = judge_cox(design, few, arguments.seed)
            share = f"{100 * held / counted:.1f} %"
            print(f"| Cox, ln hazard ratio | {design} | {share} | | | | {refused} of {few} | information |", flush=True)
    print()
    for tau, batches in BATCHES:
        print(judge_batches(tau, batches, slow, arguments.seed), flush=True)
    for limit in LIMITS_KV:
        print(judge_limit(limit, slow, arguments.seed), flush=True)
    print(
        "\nShares of the draws that were fitted. Limits of the median life are those of the information, where they are not simulated."
    )
    return 0


def print_row(family: str, design: Design, draws: int, shares: dict[str, float], refused: int, method: str) -> None:
    cells = (f"{100 * shares[name]:.1f} %" if name in shares else "" for name in ESTIMATES)
    print(f"| {family} | {design} | {' | '.join(cells)} | {refused} of {draws} | {method} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
