"""Do lifelines and surpyval, each with its own likelihood, find the same parameters from samples of every kind of censoring?

    python -m tests.studies.study_peers [--samples N] [--seed N]

Both libraries stop their search where the likelihood no longer changes by much, which leaves parameters apart by 1e-5 or so. So
each is asked twice: as it answers, and with its own likelihood (its code, its derivatives) carried on from there to where the
gradient is zero. Only the second says whether the two likelihoods are the same. Runs in the environment of the peers, which
`make bench` makes.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.fit.survival.lifetime_distributions import LOG_NORMAL, WEIBULL, Lives, fit_distribution
from schemas.arrays import Float
from tests.helpers.drawn_lives import KINDS, Limits, draw_samples

PEERS = Path(__file__).resolve().parents[2] / ".venv-peers" / "bin" / "python"
LIBRARIES = ("lifelines", "surpyval")
SHARES = {WEIBULL: 1.0, LOG_NORMAL: 0.1}
"""Of the samples that are asked for: what a second family adds is seen with fewer."""
WANTED = 1e-6
_STEPS = 8
Answer = tuple[Float, Callable[[Any], Any]]


def fit_lifelines(family: str, limits: Limits) -> Answer:
    """What lifelines answers, and its likelihood of its parameters."""
    import lifelines

    lower, upper, entered = limits
    one = {WEIBULL: lifelines.WeibullFitter, LOG_NORMAL: lifelines.LogNormalFitter}[family]()
    failed = np.isfinite(upper)
    ones = np.ones(lower.size)
    entry = np.zeros(lower.size) if entered is None else entered
    if entered is not None or not failed.all():
        one.fit_right_censoring(lower, failed, entry=entered)
        loss, given = one._negative_log_likelihood_right_censoring, ((lower, None), failed, entry, ones)
    elif (lower == 0).any() and (lower == upper).any():
        one.fit_left_censoring(upper, lower > 0)
        loss, given = one._negative_log_likelihood_left_censoring, ((None, upper), lower > 0, entry, ones)
    else:
        above = np.maximum(lower, 1e-12)  # lifelines takes the logarithm of both ends
        one.fit_interval_censoring(above, upper)
        loss, given = one._negative_log_likelihood_interval_censoring, ((above, upper), above == upper, entry, ones)
    return np.asarray(one._fitted_parameters_, dtype=np.float64), lambda parameters: loss(parameters, *given)


def fit_surpyval(family: str, limits: Limits) -> Answer:
    """What surpyval answers, and its likelihood of its parameters (no shift, nobody dead at 0, nobody immortal)."""
    import surpyval

    lower, upper, entered = limits
    kind = {WEIBULL: surpyval.Weibull, LOG_NORMAL: surpyval.LogNormal}[family]
    one = kind.fit(xl=lower, xr=upper, **({} if entered is None else {"tl": entered}))
    data = one.surv_data
    return np.asarray(one.params, dtype=np.float64), lambda parameters: kind._neg_ll_func(
        data, *parameters, 0.0, 0.0, 1.0
    )


def carry_on(answer: Answer) -> Float:
    """The parameters at which the gradient of the library's own likelihood vanishes, from its answer.

    Newton's steps with the curvature at that answer, which is near: each makes what is missing some 1e5 times smaller.
    """
    from autograd import grad, hessian

    at, loss = answer
    curvature = hessian(loss)(at)
    for _ in range(_STEPS):
        step = np.linalg.solve(curvature, grad(loss)(at))
        at = at - step
        if np.abs(step / at).max() < 1e-9:
            break
    return np.asarray(at, dtype=np.float64)


def own_parameters(family: str, limits: Limits) -> Float:
    """Ours, as the libraries order them: scale and shape, or the mean and standard deviation of ln t."""
    fit = fit_distribution(Lives(*limits), family, goodness=False)
    return np.array([np.exp(fit.location), 1 / fit.sigma] if family == WEIBULL else [fit.location, fit.sigma])


def compare(family: str, kind: str, samples: int, seed: int) -> dict[str, dict[str, Float]]:
    """By library, the largest relative difference of the parameters of each sample, as answered and carried on."""
    found: dict[str, dict[str, list[float]]] = {name: {"answered": [], "carried on": []} for name in LIBRARIES}
    for limits in draw_samples(kind, samples=samples, family=family, seed=seed):
        ours = own_parameters(family, limits)
        for name, fit in zip(LIBRARIES, (fit_lifelines, fit_surpyval), strict=True):
            answer = fit(family, limits)
            for how, theirs in (("answered", answer[0]), ("carried on", carry_on(answer))):
                found[name][how].append(float(np.abs(theirs / ours - 1).max()))
    return {name: {how: np.array(apart) for how, apart in both.items()} for name, both in found.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()
    try:
        import lifelines  # noqa: F401
    except ImportError:
        if not PEERS.exists():
            print("no environment of the peers: make bench makes it", file=sys.stderr)
            return 2
        options = ["--samples", str(arguments.samples), "--seed", str(arguments.seed)]
        return subprocess.run([PEERS, "-m", "tests.studies.study_peers", *options], check=False).returncode
    warnings.simplefilter("ignore")
    shown = f"{WANTED:g}"
    print(f"| family | samples of 40 lives | library | answered, within {shown} | answered, median | "
          f"own likelihood carried on, within {shown} | largest difference |\n|---|---|---|---:|---:|---:|---:|")  # fmt: skip
    good = True
    for family, share in SHARES.items():
        samples = round(share * arguments.samples)
        for kind in KINDS:
            for name, both in compare(family, kind, samples, arguments.seed).items():
                answered, carried = both["answered"], both["carried on"]
                print(
                    f"| {family} | {samples} {kind} | {name} | {100 * np.mean(answered < WANTED):.1f} % | {np.median(answered):.1e} |"
                    f" {100 * np.mean(carried < WANTED):.1f} % | {carried.max():.1e} |",
                    flush=True,
                )
                good = good and bool((carried < WANTED).all())
    if not good:
        print(f"\n- **missed**: a difference below {shown} in every sample")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
