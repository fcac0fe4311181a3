"""Weights of `pipeline.transform.breakdown_model` from records whose truth is known; prints the table's numbers.

    python -m tests.studies.fit_breakdown [--records N] [--seed N]

Multinomial logistic regression with a normal prior of standard deviation `WEIGHT_SD` on every weight: evidence that goes together
shares its weight, and what was rarely seen stays near nothing. Causes are weighted by how often they end a test
(`PRIOR`), families within a cause alike but for `RARE`.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.optimize import minimize

from pipeline.transform.breakdown import observe_falls
from pipeline.transform.breakdown_model import CAUSES
from schemas.errors import NotIdentifiableError
from tests.studies import breakdown_records
from tests.studies.study_breakdown import recording_of

PRIOR = {"failed": 0.46, "switched off": 0.35, "supply": 0.17, "monitor": 0.02}
RARE = {"restarted": 0.5, "monitor_lost": 0.3, "monitor_glitch": 0.5}
"""Endings that are much rarer in laboratories than the others of the same cause."""
WEIGHT_SD = 3.0
PLAN_SD = 6.0
"""That a film breaks just when its time is over is a coincidence of one second in a whole test."""
_LABELS = {"failed": "failed", "off": "switched off", "supply": "supply", "monitor": "monitor"}


def labelled_falls(records: int, seed: int) -> Iterator[tuple[str, str, Mapping[str, str]]]:
    """(family, true cause, evidence) of every fall that lasts and whose cause is known."""
    for family in breakdown_records.FAMILIES:
        for number in range(records):
            drawn = breakdown_records.draw(seed + number, family)
            try:
                observed = list(observe_falls(recording_of(drawn)))
            except NotIdentifiableError:
                continue
            slack = 3 * float(np.median(np.diff(drawn.time_s)))
            for instant, found in observed:
                at = instant + drawn.time_s[0]
                near = [
                    (abs(t - at), kind) for t, kind in drawn.truth["events"] if at - slack - 0.6 < t < at + slack + 1
                ]
                if near and min(near)[1] in _LABELS:
                    yield family, _LABELS[min(near)[1]], found


def fit_weights(
    falls: list[tuple[str, str, Mapping[str, str]]],
) -> dict[tuple[str, str], np.ndarray]:
    """Log odds of `CAUSES` for each (evidence, outcome), and for `("prior", "")`."""
    keys = sorted({item for _, _, found in falls for item in found.items()})
    seen = np.array([[item in found.items() for item in keys] + [True] for _, _, found in falls], dtype=float)
    true = np.array([CAUSES.index(cause) for _, cause, _ in falls])
    weight = np.array([RARE.get(family, 1.0) for family, _, _ in falls])
    total = np.bincount(true, weights=weight, minlength=len(CAUSES))
    weight = weight * (np.array([PRIOR[cause] for cause in CAUSES]) / total)[true]
    weight *= weight.size / weight.sum()
    stiffness = np.full((len(keys) + 1, 1), WEIGHT_SD**-2)
    stiffness[[key[0] == "planned end" for key in [*keys, ("prior", "")]]] = PLAN_SD**-2
    stiffness[-1] = 0.01
    wanted = np.eye(len(CAUSES))[true]

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        odds = flat.reshape(-1, len(CAUSES))
        z = seen @ odds
        z -= z.max(axis=1, keepdims=True)
        share = np.exp(z) / np.exp(z).sum(axis=1, keepdims=True)
        value = -float(weight @ np.log(share[np.arange(true.size), true] + 1e-300))
        gradient = seen.T @ ((share - wanted) * weight[:, None]) + stiffness * odds
        return value + 0.5 * float(np.sum(stiffness * odds**2)), gradient.ravel()

    found = minimize(
        loss, np.zeros(seen.shape[1] * len(CAUSES)), jac=True, method="L-BFGS-B", options={"maxiter": 5000}
    )
    odds = found.x.reshape(-1, len(CAUSES))
    odds -= odds.mean(axis=1, keepdims=True)
    return dict(zip([*keys, ("prior", "")], odds, strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--records", type=int, default=400, help="records per family")
    parser.add_argument("--seed", type=int, default=1_000_000)
    arguments = parser.parse_args()
    falls = list(labelled_falls(arguments.records, arguments.seed))
    counts = Counter((item, cause) for _, cause, found in falls for item in found.items())
    for key, odds in fit_weights(falls).items():
        numbers = ", ".join(f"{value + 0.0:.1f}" for value in np.round(odds, 1) + 0.0)
        print(f"{key!r}: ({numbers}),  # {[counts[key, cause] for cause in CAUSES]}")
    print(f"{len(falls)} falls")


if __name__ == "__main__":
    main()
