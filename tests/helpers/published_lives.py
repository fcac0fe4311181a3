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


def _by_stress(tested: dict[float, str]) -> tuple[Float, tuple[Float, Float]]:
    """(n,) stress and limits of all lives; `90x5000+` stands for ninety survivors of 5000."""
    words = {
        stress: " ".join(
            " ".join([word.partition("x")[2]] * int(word.partition("x")[0])) if "x" in word else word
            for word in text.split()
        )
        for stress, text in tested.items()
    }
    stress = np.concatenate([np.full(len(text.split()), float(s)) for s, text in words.items()])
    return stress, _limits(" ".join(words.values()))


INSULATING_FLUID = _by_stress(
    {
        26: "5.79 1579.52 2323.7",
        28: "68.85 108.29 110.29 426.07 1067.6",
        30: "7.74 17.05 20.46 21.02 22.66 43.4 47.3 139.07 144.12 175.88 194.9",
        32: ".27 .4 .69 .79 2.75 3.91 9.88 13.95 15.93 27.8 53.24 82.85 89.29 100.58 215.1",
        34: ".19 .78 .96 1.31 2.78 3.16 4.15 4.67 4.85 6.5 7.35 8.01 8.27 12.06 31.75 32.52 33.91 36.71 72.89",
        36: ".35 .59 .96 .99 1.69 1.97 2.07 2.58 2.71 2.9 3.67 3.99 5.35 13.77 25.5",
        38: ".09 .39 .47 .73 .74 1.13 1.4 2.38",
    }
)
"""Minutes to breakdown between electrodes at kV: W. Nelson, Applied Life Data Analysis (1982), table 3.1."""

DEVICE_A = _by_stress(
    {
        10: "30x5000+",
        40: "1298 1390 3187 3241 3261 3313 4501 4568 4841 4982 90x5000+",
        60: "581 925 1432 1586 2452 2734 2772 4106 4674 11x5000+",
        80: "283 361 515 638 854 1024 1030 1045 1767 1777 1856 1951 1964 2884 1x5000+",
    }
)
"""Hours of a device at °C: W. Meeker, L. Escobar, Statistical Methods for Reliability Data (1998), table C.10."""

MYLAR = _by_stress(
    {
        100.3: "606 1012 2520 2610 3988 4100 5025 6842",
        122.4: "188 297 405 744 1218 1340 1715 3382",
        157.1: "49 99 154.5 180 291 447 510 600 1656 1721",
        219.0: "15 16 36 50 55 95 122 129 625 700",
    }
)
"""Minutes of Mylar–polyurethane insulation at kV/mm, without the highest field: C. Kalkanis, E. Rosso (1989), as in Meeker
and Escobar (1998), table 19.1."""

BALL_BEARINGS = _limits(
    "17.88 28.92 33.00 41.52 42.12 45.60 48.48 51.84 51.96 54.12 55.56 67.80 68.64 68.64 68.88 84.12 93.12 98.64 105.12 "
    "105.84 127.92 128.04 173.40"
)
"""Millions of revolutions: J. Lieblein, M. Zelen, J. Res. Nat. Bur. Stand. 57 (1956) 273."""

SHOCK_ABSORBERS = _limits(
    "6700 6950+ 7820+ 8790+ 9120 9660+ 9820+ 11310+ 11690+ 11850+ 11880+ 12140+ 12200 12870+ 13150 13330+ 13470+ 14040+ "
    "14300 17520 17540+ 17890+ 18420+ 18960+ 18980+ 19410+ 20100 20100+ 20150+ 20320+ 20900 22700 23490+ 26510 27410+ "
    "27490 27890+ 28100+"
)
"""Kilometres: P. O'Connor, Practical Reliability Engineering (1985), p. 85."""

OVARIAN = np.array(
    [
        [59, 1, 72.3315, 1, 1], [115, 1, 74.4932, 1, 1], [156, 1, 66.4658, 1, 2], [421, 0, 53.3644, 2, 1],
        [431, 1, 50.3397, 1, 1], [448, 0, 56.4301, 1, 2], [464, 1, 56.937, 2, 2], [475, 1, 59.8548, 2, 2],
        [477, 0, 64.1753, 1, 1], [563, 1, 55.1781, 2, 2], [638, 1, 56.7562, 1, 2], [744, 0, 50.1096, 2, 1],
        [769, 0, 59.6301, 2, 2], [770, 0, 57.0521, 2, 1], [803, 0, 39.2712, 1, 1], [855, 0, 43.1233, 1, 2],
        [1040, 0, 38.8932, 1, 2], [1106, 0, 44.6, 1, 1], [1129, 0, 53.9068, 2, 1], [1206, 0, 44.2055, 2, 1],
        [1227, 0, 59.589, 2, 2], [268, 1, 74.5041, 1, 2], [329, 1, 43.137, 1, 1], [353, 1, 63.2192, 2, 2],
        [365, 1, 64.4247, 2, 1], [377, 0, 58.3096, 2, 1],
    ]
)  # fmt: skip
"""Days, died, age, treatment, performance status: J. Edmonson and others, Cancer Treat. Rep. 63 (1979) 241, as R's survival
package has them."""

CAPACITORS = {
    (170, 200): "439 904 1092 1105 4x1105+",
    (170, 250): "572 690 904 1090 4x1090+",
    (170, 300): "315 315 439 628 4x628+",
    (170, 350): "258 258 347 588 4x588+",
    (180, 200): "959 1065 1065 1087 4x1087+",
    (180, 250): "216 315 455 473 4x473+",
    (180, 300): "241 315 332 380 4x380+",
    (180, 350): "241 241 435 455 4x455+",
}
"""Hours of glass capacitors at (°C, V): M. Zelen, Technometrics 1 (1959) 269, as R's survival package has them."""

MOTORETTES = _by_stress(
    {
        170: "1764 2772 3444 3542 3780 4860 5196 3x5448+",
        190: "408 408 1344 1344 1440 5x1680+",
        220: "408 408 504 504 504 5x528+",
    }
)
"""Hours of motor insulation at °C, without the lowest temperature: W. Nelson, G. Hahn, Technometrics 14 (1972) 247, as R's
survival package has them."""

THERNEAU_SIX = (np.array([9.0, 1, 1, 6, 6, 8]), np.array([1, 1, 0, 1, 1, 0]) > 0, np.array([0.0, 1, 1, 1, 0, 0]))
"""Time, failed, x: T. Therneau, P. Grambsch, Modeling Survival Data (2000), appendix E."""

TURNBULL_DRIVERS = {1: (12, 3, 2), 2: (6, 2, 4), 3: (2, 0, 2), 4: (3, 3, 5)}
"""Failed, right-censored, left-censored at each time: B. Turnbull, J. Am. Stat. Assoc. 69 (1974) 169."""

LEUKAEMIA_AML = (
    _limits("9 13 13+ 18 23 28+ 31 34 45+ 48 161+"),
    _limits("5 5 8 8 12 16+ 23 27 30 33 43 45"),
)
"""Weeks of remission with and without chemotherapy: R. Miller, Survival Analysis (1981), p. 49."""

DYESTUFF = np.array(
    [
        [1545, 1440, 1440, 1520, 1580], [1540, 1555, 1490, 1560, 1495], [1595, 1550, 1605, 1510, 1560],
        [1445, 1440, 1595, 1465, 1545], [1595, 1630, 1515, 1635, 1625], [1520, 1455, 1450, 1480, 1445],
    ]
)  # fmt: skip
"""Grams of six batches: O. Davies, P. Goldsmith, Statistical Methods in Research and Production (1972), table 6.1."""


def capacitors() -> tuple[Float, Float, tuple[Float, Float]]:
    """(n,) temperature in °C, (n,) V, and limits of all lives."""
    parts = [(*key, *_by_stress({0: text})[1]) for key, text in CAPACITORS.items()]
    sizes = [lower.size for *_, lower, _ in parts]
    celsius, volts = (np.repeat([float(part[i]) for part in parts], sizes) for i in (0, 1))
    return celsius, volts, (np.concatenate([p[2] for p in parts]), np.concatenate([p[3] for p in parts]))
