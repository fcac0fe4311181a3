"""Lives typed from published tables, each with its source: (lower, upper) limits, and what they were tested under."""

from __future__ import annotations

import numpy as np

from schemas.arrays import Float


def _limits(text: str) -> tuple[Float, Float]:
    """Lower and upper limits of lives written as `7` (exact), `7+` (right-censored), `3-7` (between) or `0-7` (left)."""
    lower, upper = [], []
    for word in text.split():
        low, _, high = word.rstrip("+").partition("-")
        lower.append(float(low))
        upper.append(np.inf if word.endswith("+") else float(high or low))
    return np.array(lower), np.array(upper)


BREAST_COSMESIS = _limits(
    "45+ 6-10 0-7 46+ 46+ 7-16 17+ 7-14 37-44 0-8 4-11 15+ 11-15 22+ 46+ 46+ 25-37 46+ 26-40 46+ 27-34 36-44 46+ 36-48 "
    "37+ 40+ 17-25 46+ 11-18 38+ 5-12 37+ 0-5 18+ 24+ 36+ 5-11 19-35 17-25 24+ 32+ 33+ 19-26 37+ 34+ 36+"
)
"""Months to deterioration, radiotherapy alone: D. Finkelstein, R. Wolfe, Biometrics 41 (1985) 933."""

_WHEELS = {4: (0, 39), 10: (4, 49), 14: (2, 31), 18: (7, 66), 22: (5, 25), 26: (9, 30), 30: (9, 33), 34: (6, 7)}
_WHEELS |= {38: (22, 12), 42: (21, 19), 46: (21, 15)}
TURBINE_WHEELS = _limits(
    " ".join(" ".join([f"0-{age}"] * cracked + [f"{age}+"] * sound) for age, (cracked, sound) in _WHEELS.items())
)
"""Hundreds of hours to a crack, each wheel inspected once: W. Nelson, Applied Life Data Analysis (1982), p. 409."""
