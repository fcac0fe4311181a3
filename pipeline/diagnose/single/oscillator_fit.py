"""Least squares of oscillators: many fits that differ in what is free and in what they are fitted to go side by side in
one run.

Does not belong here: which fits are asked for, and what follows from them.
"""

from __future__ import annotations

from collections.abc import Sequence
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
    GAIN,
    PARAMETERS,
    QUADRATIC,
    RATE,
    SLIP,
    STIFFNESS,
    Oscillator,
    SystemRecord,
)
from schemas.arrays import Bool, Complex, Float

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
}
"""Least and largest value of each parameter, in the units of `oscillator`."""
_LOWER, _UPPER = np.array([_BOUNDS[i] for i in range(PARAMETERS)]).T
_STEP = 1e-5
"""Step of derivatives."""
_ROUNDS = 20
"""Rounds of a fit at most."""
_STILL = 1e-5
"""Relative fall of the sum of squares that ends a fit."""
_LINES = 3000
"""Strongest spectral lines by which a linear start is found."""
_FREQUENCIES, _RATIOS = 160, np.geomspace(3e-3, 3.0, 9)
"""Frequencies and damping ratios of the grid of linear starts."""
_LEAST_RATIO, _LARGEST_RATIO = 1e-4, 3.0
"""Damping ratios that a linear start may have. Beyond 3 an oscillator is a low pass of first order, whose second pole is
a hundred times the first and more: records do not tell how much, and steps that the first one needs do not follow it."""


@dataclass(frozen=True)
class Problem:
    """A fit that is asked for: start (PARAMETERS,), rows that are free, and (M,) values that are fitted."""

    start: Float
    free: tuple[int, ...]
    fitted: Bool


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


@dataclass(frozen=True)
class _State:
    fit: Fit
    damping: float
    proposed: Float
    done: bool


def clip_parameters(parameters: Float) -> Float:
    """(…, PARAMETERS) within what a fit may reach; rates that are none stay so."""
    none = np.isneginf(parameters)
    return np.where(none, parameters, np.clip(parameters, _LOWER, _UPPER))


def join_compared(oscillator: Oscillator, of_records: Sequence[Float]) -> Float:
    """(…, M) values that are compared, of all records one after the other; from (…, n) of each."""
    parts = [v[..., oscillator.compared(r)] for r, v in zip(oscillator.records, of_records, strict=True)]
    return np.concatenate(parts, axis=-1)


def fit_all(oscillator: Oscillator, measured: Float, problems: Sequence[Problem]) -> list[Fit]:
    """All fits, by the method of Levenberg and Marquardt within bounds. measured : (M,)"""
    states = [
        _State(Fit(p, p.start, np.zeros(0), np.zeros((0, 0)), np.inf, ()), 1e-3, p.start, False) for p in problems
    ]
    for _ in range(_ROUNDS):
        turn = [i for i, s in enumerate(states) if not s.done]
        if not turn:
            break
        found = _evaluated(oscillator, measured, [(states[i].fit.problem, states[i].proposed) for i in turn])
        for i, fit in zip(turn, found, strict=True):
            states[i] = _next(states[i], fit, measured)
    return [s.fit for s in states]


def _evaluated(oscillator: Oscillator, measured: Float, asked: Sequence[tuple[Problem, Float]]) -> list[Fit]:
    """Values and derivatives at the proposed parameters, by one run."""
    columns = []
    for problem, theta in asked:
        columns.append(theta)
        for row in problem.free:
            columns.append(theta + _STEP * (np.arange(PARAMETERS) == row))
    by_record = oscillator(np.array(columns).T)
    everything = join_compared(oscillator, by_record)
    found, first = [], 0
    for problem, theta in asked:
        own = slice(first, first + 1 + len(problem.free))
        records = tuple(values[first] for values in by_record)
        first = own.stop
        with np.errstate(over="ignore", invalid="ignore"):
            jacobian = (everything[own][1:] - everything[own][0]).T / _STEP
            cost = float(np.sum((everything[own][0] - measured)[problem.fitted] ** 2))
        usable = np.isfinite(cost) and np.isfinite(jacobian[problem.fitted]).all()
        found.append(Fit(problem, theta, everything[own][0], jacobian, cost if usable else np.inf, records))
    return found


def _next(state: _State, tried: Fit, measured: Float) -> _State:
    """The state after a trial: taken over where it is better, and the next proposal."""
    before = state.fit
    better = tried.cost < before.cost
    if not better and not np.isfinite(before.cost):
        return replace(state, fit=tried, done=True)
    fit = tried if better else before
    fall = (before.cost - tried.cost) / tried.cost if better and np.isfinite(before.cost) else np.inf
    damping = state.damping * (0.1 if better else 10.0)
    proposed, promised = _step(fit, measured, damping)
    return _State(fit, damping, proposed, fall < _STILL or promised < _STILL)


def _step(fit: Fit, measured: Float, damping: float) -> tuple[Float, float]:
    """(PARAMETERS,) next proposal, and the relative fall of the sum of squares that it promises.

    What a bound holds is left at it, and the rest steps without it.
    """
    fitted, rows = fit.problem.fitted, np.array(fit.problem.free)
    jacobian, residual = fit.jacobian[fitted], (fit.simulated - measured)[fitted]
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    normal, gradient = (jacobian / scale).T @ (jacobian / scale), (jacobian / scale).T @ residual
    moving = np.ones(rows.size, dtype=bool)
    theta = fit.parameters.copy()
    while moving.any():
        part = normal[np.ix_(moving, moving)] + damping * np.eye(int(moving.sum()))
        wanted = fit.parameters[rows[moving]] - np.linalg.solve(part, gradient[moving]) / scale[moving]
        theta[rows[moving]] = np.clip(wanted, _LOWER[rows[moving]], _UPPER[rows[moving]])
        held = wanted != theta[rows[moving]]
        if not held.any():
            break
        moving[np.flatnonzero(moving)[held]] = False
    change = (theta[rows] - fit.parameters[rows]) * scale
    return theta, -float(change @ (2 * gradient + normal @ change)) / fit.cost


def find_linear_start(records: Sequence[SystemRecord]) -> tuple[float, float, float]:
    """Angular frequency in rad/s, damping ratio and gain of y″ + 2ζω y′ + ω² y = g u, from spectra under a window of
    Hann.

    The response error |Y − g U/D|² on a grid of ω and ζ, with the best g of each, and on from its least. Beyond half the
    lowest and twice the highest frequency of the records every ω does the same to them: a spike, which excites all
    frequencies alike, or a system without a resonance would send it to nothing or without end.
    """
    w, u, y = (np.concatenate(part) for part in zip(*(_compute_spectra(r) for r in records), strict=True))
    strongest = np.argsort(np.abs(y))[-_LINES:]
    w, u, y = w[strongest], u[strongest], y[strongest]

    def gain(omega: float, ratio: float) -> tuple[float, float]:
        of_one = u / (omega**2 - w**2 + 2j * ratio * omega * w)
        g = float(np.vdot(of_one, y).real / np.vdot(of_one, of_one).real)
        return g, float(np.sum(np.abs(y - g * of_one) ** 2))

    lowest, highest = float(w.min()) / 2, float(w.max()) * 2
    grid = [
        (gain(omega, ratio)[1], omega, ratio)
        for omega in np.geomspace(lowest, highest, _FREQUENCIES)
        for ratio in _RATIOS
    ]
    _, omega, ratio = min(grid)
    found = minimize(
        lambda x: gain(float(np.exp(x[0])), float(np.exp(x[1])))[1],
        np.log([omega, ratio]),
        method="Nelder-Mead",
        bounds=np.log([(lowest, highest), (_LEAST_RATIO, _LARGEST_RATIO)]),
        options={"initial_simplex": np.log([omega, ratio]) + np.array([[0, 0], [0.05, 0], [0, 0.5]])},
    )
    omega, ratio = np.exp(found.x)
    return float(omega), float(ratio), gain(omega, ratio)[0]


def _compute_spectra(record: SystemRecord) -> tuple[Float, Complex, Complex]:
    """Angular frequencies in rad/s and spectra of input and output, without the mean."""
    n = record.input.size
    window = np.ones(n) if record.periodic else np.hanning(n)
    u, y = (np.fft.rfft((x - x.mean()) * window)[1:] / np.sqrt(n) for x in (record.input, record.output))
    return np.asarray(2 * np.pi * np.fft.rfftfreq(n, record.interval_s)[1:]), u, y
