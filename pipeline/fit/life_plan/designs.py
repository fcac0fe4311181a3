"""Which tests make the interval of the life at use conditions narrowest, under a budget of rig hours.

Belongs here: the criterion, optimal and robust designs, the even grid that they are measured against, and the next test
given what is known. What one specimen is expected to tell is in `information`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.fit.life_plan.assumptions import LifeAssumptions, Scenario
from pipeline.fit.life_plan.information import Expected, expect, slope_at_use
from pipeline.fit.survival.profile_likelihood import critical_deviations
from schemas.arrays import Float, Int
from schemas.errors import NotIdentifiableError, UsageError

OPTIMAL, ROBUST, EVEN_GRID, NEXT_TEST = "optimal", "robust", "even grid", "next test"
EVEN_LEVELS = 4
_VOLTAGES, _DURATIONS, _SHORTEST = 25, 8, 1 / 128
"""Candidates: voltages by equal ratios, durations by equal ratios down to this share of the longest."""
_CHECK_SHARE = 0.15
"""Of the budget of a robust design for a voltage between the outer ones: two voltages cannot show that the law is
wrong.
W. Meeker and G. Hahn's compromise plans give a fifth of the specimens (ASQC How to Plan an Accelerated Life Test,
1985)."""
_STEPS, _NEAR, _HALVINGS = 150, 1e-3, 8
"""Of the multiplicative algorithm: most steps, the share of the optimum that may be missed; halvings of a price."""
_SMALLEST_SHARE = 0.02
_OPEN = 1e6
"""Limits further apart than by this factor tell nothing: there is no interval."""
_WEAK = 1e-9
"""Information that keeps a design of one test from being singular, as a share of that of all candidates."""


@dataclass(frozen=True)
class Rig:
    """What can be tested and what for.

    Parameters
    ----------
    use_kv : voltage whose life is asked for
    lowest_kv, highest_kv : between which specimens can be tested and fail as they do in use
    longest_h : longest test of one specimen in h
    setup_h : h of the rig that each specimen costs beside its test
    failed_share : share failed at the life that is asked for
    """

    use_kv: float
    lowest_kv: float
    highest_kv: float
    longest_h: float
    setup_h: float = 0.25
    failed_share: float = 0.5

    def __post_init__(self) -> None:
        wanted = (
            (self.use_kv > 0, f"use at {self.use_kv:g} kV", "a voltage above 0"),
            (
                0 < self.lowest_kv < self.highest_kv,
                f"tests from {self.lowest_kv:g} to {self.highest_kv:g} kV",
                "a lowest voltage above 0 and a higher highest one",
            ),
            (self.longest_h > 0, f"a longest test of {self.longest_h:g} h", "a time above 0"),
            (self.setup_h >= 0, f"a set-up of {self.setup_h:g} h", "a time of at least 0"),
            (0 < self.failed_share < 1, f"a failed share of {self.failed_share:g}", "a share between 0 and 1"),
        )
        for good, problem, expected in wanted:
            if not good:
                raise UsageError(problem, expected=expected)


@dataclass(frozen=True)
class LifeTest:
    """Specimens at one voltage, each taken off after `duration_h`; `failures` of them are expected, and `hours` of the
    rig.
    """

    voltage_kv: float
    duration_h: float
    specimens: int
    failures: float
    hours: float


@dataclass(frozen=True)
class LifePlan:
    """Tests, and what they are expected to give.

    `factor` is the expected ratio of the upper to the lower 95 % limit of the life at use; `worst_factor` that under
    the least favourable of the lives that may be.
    """

    name: str
    tests: tuple[LifeTest, ...]
    factor: float
    worst_factor: float

    @property
    def specimens(self) -> int:
        return sum(test.specimens for test in self.tests)

    @property
    def failures(self) -> float:
        return float(sum(test.failures for test in self.tests))

    @property
    def hours(self) -> float:
        return float(sum(test.hours for test in self.tests))

    def factor_for(self, hours: float) -> float:
        """The factor of the same tests with as many more or fewer specimens as take `hours` of the rig."""
        return float(np.exp(np.log(self.factor) * np.sqrt(self.hours / hours)))


@dataclass(frozen=True)
class Known:
    """What earlier lives tell: their Fisher information (3, 3) on (location at the reference, exponent, ln σ),
    failures.
    """

    information: Float = field(default_factory=lambda: np.zeros((3, 3)))
    failures: int = 0


class Planner:
    """Plans for one rig under given assumptions; the candidates are looked at once."""

    def __init__(self, assumed: LifeAssumptions, rig: Rig, known: Known | None = None) -> None:
        self.assumed, self.rig, self.known = assumed, rig, known or Known()
        voltages = np.geomspace(rig.lowest_kv, rig.highest_kv, _VOLTAGES)
        durations = rig.longest_h * 3600 * np.geomspace(_SHORTEST, 1.0, _DURATIONS)
        grid = np.stack(np.meshgrid(voltages, durations, indexing="ij"), axis=-1).reshape(-1, 2)
        self.voltage_kv, self.duration_s = grid[:, 0], grid[:, 1]
        self._believed = _Criterion(assumed.sure().scenarios(), self.voltage_kv, self.duration_s, rig, self.known)
        self._doubted = _Criterion(assumed.scenarios(), self.voltage_kv, self.duration_s, rig, self.known)

    def optimal(self, hours: float, most_specimens: int | None = None) -> LifePlan:
        """The narrowest interval if all assumptions are true; two voltages as a rule, so that the law is not tested."""
        number = self._believed.allot(hours, most_specimens)
        return self.describe(OPTIMAL, number)

    def robust(self, hours: float, most_specimens: int | None = None) -> LifePlan:
        """The narrowest interval on average over all lives that may be, with a voltage between that tests the law."""
        number = self._doubted.allot(hours, most_specimens)
        outer = np.unique(self.voltage_kv[number > 0])
        low, high = float(outer[0]), float(outer[-1])
        third = (high / low) ** (1 / 3)
        if not self.known.failures and not ((outer > low * third) & (outer < high / third)).any() and high > low:
            middle = np.argmin(np.abs(np.log(self.voltage_kv / np.sqrt(low * high))) - 1e-9 * np.arange(number.size))
            here = np.flatnonzero(self.voltage_kv == self.voltage_kv[middle])
            test = here[np.argmax(self._doubted.gain_per_hour(number)[here])]
            checking = np.zeros_like(number)
            checking[test] = max(1, round(_CHECK_SHARE * hours / self._doubted.cost[test]))
            if most_specimens is not None:
                checking[test] = max(1, min(int(checking[test]), round(_CHECK_SHARE * most_specimens)))
            number = self._doubted.allot(hours, most_specimens, begun=checking)
        return self.describe(ROBUST, number)

    def even_grid(self, hours: float, most_specimens: int | None = None, levels: int = EVEN_LEVELS) -> LifePlan:
        """As many specimens at each of evenly spaced voltages, all for the longest test: what is done without a plan.

        The lowest voltage is the lowest one at which half of the specimens fail within the test.
        """
        sure = self._believed.scenarios[0]
        fails = [v for v in np.unique(self.voltage_kv) if sure.life_s(float(v)) <= 3600 * self.rig.longest_h]
        low = min(fails[0] if fails else self.rig.highest_kv, self.rig.highest_kv * 0.9)
        voltage = np.linspace(low, self.rig.highest_kv, levels)
        duration = np.full(levels, 3600 * self.rig.longest_h)
        expected = expect((sure,), voltage, duration)
        each = int(hours / (expected.hours[0] + self.rig.setup_h).sum())
        each = max(1, each if most_specimens is None else min(each, most_specimens // levels))
        return self.describe_tests(EVEN_GRID, voltage, duration, np.full(levels, each))

    def next_test(self, number: int = 1, worth_h: float = 0.0) -> LifePlan:
        """The test that narrows the interval most for what it costs, given what is known.

        Parameters
        ----------
        number : specimens of it
        worth_h : rig hours that a specimen is worth, beside those that it takes; without them the shortest tests win
        """
        gain = self._doubted.gain(np.zeros(self.voltage_kv.size))
        best = int(np.argmax(gain / (self._doubted.cost + worth_h)))
        counts = np.zeros(self.voltage_kv.size, dtype=np.int64)
        counts[best] = number
        return self.describe(NEXT_TEST, counts)

    def hours_for(self, factor: float, most_hours: float = 1e7) -> float:
        """Rig hours after which the robust plan's interval has this ratio of its limits, within 2 %.

        Raises
        ------
        UsageError
            The ratio is not above 1, or not reached within `most_hours`.
        """
        if not factor > 1:
            raise UsageError(f"an interval of ratio {factor:g}", expected="a ratio of its limits above 1, such as 3")
        hours = 50 * float(self._doubted.cost.max())
        for _ in range(12):
            reached = self.robust(hours).factor
            if abs(np.log(reached) / np.log(factor) - 1) < 0.02:
                return hours
            hours *= float(np.clip((np.log(reached) / np.log(factor)) ** 2, 0.05, 20.0))
            if hours > most_hours:
                break
        if hours > most_hours:
            raise UsageError(
                f"limits of ratio {factor:g} would take more than {most_hours:g} rig hours",
                remedy="Allow longer tests or lower voltages, or a wider interval",
            )
        return hours

    def describe(self, name: str, number: Int) -> LifePlan:
        """The plan of `number` (candidates,) specimens of each candidate.

        Raises
        ------
        NotIdentifiableError
            Its lives and those that are known would give no interval.
        """
        used = np.flatnonzero(number)
        plan = self.describe_tests(name, self.voltage_kv[used], self.duration_s[used], number[used])
        if not plan.factor < _OPEN:
            raise NotIdentifiableError(
                f"{plan.hours:.3g} rig hours give no interval at {self.rig.use_kv:g} kV: "
                f"{plan.failures + self.known.failures:.2g} failures are expected",
                expected="some failures at each of two voltages",
                remedy="Raise the budget or the highest voltage",
            )
        return plan

    def describe_tests(self, name: str, voltage_kv: Float, duration_s: Float, number: Int) -> LifePlan:
        """The plan of given tests, with what is expected of it if all assumptions are true."""
        believed = _Criterion(self._believed.scenarios, voltage_kv, duration_s, self.rig, self.known)
        doubted = _Criterion(self._doubted.scenarios, voltage_kv, duration_s, self.rig, self.known)
        tests = tuple(
            LifeTest(
                float(voltage_kv[i]),
                float(duration_s[i] / 3600),
                int(number[i]),
                float(number[i] * believed.expected.failures[0, i]),
                float(number[i] * believed.cost[i]),
            )
            for i in range(number.size)
        )
        factor = float(believed.factors(number)[0])
        return LifePlan(name, tests, factor, max(factor, float(doubted.factors(number).max())))


class _Criterion:
    """Mean logarithm of the standard error of ln life at use over the scenarios, and how specimens change it.

    K. Chaloner, K. Larntz, J. Stat. Plan. Inference 21 (1989) 191: convex in the numbers of specimens.
    """

    def __init__(
        self, scenarios: Sequence[Scenario], voltage_kv: Float, duration_s: Float, rig: Rig, known: Known
    ) -> None:
        self.scenarios = tuple(scenarios)
        self.weight = np.array([one.weight for one in scenarios])
        self.expected: Expected = expect(scenarios, voltage_kv, duration_s)
        self.cost = self.weight @ self.expected.hours + rig.setup_h
        self.slope = np.stack([slope_at_use(one, rig.use_kv, rig.failed_share) for one in scenarios])
        self.known = known
        size = np.trace(self.expected.information, axis1=2, axis2=3).max(axis=1)
        count, candidates = self.expected.failures.shape
        self._flat = self.expected.information.reshape(count, candidates, 9)
        self.floor = _WEAK * size[:, None, None] * np.eye(3) + known.information

    def _solved(self, number: Float | Int) -> tuple[Float, Float]:
        """(scenarios, 3) M⁻¹ g and (scenarios,) the variance g' M⁻¹ g."""
        total = self.floor + (number @ self._flat).reshape(-1, 3, 3)
        solved = np.linalg.solve(total, self.slope[:, :, None])[:, :, 0]
        return solved, np.einsum("si,si->s", solved, self.slope)

    def value(self, number: Float | Int) -> float:
        return float(self.weight @ np.log(self._solved(number)[1]))

    def gain(self, number: Float | Int) -> Float:
        """(candidates,) fall of the mean log variance per specimen more of each candidate."""
        solved, variance = self._solved(number)
        outer = (solved[:, :, None] * solved[:, None, :]).reshape(-1, 9, 1)
        return np.asarray((self.weight / variance) @ (self._flat @ outer)[:, :, 0])

    def gain_per_hour(self, number: Float | Int) -> Float:
        return self.gain(number) / self.cost

    def factors(self, number: Float | Int) -> Float:
        """(scenarios,) expected ratio of the upper to the lower 95 % limit."""
        variance = self._solved(number)[1]
        failures = self.expected.failures @ number + self.known.failures
        with np.errstate(over="ignore"):
            return np.array(
                [
                    np.exp(2 * critical_deviations(max(3, round(float(r))), 2) * np.sqrt(v))
                    for r, v in zip(failures, variance, strict=True)
                ]
            )

    def allot(self, hours: float, most_specimens: int | None, begun: Int | None = None) -> Int:
        """(candidates,) specimens of each candidate within `hours` of the rig; `begun` are among them.

        Raises
        ------
        NotIdentifiableError
            The budget does not carry a specimen at each of two voltages.
        """
        begun = np.zeros(self.cost.size, dtype=np.int64) if begun is None else begun
        left = hours - float(begun @ self.cost)
        if left < 2 * float(self.cost.min()):
            raise NotIdentifiableError(
                f"{hours:g} rig hours do not carry a plan",
                expected=f"at least {2 * float(self.cost.min()) + hours - left:.3g} h",
                remedy="Raise the budget, or shorten the longest test",
            )
        spare = None if most_specimens is None else most_specimens - int(begun.sum())
        ideal = self._weigh(left, spare, begun)
        return begun + self._round(ideal, left, spare, begun)

    def _weigh(self, hours: float, most_specimens: int | None, begun: Int) -> Float:
        """(candidates,) real numbers of specimens: the optimum, by the multiplicative algorithm, merged to few
        tests.
        """
        price = self.cost / hours
        ideal = self._optimise(price, begun, None)
        if most_specimens is not None and ideal.sum() > most_specimens:
            low, high = 0.0, 1.0  # share of the price that is for a place among the specimens
            for _ in range(_HALVINGS):
                share = (low + high) / 2
                mixed = (1 - share) * price + share / most_specimens
                ideal = self._optimise(mixed, begun, ideal)
                low, high = (share, high) if ideal.sum() > most_specimens else (low, share)
            price = (1 - high) * price + high / most_specimens
        merged = self._optimise(price, begun, self._merge(ideal, price))
        used = max(float(merged @ self.cost) / hours, merged.sum() / (most_specimens or np.inf))
        return np.asarray(merged / max(used, 1.0))

    def _optimise(self, price: Float, begun: Int, start: Float | None) -> Float:
        """The optimum under Σ price · number = 1. Shares of the price grow by the root of what they gain."""
        share = np.full(price.size, 1.0 / price.size) if start is None else start * price / float(start @ price)
        for _ in range(_STEPS):
            gain = self.gain(share / price + begun) / price
            if gain[share > 0].max() < (1 + _NEAR) * float(share @ gain):
                break
            share = share * np.sqrt(gain)
            share /= share.sum()
        return np.asarray(share / price)

    def _merge(self, number: Float, price: Float) -> Float:
        """Neighbouring voltages and durations put together to the strongest of them; what is left of small ones
        goes.
        """
        share = number * price
        merged = np.zeros_like(share)
        table = share.reshape(_VOLTAGES, _DURATIONS)
        left = table.copy()
        while left.max() > _SMALLEST_SHARE / 2:
            i, j = np.unravel_index(int(np.argmax(left)), left.shape)
            around = slice(max(0, i - 2), i + 3)
            merged[i * _DURATIONS + j] += left[around].sum()
            left[around] = 0.0
        return np.asarray(np.where(merged > _SMALLEST_SHARE, merged, 0.0) / price)

    def _round(self, ideal: Float, hours: float, most_specimens: int | None, begun: Int) -> Int:
        """Whole numbers: the optimum rounded down, then one by one where it helps most per hour, then single
        exchanges.
        """
        support = np.flatnonzero(ideal > 0)
        number = np.zeros(ideal.size, dtype=np.int64)
        number[support] = np.floor(ideal[support]).astype(np.int64)
        if most_specimens is not None:
            while number.sum() > most_specimens:
                number[np.argmax(number)] -= 1

        def fill(given: Int) -> Int:
            filled = given.copy()
            while True:
                open_ = support[(filled @ self.cost) + self.cost[support] <= hours + 1e-9]
                if not open_.size or (most_specimens is not None and filled.sum() >= most_specimens):
                    return filled
                filled[open_[np.argmax(self.gain_per_hour(filled + begun)[open_])]] += 1

        number = fill(number)
        for _ in range(20):
            others = [fill(number - (np.arange(number.size) == i)) for i in support if number[i] > 0]
            best = min(others, key=lambda one: self.value(one + begun), default=number)
            if self.value(best + begun) >= self.value(number + begun) - 1e-9:
                break
            number = best
        return number


def plan_all(planner: Planner, hours: float, most_specimens: int | None = None) -> tuple[LifePlan, ...]:
    """The robust and the optimal plan, and the even grid, for the same hours."""
    return (
        planner.robust(hours, most_specimens),
        planner.optimal(hours, most_specimens),
        planner.even_grid(hours, most_specimens),
    )
