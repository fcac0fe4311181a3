"""Survival and breakdown detection beside lifelines and surpyval in the same run, and what a night costs.

Seconds are those of the processor: nothing here waits, and they are the same on a busy machine.
"""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.fit.survival.covariates import CATEGORY, EXPONENTIAL_LAW, Covariate, make_design
from pipeline.fit.survival.cox_regression import fit_cox
from pipeline.fit.survival.kaplan_meier import kaplan_meier
from pipeline.fit.survival.life_regression import FAMILIES, fit_life_regression
from pipeline.fit.survival.lifetime_distributions import WEIBULL, Lives, fit_distribution
from pipeline.fit.survival.tests import permutation_test
from pipeline.transform.breakdown import detect_breakdown
from tests.helpers.breakdown_circuits import simulate

SAMPLES, LIVES, KINDS = 1000, 40, ("right-censored", "left-censored", "inspected", "late")
MANY = 100_000
_DRAWN = f"""
import numpy as np
def draw(kind):
    rng = np.random.default_rng(7)
    for _ in range({SAMPLES}):
        life = 100 * rng.weibull(1.7, {LIVES})
        if kind == "right-censored":
            end = rng.uniform(30, 250, {LIVES})
            yield np.minimum(life, end), np.where(life <= end, life, np.inf), None
        elif kind == "left-censored":
            seen = rng.uniform(5, 60, {LIVES})
            yield np.where(life < seen, 0.0, life), np.maximum(life, seen), None
        elif kind == "inspected":
            yield np.floor(life / 20) * 20, np.floor(life / 20) * 20 + 20, None
        else:
            # Those that had failed before they came under watch are not in the sample.
            life, entered = 100 * rng.weibull(1.7, 4 * {LIVES}), rng.uniform(0, 80, 4 * {LIVES})
            seen = np.flatnonzero(life > entered)[:{LIVES}]
            end = entered[seen] + rng.uniform(30, 250, seen.size)
            yield np.minimum(life[seen], end), np.where(life[seen] <= end, life[seen], np.inf), entered[seen]
def regression(n):
    rng = np.random.default_rng(8)
    voltage = rng.choice([4.0, 5.0, 6.0], n)
    life, end = np.exp(16 - 6 * np.log(voltage)) * rng.weibull(1.7, n), 2000.0
    return np.log(voltage), np.minimum(life, end), life <= end
"""
_THEIR_LIVES = (
    _DRAWN
    + """
import json, sys, time, warnings
warnings.simplefilter("ignore")
found = {}
if sys.argv[1] == "lifelines":
    import pandas
    from lifelines import WeibullAFTFitter, WeibullFitter
    def fit(kind, lower, upper, entered):
        one = WeibullFitter()
        one._scipy_fit_options = {"ftol": 1e-15, "gtol": 1e-10}
        if kind == "right-censored":
            one.fit_right_censoring(lower, np.isfinite(upper))
        elif kind == "late":
            one.fit_right_censoring(lower, np.isfinite(upper), entry=entered)
        elif kind == "left-censored":
            one.fit_left_censoring(upper, lower > 0)
        else:
            one.fit_interval_censoring(np.maximum(lower, 1e-12), upper)
        return [float(one.rho_), float(one.lambda_)]
    x, life, failed = regression(3000)
    frame = pandas.DataFrame({"x": x, "life": life, "failed": failed})
    begin = time.process_time()
    model = WeibullAFTFitter().fit(frame, "life", "failed")
    seconds = time.process_time() - begin
    found["regression"] = [seconds, float(model.params_["lambda_"]["x"]), float(model.log_likelihood_)]
else:
    import surpyval
    def fit(kind, lower, upper, entered):
        late = {} if entered is None else {"tl": entered}
        one = surpyval.Weibull.fit(xl=lower, xr=upper, **late)
        return [float(one.params[1]), float(one.params[0])]
for kind in json.loads(sys.argv[2]):
    begin = time.process_time()
    found[kind] = [[fit(kind, *limits) for limits in draw(kind)], time.process_time() - begin]
print(json.dumps(found))
"""
)
TITLE = "Survival"
ROWS = 100_000
RUNS = 7
PEERS = Path(__file__).resolve().parents[2] / ".venv-peers" / "bin" / "python"
_THEIRS = f"""
import json, time
import numpy as np
from lifelines import KaplanMeierFitter
rng = np.random.default_rng(1)
life, failed = rng.exponential(1.0, {ROWS}), rng.random({ROWS}) < 0.7
seconds = []
for _ in range({RUNS}):
    begin = time.process_time()
    curve = KaplanMeierFitter().fit(life, failed)
    seconds.append(time.process_time() - begin)
print(json.dumps([float(np.median(seconds)), float(curve.survival_function_.iloc[{ROWS} // 2, 0])]))
"""


def median_seconds(work: Callable[[], object]) -> float:
    seconds = []
    for _ in range(RUNS):
        begin = time.process_time()
        work()
        seconds.append(time.process_time() - begin)
    return float(np.median(seconds))


def _log_likelihood(limits: Any, shape: float, scale: float) -> float:
    """Of a Weibull law, straight from its definition."""
    lower, upper, entered = limits
    with np.errstate(divide="ignore"):
        exact = lower == upper
        density = np.log(shape / scale) + (shape - 1) * np.log(lower / scale) - (lower / scale) ** shape
        before, after = (np.exp(-((ends / scale) ** shape)) for ends in (lower, upper))
        total = float(np.where(exact, density, np.log(np.where(exact, 1.0, before - after))).sum())
    return total + (0.0 if entered is None else float(((entered / scale) ** shape).sum()))


def _time_many(x: Any, life: Any, failed: Any) -> list[dict[str, Any]]:
    """Regressions of 100 000 lives with two covariates, and Cox's model of the same."""
    lives = Lives(life, np.where(failed, life, np.inf))
    kind = np.random.default_rng(9).choice(["a", "b", "c"], life.size).tolist()
    covariates = [Covariate("x", EXPONENTIAL_LAW, x), Covariate("kind", CATEGORY, kind)]
    rows = []
    for family in FAMILIES:
        begin = time.process_time()
        fit = fit_life_regression(lives, covariates, family)
        seconds = time.process_time() - begin
        note = f"aim: 2 s; {fit.failures} failed, exponent {fit.coefficients[1].value.value:.3f}"
        rows.append({"name": f"{family} regression of {MANY} lives, two covariates", "seconds": seconds, "note": note})
    begin = time.process_time()
    fit_cox(lives, make_design(covariates, failed))
    rows.append({"name": f"Cox's model of the same {MANY} lives", "seconds": time.process_time() - begin})
    return rows


def _compare_lives() -> list[dict[str, Any]]:
    """Weibull fits of samples of every censoring, and a regression, beside lifelines and surpyval."""
    space: dict[str, Any] = {}
    exec(_DRAWN, space)
    own: dict[str, tuple[Any, float]] = {}
    for kind in KINDS:
        begin = time.process_time()
        fits = [fit_distribution(Lives(*limits), WEIBULL, goodness=False) for limits in space["draw"](kind)]
        found = np.array([[fit.parameters["shape"].value, fit.parameters["scale_s"].value] for fit in fits])
        own[kind] = found, time.process_time() - begin
    x, life, failed = space["regression"](3000)
    lives, covariates = Lives(life, np.where(failed, life, np.inf)), [Covariate("x", EXPONENTIAL_LAW, x)]
    seconds = median_seconds(lambda: fit_life_regression(lives, covariates))
    fit = fit_life_regression(lives, covariates)
    rows: list[dict[str, Any]] = [
        {"name": "Weibull regression with intervals and tests, 3000 lives", "seconds": seconds},
        *_time_many(*space["regression"](MANY)),
    ]
    for peer in ("lifelines", "surpyval"):
        command = [PEERS, "-c", _THEIR_LIVES, peer, json.dumps(KINDS)]
        theirs = json.loads(subprocess.run(command, capture_output=True, text=True, check=True, timeout=1800).stdout)
        if "regression" in theirs:
            took, slope, likelihood = theirs["regression"]
            apart = f"exponents differ by {abs(slope - fit.coefficients[1].value.value):.1e}, likelihoods by"
            rows.append(
                {
                    "name": f"{peer}’ Weibull regression, same lives",
                    "seconds": took,
                    "ratio": took / seconds,
                    "note": f"ratio: ours is so many times faster (target 5); {apart} {abs(likelihood - fit.log_likelihood):.1e}",
                }
            )
        for kind in KINDS:
            found = np.array(theirs[kind][0])
            off = np.abs(found / own[kind][0] - 1).max(axis=1)
            lower_likelihood = [
                _log_likelihood(limits, *found[i]) < _log_likelihood(limits, *own[kind][0][i])
                for i, limits in enumerate(space["draw"](kind))
                if off[i] >= 1e-6
            ]
            rows.append(
                {
                    "name": f"{peer}, {SAMPLES} Weibull samples of {LIVES} {kind} lives",
                    "seconds": theirs[kind][1],
                    "ratio": theirs[kind][1] / own[kind][1],
                    "note": "ratio: ours, with profile intervals, is so many times faster; parameters differ by a median of "
                    f"{np.median(off):.1e}, by less than 1e-6 in {100 * np.mean(off < 1e-6):.1f} %, by {off.max():.1e} at most; of the {len(lower_likelihood)} "
                    f"others {peer} ended at a lower likelihood in {sum(lower_likelihood)}",
                }
            )
    return rows


def run() -> list[dict[str, Any]]:
    rng = np.random.default_rng(1)
    life, failed = rng.exponential(1.0, ROWS), rng.random(ROWS) < 0.7
    own = median_seconds(lambda: kaplan_meier(life, failed))
    rows: list[dict[str, Any]] = [{"name": f"Kaplan–Meier with bands, {ROWS} rows", "seconds": own}]
    if PEERS.exists():
        answer = subprocess.run([PEERS, "-c", _THEIRS], capture_output=True, text=True, check=True, timeout=300)
        theirs, survival = json.loads(answer.stdout)
        difference = abs(float(kaplan_meier(life, failed).survival[ROWS // 2 - 1]) - survival)
        rows.append(
            {
                "name": "lifelines' Kaplan–Meier, same rows",
                "seconds": theirs,
                "ratio": theirs / own,
                "note": f"ratio: ours is so many times faster (target 5); curves differ by {difference:.1e}",
            }
        )
    else:
        rows.append({"name": "lifelines' Kaplan–Meier", "note": "skipped: no .venv-peers (make peers)"})
    rows += _compare_lives() if PEERS.exists() else []
    a = (rng.exponential(1.0, 20), np.ones(20, dtype=bool))
    b = (rng.exponential(2.0, 20), np.ones(20, dtype=bool))
    rows.append(
        {"name": "exact permutation of 20 against 20", "seconds": median_seconds(lambda: permutation_test(a, b))}
    )
    cases = [simulate(rng, number).recording for number in range(20)]
    each = median_seconds(lambda: [detect_breakdown(case) for case in cases]) / len(cases)
    samples = int(np.mean([case.channels["voltage"].values.size for case in cases]))
    rows.append({"name": "breakdown detection of one record", "seconds": each, "note": f"{samples} samples on average"})
    return rows
