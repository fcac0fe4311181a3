"""How many specimens tell two designs apart, whose lives differ by a factor, by the log-rank test at one voltage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from pipeline.fit.life_plan.assumptions import Scenario
from pipeline.fit.life_plan.stopping import Stopping, plan_stopping
from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError, UsageError

_DRAWS, _MOST_DRAWN, _SEED = 4000, 240_000, 20_260_301
_MOST_EACH = 20_000
LEVEL = 0.05
"""False alarms of the comparison, two-sided."""


@dataclass(frozen=True)
class Comparison:
    """Specimens of each of two designs.

    `power` is that of simulated campaigns of `specimens_each`, `false_alarm` the share of them in which equal designs
    are told apart. `failures` are expected of both designs together, by the end of the test, `hours` of the rig.
    `stopping` holds the looks, where there is more than one.
    """

    ratio: float
    voltage_kv: float
    duration_h: float
    specimens_each: int
    failures: float
    hours: float
    power: float
    false_alarm: float
    stopping: Stopping | None = None


def size_comparison(
    scenario: Scenario,
    ratio: float,
    voltage_kv: float,
    duration_h: float,
    *,
    power: float = 0.8,
    setup_h: float = 0.0,
    looks: int = 1,
) -> Comparison:
    """Fewest specimens of each design that tell lives of b from those of a, `ratio` times as long, with the given
    power.

    Parameters
    ----------
    scenario : lives of design a
    ratio : life of b over that of a
    voltage_kv, duration_h : of the test
    power : probability to find the difference
    setup_h : h of the rig per specimen beside its test
    looks : at equal shares of the failures, each of which may end the test

    Raises
    ------
    NotIdentifiableError
        Nobody is expected to fail within the test, or no number of specimens is enough.
    UsageError
        The ratio is 1 or not above 0, the test takes no time, or the power is none.

    Notes
    -----
    The first guess is D. Schoenfeld's number of failures, 4 (z + z')²/(ln hazard ratio)² (Biometrika 68 (1981) 316);
    the number is then that whose simulated campaigns have the power, as the formula is short for few failures.
    """
    if not (ratio > 0 and abs(np.log(ratio)) > 1e-3):
        raise UsageError(f"lives that differ by a factor of {ratio:g}", expected="a factor above 0, not 1, such as 2")
    if not duration_h > 0:
        raise UsageError(f"a test of {duration_h:g} h", expected="a time above 0")
    stopping = plan_stopping([(i + 1) / looks for i in range(looks)], LEVEL, power)
    more = np.log(ratio) / scenario.sigma
    needed = 4 * (special.ndtri(1 - LEVEL / 2) + special.ndtri(power)) ** 2 / more**2
    end = float(np.log(duration_h * 3600) - scenario.location(np.array(voltage_kv)))
    failing = [
        float(1 - scenario.error.survival(np.array((end - shift) / scenario.sigma))) for shift in (0.0, np.log(ratio))
    ]
    if sum(failing) < 1e-3:
        raise NotIdentifiableError(
            f"nearly nobody fails within {duration_h:g} h at {voltage_kv:g} kV: no test",
            expected="a longer test, or a higher voltage",
        )
    one_look = _find_number(scenario, ratio, end, max(2, int(needed / sum(failing))), power)
    each = int(np.ceil(one_look * stopping.inflation - 1e-9))
    lives = _draw(scenario, each, np.log(ratio))
    relative = float(np.exp(np.minimum(lives, end)).mean())
    hours = relative * float(np.exp(scenario.location(np.array(voltage_kv)))) / 3600
    return Comparison(
        ratio,
        voltage_kv,
        duration_h,
        each,
        each * sum(failing),
        2 * each * (hours + setup_h),
        simulate_power(scenario, each, ratio, end),
        simulate_power(scenario, each, 1.0, end),
        stopping if looks > 1 else None,
    )


def _find_number(scenario: Scenario, ratio: float, end: float, guess: int, power: float) -> int:
    """The smallest number whose simulated power is enough, by doubling and halving from a guess."""
    low, high = 1, guess
    while simulate_power(scenario, high, ratio, end) < power:
        low, high = high, 2 * high
        if high > _MOST_EACH:
            raise NotIdentifiableError(
                f"more than {_MOST_EACH} specimens of each design",
                expected="a larger difference of the lives, or a longer test",
            )
    while high - low > max(1, high // 200):
        middle = (low + high) // 2
        if simulate_power(scenario, middle, ratio, end) < power:
            low = middle
        else:
            high = middle
    return high


def simulate_power(scenario: Scenario, each: int, ratio: float, end: float) -> float:
    """Share of simulated campaigns in which the log-rank test finds a difference at 5 %.

    Parameters
    ----------
    scenario : lives of design a
    each : specimens of each design
    ratio : life of b over that of a
    end : of the test, as ln t less the location of a
    """
    lives = _draw(scenario, each, np.log(ratio))
    z = log_rank(np.minimum(lives, end), lives <= end, np.arange(2 * each) < each)
    return float((np.abs(z) > -special.ndtri(LEVEL / 2)).mean())


def _draw(scenario: Scenario, each: int, longer: float) -> Float:
    """(draws, 2 each) ln lives less the location of a, design a first. Fewer draws of many specimens."""
    rng = np.random.default_rng(_SEED)
    draws = int(np.clip(_MOST_DRAWN // (2 * each), 500, _DRAWS))
    w = scenario.error.quantile_of_survival(rng.uniform(size=(draws, 2 * each)))
    return np.asarray(scenario.sigma * w + np.where(np.arange(2 * each) < each, 0.0, longer))


def log_rank(time: Float, failed: Bool, first: Bool) -> Float:
    """(draws,) standardised log-rank statistic of the first group, for many data sets at once; ties have probability 0.

    Parameters
    ----------
    time, failed : (draws, n)
    first : (n,) members of the first group
    """
    n = time.shape[1]
    order = np.argsort(time, axis=1, kind="stable")
    member = first[order]
    dead = np.take_along_axis(failed, order, axis=1)
    at_risk = n - np.arange(n)
    own = member[:, ::-1].cumsum(axis=1)[:, ::-1]
    share = own / at_risk
    excess = (dead * (member - share)).sum(axis=1)
    variance = (dead * share * (1 - share)).sum(axis=1)
    return np.asarray(np.divide(excess, np.sqrt(variance), out=np.zeros_like(excess), where=variance > 0))
