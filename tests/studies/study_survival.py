"""Do the 95 % intervals of the survival analysis hold their level in groups of laboratory size?

    python -m tests.studies.study_survival [--groups N] [--seed N]

Groups are drawn from Weibull lives censored at the end of the test; the shares of groups whose interval contains the
truth are printed for restricted mean, median, survival at a time, Weibull shape and Weibull scale.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

import numpy as np
from scipy import integrate

from pipeline.fit.survival.kaplan_meier import Estimate, kaplan_meier
from pipeline.fit.survival.lifetime_distributions import WEIBULL, Lives, fit_distribution


@dataclass(frozen=True)
class Design:
    """Specimens per group, Weibull shape and scale in s, end of the test in s."""

    specimens: int
    shape: float
    scale_s: float
    end_s: float


DESIGNS = (
    Design(20, 1.0, 39.0, 240.0),
    Design(20, 7.0, 215.0, 240.0),
    Design(10, 7.0, 215.0, 240.0),
    Design(10, 1.5, 100.0, 150.0),
    Design(8, 2.0, 100.0, 90.0),
    Design(5, 1.5, 100.0, 1000.0),
)


def coverage(design: Design, groups: int, seed: int) -> dict[str, float]:
    """Share of groups whose interval contains the truth, by estimate.

    A limit that does not exist counts as not excluding the truth. Groups that cannot carry a Weibull fit do not count
    for its parameters.
    """
    rng = np.random.default_rng(seed)
    shape, scale, end = design.shape, design.scale_s, design.end_s
    median = scale * np.log(2) ** (1 / shape)
    middle = 0.8 * min(median, end)
    truth = {
        "restricted mean": integrate.quad(lambda t: np.exp(-((t / scale) ** shape)), 0, end)[0],
        "median": median,
        "survival": np.exp(-((middle / scale) ** shape)),
        "weibull shape": shape,
        "weibull scale": scale,
    }
    held, counted = dict.fromkeys(truth, 0), dict.fromkeys(truth, 0)
    for _ in range(groups):
        life = scale * rng.weibull(shape, design.specimens)
        time, failed = np.minimum(life, end), life <= end
        curve = kaplan_meier(time, failed)
        found: dict[str, Estimate] = {"survival": curve.at(middle), "median": curve.median()}
        if curve.failed:
            found["restricted mean"] = curve.restricted_mean(end)
        lives = Lives.right_censored(time, failed)
        if lives.distinct_failures >= 2:
            parameters = fit_distribution(lives, WEIBULL, goodness=False).parameters
            found |= {"weibull shape": parameters["shape"], "weibull scale": parameters["scale_s"]}
        for name, estimate in found.items():
            counted[name] += 1
            held[name] += not estimate.lower > truth[name] and not estimate.upper < truth[name]
    return {name: held[name] / counted[name] for name in truth}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--groups", type=int, default=1000, help="groups per design")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    for design in DESIGNS:
        shares = ", ".join(
            f"{name} {100 * share:.1f} %" for name, share in coverage(design, arguments.groups, arguments.seed).items()
        )
        print(f"- {design}: {shares}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
