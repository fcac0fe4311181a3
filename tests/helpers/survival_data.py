"""Published lifetimes used by several tests: remission of leukaemia under 6-MP and placebo (Freireich 1963), weeks."""

from __future__ import annotations

import numpy as np

TREATED = (
    np.array([6, 6, 6, 6, 7, 9, 10, 10, 11, 13, 16, 17, 19, 20, 22, 23, 25, 32, 32, 34, 35], dtype=float),
    np.array([1, 1, 1, 0, 1, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0], dtype=bool),
)
PLACEBO = (
    np.array([1, 1, 2, 2, 3, 4, 4, 5, 5, 8, 8, 8, 8, 11, 11, 12, 12, 15, 17, 22, 23], dtype=float),
    np.ones(21, dtype=bool),
)


def random_sample(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A censored sample of 2 to 80 specimens, ties included in about half of them."""
    n = int(rng.integers(2, 80))
    time = rng.weibull(rng.uniform(0.6, 4), n) * 10
    if rng.random() < 0.5:
        time = np.ceil(time)
    return time, rng.random(n) < rng.uniform(0.2, 1.0)
