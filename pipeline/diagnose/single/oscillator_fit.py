"""Least squares of oscillators: many fits that differ in what is free and in what they are fitted to go side by side in
one run.

Does not belong here: which fits are asked for, and what follows from them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from pipeline.diagnose.single.oscillator import (
    ARM,
    CEILING,
    CUBIC,
    DAMPING,
    DELAY,
    DRAG,
    FURTHER,
    GAIN,
    HOLDS,
    PARAMETERS,
    QUADRATIC,
    RATE,
    SLIP,
    STIFFNESS,
    Mode,
    Oscillator,
    SystemRecord,
    respond_of_hold,
)
from pipeline.physics.least_squares import Options, minimise_each
from schemas.arrays import Bool, Complex, Float, Int

_BOUNDS = {
    STIFFNESS: (0.05, 20.0),
    DAMPING: (1e-5, 50.0),
    GAIN: (-np.inf, np.inf),
    QUADRATIC: (-5.0, 5.0),
    CUBIC: (-0.9, 100.0),
    DRAG: (-2.0, 20.0),
    ARM: (0.0, 20.0),
    RATE: (-6.0, 5.0),
    SLIP: (-4.0, 7.0),
    CEILING: (0.0, 100.0),
    DELAY: (-6.0, 6.0),
    **{
        row: bounds
        for rows in FURTHER
        for row, bounds in zip(rows, ((1e-4, 1e4), (1e-5, 500.0), (-np.inf, np.inf)), strict=True)
    },
}
"""Least and largest value of each parameter, in the units of `oscillator`."""
LOWER, UPPER = np.array([_BOUNDS[i] for i in range(PARAMETERS)]).T
DIFFERENCE = 1e-5
"""Step of derivatives."""
_OPTIONS = Options(fall=0.0, share=1e-5, most=20, longest=np.inf)
"""Residuals are in units of what was measured, whose noise nobody knows: ends are told by shares. A gain may have any
unit and size."""
_LINES = 3000
"""Strongest spectral lines by which a linear start is found."""
_FREQUENCIES, _RATIOS = 160, np.geomspace(3e-3, 3.0, 9)
"""Frequencies and damping ratios of the grid of linear starts."""
_TRIED, _TINY = 3, 1e-300
"""Points of the grid that are tried as they stand, and instead of nothing."""
_LEAST_RATIO, _LARGEST_RATIO = 1e-4, 3.0
"""Damping ratios that a linear start may have. Beyond 3 an oscillator is a low pass of first order, whose second pole is
a hundred times the first and more: records do not tell how much, and steps that the first one needs do not follow it."""


@dataclass(frozen=True)
class Problem:
    """A fit that is asked for: start (PARAMETERS,), rows that are free, and (M,) values that are fitted."""

    start: Float
    free: tuple[int, ...]
    fitted: Bool

    def at(self, entries: Float) -> Float:
        """(PARAMETERS,) with what is free at its entries (P,)."""
        theta = self.start.copy()
        theta[list(self.free)] = entries[: len(self.free)]
        return theta


@dataclass(frozen=True)
class Fit:
    """Its result.

    parameters : (PARAMETERS,)
    simulated, jacobian : (M,) values and (M, P) their derivatives with respect to what is free
    cost : sum of squares of what is fitted
    records : per record (n,) values, also where nothing is compared
    """

    problem: Problem
    parameters: Float
    simulated: Float
    jacobian: Float
    cost: float
    records: tuple[Float, ...]


def clip_parameters(parameters: Float) -> Float:
    """(…, PARAMETERS) within what a fit may reach; rates that are none stay so."""
    none = np.isneginf(parameters)
    return np.where(none, parameters, np.clip(parameters, LOWER, UPPER))


def join_compared(oscillator: Oscillator, of_records: Sequence[Float]) -> Float:
    """(…, M) values that are compared, of all records one after the other; from (…, n) of each."""
    parts = [v[..., oscillator.compared(r)] for r, v in zip(oscillator.records, of_records, strict=True)]
    return np.concatenate(parts, axis=-1)


def fit_all(oscillator: Oscillator, measured: Float, problems: Sequence[Problem]) -> list[Fit]:
    """All fits within bounds, side by side. measured : (M,)"""
    size = float(np.sqrt(np.mean(measured**2))) or 1.0
    starts = np.zeros((len(problems), max(len(p.free) for p in problems)))
    low, high = starts.copy(), starts.copy()
    for number, problem in enumerate(problems):
        rows, own = list(problem.free), slice(len(problem.free))
        starts[number, own], low[number, own], high[number, own] = problem.start[rows], LOWER[rows], UPPER[rows]

    best: dict[int, Fit] = {}

    def evaluate(points: Float, numbers: Int) -> tuple[Float, Float]:
        """Residuals (K, M) over the size of what was measured, 0 where nothing is fitted, and Jacobians (K, M, P)."""
        asked = [problems[i] for i in numbers]
        found = _simulate(oscillator, asked, points)
        residual, jacobian = (
            np.zeros((len(points), measured.size)),
            np.zeros((len(points), measured.size, points.shape[1])),
        )
        for i, (number, problem, one) in enumerate(zip(numbers.tolist(), asked, found, strict=True)):
            fitted = problem.fitted
            residual[i, fitted] = (one.simulated - measured)[fitted] / size
            jacobian[i, fitted, : len(problem.free)] = one.jacobian[fitted] / size
            with np.errstate(over="ignore", invalid="ignore"):
                cost, slope = float(np.sum(residual[i] ** 2)), float(np.sum(jacobian[i] ** 2))
            if not np.isfinite(cost + slope):
                residual[i], cost = np.inf, np.inf
            if number not in best or cost < best[number].cost:
                best[number] = replace(one, cost=cost)
        return residual, jacobian

    # A search ends at the best of the points that it has asked for.
    minimise_each(evaluate, list(starts), low, high, _OPTIONS)
    return [replace(best[number], cost=best[number].cost * size**2) for number in range(len(problems))]


def _simulate(oscillator: Oscillator, problems: Sequence[Problem], entries: Float) -> list[Fit]:
    """Values and derivatives of problems at what is free (K, P), by one run."""
    points = [problem.at(x) for problem, x in zip(problems, entries, strict=True)]
    columns: list[Float] = []
    for problem, theta in zip(problems, points, strict=True):
        columns += [theta, *(theta + DIFFERENCE * (np.arange(PARAMETERS) == row) for row in problem.free)]
    by_record = oscillator(np.array(columns).T)
    everything = join_compared(oscillator, by_record)
    found, first = [], 0
    for problem, theta in zip(problems, points, strict=True):
        own = slice(first, first + 1 + len(problem.free))
        with np.errstate(over="ignore", invalid="ignore"):
            jacobian = (everything[own][1:] - everything[own][0]).T / DIFFERENCE
        records = tuple(values[first] for values in by_record)
        found.append(Fit(problem, theta, everything[own][0], jacobian, np.inf, records))
        first = own.stop
    return found


class LinearStarts:
    """Linear starts of the same records, of which none is searched twice."""

    def __init__(self, records: Sequence[SystemRecord]) -> None:
        self._searches = {hold: _search_resonances(records, hold) for hold in HOLDS}
        self._found: dict[str, list[tuple[Mode, ...]]] = {hold: [] for hold in HOLDS}

    def find(self, modes: int, hold: str) -> tuple[Mode, ...]:
        """So many resonances side by side, the one of most output first, for what the input does between samples."""
        found = self._found[hold]
        while len(found) < modes:
            found.append(next(self._searches[hold]))
        return found[modes - 1]


def _search_resonances(records: Sequence[SystemRecord], hold: str) -> Iterator[tuple[Mode, ...]]:
    """One, two and more resonances y″ + 2ζω y′ + ω² y = g u side by side, from spectra under a window of Hann, the one of most output first.

    The response error |Y − Σ g U/D|², with the best g: one resonance after the other on a grid of ω and ζ beside those
    that are there, and all on from the least. Beyond half the lowest and twice the highest frequency of the records every
    ω does the same to them: a spike, which excites all frequencies alike, or a system without a resonance would send it to
    nothing or without end.
    """
    w, u, y = (np.concatenate(part) for part in zip(*(_compute_spectra(r, hold) for r in records), strict=True))
    strongest = np.argsort(np.abs(y))[-_LINES:]
    w, u, y = w[strongest], u[strongest], y[strongest]
    target = np.concatenate([y.real, y.imag])

    def respond(x: Float) -> Float:
        """(2 n, modes) output of each resonance of gain 1; x : ln ω and ln ζ of each."""
        omega, ratio = np.exp(x[::2]), np.exp(x[1::2])
        of_one = u[:, None] / (omega**2 - w[:, None] ** 2 + 2j * ratio * omega * w[:, None])
        return np.concatenate([of_one.real, of_one.imag])

    def fit_gains(x: Float) -> tuple[Float, Float, float]:
        columns = respond(x)
        scale = np.linalg.norm(columns, axis=0)
        gains = np.linalg.lstsq(columns / scale, target, rcond=1e-12)[0] / scale
        return columns, gains, float(np.sum((target - columns @ gains) ** 2))

    lowest, highest = float(w.min()) / 2, float(w.max()) * 2
    limits = np.log([(lowest, highest), (_LEAST_RATIO, _LARGEST_RATIO)])
    grid = np.log([(o, r) for o in np.geomspace(lowest, highest, _FREQUENCIES) for r in _RATIOS])
    found = np.zeros(0)
    while True:
        x = min(
            (np.concatenate([found, one]) for one in _shortlist(grid, found, respond, target)),
            key=lambda x: fit_gains(x)[2],
        )
        simplex = np.vstack([x, x + np.diag(np.tile([0.05, 0.5], x.size // 2))])
        found = minimize(
            lambda x: fit_gains(x)[2],
            x,
            method="Nelder-Mead",
            bounds=np.tile(limits, (x.size // 2, 1)),
            options={"initial_simplex": simplex, "maxfev": 200 * x.size},
        ).x
        columns, gains, _ = fit_gains(found)
        output = np.linalg.norm(columns * gains, axis=0)
        yield tuple(
            Mode(float(np.exp(found[2 * i])), float(np.exp(found[2 * i + 1])), float(gains[i]))
            for i in np.argsort(-output)
        )


def _shortlist(grid: Float, found: Float, respond: Callable[[Float], Float], target: Float) -> Float:
    """(S, 2) points of the grid that, beside the resonances found, take most off what these leave."""
    left, basis = target, np.zeros((target.size, 0))
    if found.size:
        basis = np.linalg.qr(respond(found))[0]
        left = target - basis @ (basis.T @ target)
    taken = []
    for some in np.array_split(grid, _RATIOS.size):
        columns = respond(some.ravel())
        columns -= basis @ (basis.T @ columns)
        taken.append((left @ columns) ** 2 / np.maximum(np.einsum("ij,ij->j", columns, columns), _TINY))
    return np.asarray(grid[np.argsort(np.concatenate(taken))[-_TRIED:]])


def _compute_spectra(record: SystemRecord, hold: str) -> tuple[Float, Complex, Complex]:
    """Angular frequencies in rad/s and spectra of input and output, without the mean, the input as its hold passes it on."""
    n = record.input.size
    window = np.ones(n) if record.periodic else np.hanning(n)
    u, y = (np.fft.rfft((x - x.mean()) * window)[1:] / np.sqrt(n) for x in (record.input, record.output))
    w = np.asarray(2 * np.pi * np.fft.rfftfreq(n, record.interval_s)[1:])
    return w, u * respond_of_hold(w, record.interval_s, hold), y
