"""Samples of lives of every censoring, drawn alike for the pipeline and for the libraries that it is compared with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from schemas.arrays import Bool, Float

KINDS = ("right-censored", "left-censored", "inspected", "late")
"""The last ones came under watch late: those that had failed before are not in the sample."""
SCALE = 100.0
Limits = tuple[Float, Float, Float | None]


def draw_samples(
    kind: str, *, samples: int = 1000, lives: int = 40, family: str = "weibull", seed: int = 7
) -> Iterator[Limits]:
    """Lower limits, upper limits and ages of entry of as many samples of lives, Weibull of shape 1.7 or log-normal of 0.6."""
    rng = np.random.default_rng(seed)

    def draw(size: int) -> Float:
        return SCALE * (rng.weibull(1.7, size) if family == "weibull" else np.exp(0.6 * rng.normal(size=size)))

    for _ in range(samples):
        if kind == "late":
            life, entered = draw(4 * lives), rng.uniform(0, 0.8 * SCALE, 4 * lives)
            seen = np.flatnonzero(life > entered)[:lives]
            life, entered = life[seen], entered[seen]
            end = entered + rng.uniform(0.3, 2.5, seen.size) * SCALE
            yield np.minimum(life, end), np.where(life <= end, life, np.inf), entered
            continue
        life = draw(lives)
        if kind == "right-censored":
            end = rng.uniform(0.3, 2.5, lives) * SCALE
            yield np.minimum(life, end), np.where(life <= end, life, np.inf), None
        elif kind == "left-censored":
            first = rng.uniform(0.05, 0.6, lives) * SCALE
            yield np.where(life < first, 0.0, life), np.maximum(life, first), None
        else:
            before = np.floor(life / (0.2 * SCALE)) * 0.2 * SCALE
            yield before, before + 0.2 * SCALE, None


def draw_regression(number: int) -> tuple[Float, Float, Bool]:
    """ln of the voltage, life and failed, of lives at three voltages that end at one time."""
    rng = np.random.default_rng(8)
    voltage = rng.choice([4.0, 5.0, 6.0], number)
    life, end = np.exp(16 - 6 * np.log(voltage)) * rng.weibull(1.7, number), 2000.0
    return np.log(voltage), np.minimum(life, end), life <= end
