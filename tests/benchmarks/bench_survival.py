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

from pipeline.fit.survival.covariates import Covariate, make_design
from pipeline.fit.survival.cox_regression import fit_cox
from pipeline.fit.survival.kaplan_meier import kaplan_meier
from pipeline.fit.survival.life_regression import FAMILIES, fit_life_regression
from pipeline.fit.survival.lifetime_distributions import WEIBULL, Lives, fit_distribution
from pipeline.fit.survival.tests import permutation_test
from pipeline.transform.breakdown import detect_breakdown
from schemas.life_covariates import CATEGORY, EXPONENTIAL_LAW
from tests.helpers.breakdown_circuits import simulate
from tests.helpers.drawn_lives import KINDS, draw_regression, draw_samples

SAMPLES = 100
"""Of each censoring; whether the libraries find the same is what the study of the peers is about."""
MANY = 100_000
_THEIR_LIVES = f"""
import json, sys, time, warnings
import numpy as np
from tests.helpers.drawn_lives import draw_regression, draw_samples
warnings.simplefilter("ignore")
found = {{}}
if sys.argv[1] == "lifelines":
    import pandas
    from lifelines import WeibullAFTFitter, WeibullFitter
    def fit(kind, lower, upper, entered):
        one = WeibullFitter()
        if kind in ("right-censored", "late"):
            one.fit_right_censoring(lower, np.isfinite(upper), entry=entered)
        elif kind == "left-censored":
            one.fit_left_censoring(upper, lower > 0)
        else:
            one.fit_interval_censoring(np.maximum(lower, 1e-12), upper)
    x, life, failed = draw_regression(3000)
    frame = pandas.DataFrame({{"x": x, "life": life, "failed": failed}})
    begin = time.process_time()
    model = WeibullAFTFitter().fit(frame, "life", "failed")
    seconds = time.process_time() - begin
    found["regression"] = [seconds, float(model.params_["lambda_"]["x"]), float(model.log_likelihood_)]
else:
    import surpyval
    def fit(kind, lower, upper, entered):
        surpyval.Weibull.fit(xl=lower, xr=upper, **({{}} if entered is None else {{"tl": entered}}))
    x, life, failed = draw_regression(3000)
    begin = time.process_time()
    model = surpyval.WeibullPH.fit(x=life, Z=x[:, None], c=1 - failed)
    found["regression"] = [time.process_time() - begin, float(model.params[2]), float(-model.neg_ll())]
for kind in json.loads(sys.argv[2]):
    samples = list(draw_samples(kind, samples={SAMPLES}))
    fit(kind, *samples[0])
    begin = time.process_time()
    for limits in samples:
        fit(kind, *limits)
    found[kind] = time.process_time() - begin
print(json.dumps(found))
"""
TITLE = "Survival"
ROWS = 100_000
RUNS = 7
ROOT = Path(__file__).resolve().parents[2]
PEERS = ROOT / ".venv-peers" / "bin" / "python"
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
    own: dict[str, float] = {}
    for kind in KINDS:
        samples = [Lives(*limits) for limits in draw_samples(kind, samples=SAMPLES)]
        begin = time.process_time()
        for lives in samples:
            fit_distribution(lives, WEIBULL, goodness=False)
        own[kind] = time.process_time() - begin
    x, life, failed = draw_regression(3000)
    lives, covariates = Lives(life, np.where(failed, life, np.inf)), [Covariate("x", EXPONENTIAL_LAW, x)]
    seconds = median_seconds(lambda: fit_life_regression(lives, covariates))
    fit = fit_life_regression(lives, covariates)
    rows: list[dict[str, Any]] = [
        {"name": "Weibull regression with intervals and tests, 3000 lives", "seconds": seconds},
        *_time_many(*draw_regression(MANY)),
        *(
            {"name": f"{SAMPLES} Weibull samples of 40 {kind} lives, with profile intervals", "seconds": took}
            for kind, took in own.items()
        ),
    ]
    for peer in ("lifelines", "surpyval"):
        command = [PEERS, "-c", _THEIR_LIVES, peer, json.dumps(KINDS)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=1800, cwd=ROOT)
        theirs = json.loads(done.stdout)
        took, slope, likelihood = theirs["regression"]
        # surpyval's is one of proportional hazards: of a Weibull law the same, its slope that of the hazard.
        ours = fit.coefficients[1].value.value * (1 if peer == "lifelines" else -1 / fit.sigma.value)
        note = f"exponents differ by {abs(slope - ours):.1e}, likelihoods by {abs(likelihood - fit.log_likelihood):.1e}"
        rows.append(_beside(f"Weibull regression by {peer}, same lives", took, seconds, note))
        rows += [
            _beside(f"{peer}, the same samples of {kind} lives", theirs[kind], own[kind], "without profile intervals")
            for kind in KINDS
        ]
    return rows


def _beside(name: str, theirs: float, ours: float, note: str) -> dict[str, Any]:
    return {
        "name": name,
        "seconds": theirs,
        "ratio": theirs / ours,
        "note": f"ratio: ours is so many times faster (target 5); {note}",
    }


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
