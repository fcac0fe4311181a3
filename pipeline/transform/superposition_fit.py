"""The joint fit behind a master curve: one relaxation of any order and the shifts of all isotherms at once.

Residuals are model over measured in complex form, ln of it in first order: the real part is the relative error of the
magnitude, the imaginary part that of the phase, each in its own noise. They are linear in the springs, so that only the
shifts are searched for. Does not belong here: what the result means (`pipeline.transform.superposition`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from pipeline.physics.least_squares import Options, minimise_each
from schemas.arrays import Bool, Complex, Float, Int
from schemas.errors import NotIdentifiableError

PER_DECADE = 10
"""Relaxation times on the grid in a decade: the error of an arm between two of them is 0.1 % of its own part."""
BEYOND = float(np.log(30.0))
"""Relaxation times reach so far beyond the reduced frequencies, in ln: beyond it an arm is a spring or a dashpot."""
ROOM = float(np.log(1e3))
"""How far shifts may move from where the search began, in ln, on the grid that was laid for them."""
FIRST_NOISE = 0.01
LEAST_NOISE = 1e-6
"""Relative: numbers in a file have no more digits."""
ROUNDS = 6
"""Most rounds of noise and weights."""
_NOTHING = 1e-100
"""Standard deviations; an arm that relaxes long before or after all points changes them by less."""
_SEARCH = Options(fall=1e-3, share=1e-7, most=60)


@dataclass(frozen=True)
class Isotherm:
    """A film's response, or relaxation, at one temperature.

    Parameters
    ----------
    temperature_c : °C
    axis : (n,) Hz of a response, s since the step of a relaxation; ascending
    value : (n,) complex N/mm of a response, real N/mm of a relaxation
    variance : (n,) E|Δvalue|², of a response both components together; NaN where unknown
    in_time : whether it is a relaxation
    recording_id : what it was measured in
    """

    temperature_c: float
    axis: Float
    value: Complex | Float
    variance: Float
    in_time: bool = False
    recording_id: str | None = None

    @property
    def log_rate(self) -> Float:
        """(n,) ln of the angular frequency, rad/s, or of one over the time."""
        return np.asarray(-np.log(self.axis) if self.in_time else np.log(2 * np.pi * self.axis))


@dataclass(frozen=True)
class Data:
    """All points of all isotherms, N in number, those of one isotherm together.

    Parameters
    ----------
    log_rate : (N,) ln rad/s, or ln 1/s
    value : (N,) complex; of a relaxation without imaginary part
    own_noise : (N,) relative standard deviation of one component as stated, NaN where it is not
    of : (N,) which isotherm
    timed : (N,) whether it is a relaxation
    reference : which isotherm stays where it is
    count : number of isotherms
    """

    log_rate: Float
    value: Complex
    own_noise: Float
    of: Int
    timed: Bool
    reference: int
    count: int

    @property
    def free(self) -> Int:
        """The isotherms that are shifted."""
        return np.delete(np.arange(self.count), self.reference)

    def select(self, isotherm: int) -> Data:
        """One isotherm alone."""
        mask = self.of == isotherm
        parts = (self.log_rate, self.value, self.own_noise)
        rate, value, noise = (part[mask] for part in parts)
        return Data(rate, value, noise, np.zeros(rate.size, dtype=np.int64), self.timed[mask], 0, 1)


def assemble(isotherms: Sequence[Isotherm], reference_c: float) -> Data:
    """The points of isotherms; the one nearest to the temperature, °C, is the reference.

    Raises
    ------
    NotIdentifiableError
        There are fewer than two temperatures, or an isotherm has no value that can be used.
    """
    temperatures = np.array([one.temperature_c for one in isotherms])
    if temperatures.size < 2 or np.ptp(temperatures) == 0:
        raise NotIdentifiableError(
            "a master curve of one temperature", expected="two temperatures of one specimen or more"
        )
    parts: list[tuple[Float, Complex, Float, Int, Bool]] = []
    for number, one in enumerate(isotherms):
        value = one.value.astype(np.complex128)
        good = np.isfinite(value) & np.isfinite(one.axis) & (one.axis > 0) & (np.abs(value) > 0)
        if not good.any():
            raise NotIdentifiableError(
                f"nothing can be used at {one.temperature_c:g} °C",
                where=one.recording_id or "",
                expected="finite values",
            )
        components = 1 if one.in_time else 2
        noise = np.sqrt(one.variance[good] / components) / np.abs(value[good])
        noise = np.where(noise > 0, np.maximum(noise, LEAST_NOISE), np.nan)
        count = int(good.sum())
        parts.append(
            (one.log_rate[good], value[good], noise, np.full(count, number), np.full(count, one.in_time, dtype=bool))
        )
    rate, value, noise, of, timed = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Data(rate, value, noise, of, timed, int(np.abs(temperatures - reference_c).argmin()), len(isotherms))


@dataclass(frozen=True)
class Fit:
    """Where the joint fit ended.

    Parameters
    ----------
    log_a, log_b : (m,) ln of the shifts of all isotherms
    tau, k : (K,) s and springs above 0; spring, dashpot: the ends
    model : (N,) complex, the curve at the points
    slope : (N,) complex, its derivative by ln of the rate
    residual : (R,) in standard deviations, magnitudes and relaxations first, then phases
    leverage : (R,) share of each residual that the fit took up
    covariance : (Q, Q) of ln a of the shifted isotherms, then of their ln b where these are free
    chi2, freedom : sum of squares, and rows less parameters
    vertical_fall : what free vertical shifts would take off χ², to first order (score test); 0 where they are free
    magnitude_noise, phase_noise : (N,) in which the residuals are counted, relative and rad
    """

    log_a: Float
    log_b: Float
    tau: Float
    k: Float
    spring: float
    dashpot: float
    model: Complex
    slope: Complex
    residual: Float
    leverage: Float
    covariance: Float
    chi2: float
    freedom: float
    vertical_fall: float
    magnitude_noise: Float
    phase_noise: Float
    with_b: bool


def fit_jointly(data: Data, *, with_b: bool = False, start: Fit | None = None) -> Fit:
    """The curve and all shifts, the vertical ones too where `with_b`; the search begins where `start` ended."""
    log_a = find_start(data) if start is None else start.log_a
    log_b = np.zeros(data.count)
    scale = data.value if start is None else start.model
    first = np.where(np.isfinite(data.own_noise), data.own_noise, FIRST_NOISE)
    by_magnitude = first if start is None else start.magnitude_noise
    by_phase = first if start is None else start.phase_noise
    fit = None
    for _ in range(ROUNDS):
        problem = _Problem(data, log_a, scale, by_magnitude, by_phase, with_b=with_b)
        fit = problem.solve(log_a, log_b)
        log_a, log_b, scale = fit.log_a, fit.log_b, fit.model
        new_magnitude, new_phase = _estimate_noise(data, fit)
        change = max(np.abs(np.log(new_magnitude / by_magnitude)).max(), np.abs(np.log(new_phase / by_phase)).max())
        by_magnitude, by_phase = new_magnitude, new_phase
        if change < 0.01:
            break
    assert fit is not None
    return fit


def _estimate_noise(data: Data, fit: Fit) -> tuple[Float, Float]:
    """Noise of magnitude and phase by which each leaves as much as its degrees of freedom.

    Stated noise keeps its course over the points, and is never made smaller than stated.
    """
    count = data.value.size
    stated = np.isfinite(data.own_noise).all()
    found = []
    for noise, rows in ((fit.magnitude_noise, slice(0, count)), (fit.phase_noise, slice(count, None))):
        squares, left = float((fit.residual[rows] ** 2).sum()), float((1 - fit.leverage[rows]).sum())
        scaled = noise * np.sqrt(squares / left) if left > 0.5 else noise
        found.append(np.maximum(scaled, data.own_noise if stated else LEAST_NOISE))
    return found[0], found[1]


class _Problem:
    """The fit for given weights: `scale` (N,) complex is what residuals are relative to."""

    def __init__(
        self, data: Data, log_a: Float, scale: Complex, magnitude_noise: Float, phase_noise: Float, *, with_b: bool
    ) -> None:
        self.data, self.scale, self.with_b = data, scale, with_b
        self.magnitude_noise, self.phase_noise = magnitude_noise, phase_noise
        reduced = data.log_rate + log_a[data.of]
        room = 0.0 if data.count == 1 else ROOM
        low, high = -reduced.max() - BEYOND - room, -reduced.min() + BEYOND + room
        self.grid = np.linspace(low, high, int(np.ceil((high - low) / np.log(10) * PER_DECADE)) + 1)
        self.phased = np.flatnonzero(~data.timed)
        self.end = float(np.exp(-np.median(reduced)))
        """The dashpot's column is that of a rate of one over this, so that it is of the size of the others."""
        self.target = self.rows(data.value)

    def rows(self, values: Complex) -> Float:
        """(N, …) complex values as real rows: over the scale, in standard deviations."""
        shape = (-1,) + (1,) * (values.ndim - 1)
        share = values / self.scale.reshape(shape)
        magnitude = share.real / self.magnitude_noise.reshape(shape)
        phase = share.imag[self.phased] / self.phase_noise[self.phased].reshape(shape)
        return np.concatenate([magnitude, phase])

    def columns(self, log_a: Float, log_b: Float) -> tuple[Complex, Complex]:
        """(N, K + 2) spring, arms and dashpot at the points, and their derivatives by ln of the rate."""
        data = self.data
        rate = data.log_rate + log_a[data.of]
        size = np.exp(log_b[data.of])[:, None]
        turn = np.exp(np.minimum(rate[:, None] + self.grid, 300.0))
        value = np.empty((rate.size, self.grid.size + 2), dtype=np.complex128)
        slope = np.zeros_like(value)
        value[:, 0] = 1.0
        timed = data.timed
        z = 1j * turn[~timed]
        value[~timed, 1:-1], slope[~timed, 1:-1] = z / (1 + z), z / (1 + z) ** 2
        left = 1 / turn[timed]
        value[timed, 1:-1] = np.exp(-left)
        slope[timed, 1:-1] = left * np.exp(-left)
        value[:, -1] = slope[:, -1] = np.where(timed, 0.0, 1j * np.exp(rate) * self.end)
        return value * size, slope * size

    def project(self, log_a: Float, log_b: Float) -> tuple[Float, Float, Complex, Complex]:
        """Springs (K + 2,) at their best for given shifts, active columns of the rows, model (N,), slopes (N, K + 2)."""
        value, slope = self.columns(log_a, log_b)
        matrix = self.rows(value)
        size = np.linalg.norm(matrix, axis=0)
        size[size == 0] = np.inf
        x = nnls(matrix / size, self.target, maxiter=30 * matrix.shape[1])[0] / size
        return x, matrix, value @ x, slope

    def places(self, u: Float) -> tuple[Float, Float]:
        """ln a and ln b (m,) from the unknowns."""
        data = self.data
        log_a, log_b = np.zeros(data.count), np.zeros(data.count)
        log_a[data.free] = u[: data.count - 1]
        if self.with_b:
            log_b[data.free] = u[data.count - 1 :]
        return log_a, log_b

    def by_shift(self, model: Complex, slope: Complex) -> Float:
        """(R, Q) derivatives of the rows by the shifts, springs held."""
        data = self.data
        own = data.of[:, None] == data.free
        parts = [slope[:, None] * own]
        if self.with_b:
            parts.append(model[:, None] * own)
        return self.rows(np.concatenate(parts, axis=1))

    def evaluate(self, points: Float, problems: Int) -> tuple[Float, Float]:
        """Residuals and Jacobians for `minimise_each`."""
        residuals, jacobians = [], []
        for u in points:
            x, matrix, model, slope = self.project(*self.places(u))
            residuals.append(self.rows(model) - self.target)
            basis = _orthonormal(matrix[:, x > 0])
            change = self.by_shift(model, slope @ x)
            jacobians.append(change - basis @ (basis.T @ change))
        return np.array(residuals), np.array(jacobians)

    def solve(self, log_a: Float, log_b: Float) -> Fit:
        """The optimum from a start, with what it says of every residual."""
        data = self.data
        start = log_a[data.free]
        reach = np.full(start.size, ROOM)
        if self.with_b:
            start = np.concatenate([start, log_b[data.free]])
            reach = np.concatenate([reach, np.full(data.count - 1, 5.0)])
        if start.size:
            u = minimise_each(self.evaluate, [start], start - reach, start + reach, _SEARCH)[0].x
        else:
            u = start
        log_a, log_b = self.places(u)
        x, matrix, model, slope = self.project(log_a, log_b)
        by_rate = slope @ x
        jacobian = np.concatenate([self._of_curve(x, matrix, slope), self.by_shift(model, by_rate)], axis=1)
        size = np.linalg.norm(jacobian, axis=0)
        size[size < _NOTHING] = 1.0
        left, values, right = np.linalg.svd(jacobian / size, full_matrices=False)
        kept = values > 1e-9 * values[0]
        inverse = (right[kept].T / values[kept]) / size[:, None]
        covariance = inverse @ inverse.T
        residual = self.rows(model) - self.target
        shifts = u.size
        taken = left[:, kept]
        more = self.rows(model[:, None] * (data.of[:, None] == data.free))
        more = _orthonormal(more - taken @ (taken.T @ more)) if data.count > 1 else more
        arms = x[1:-1] > 0
        return Fit(
            log_a=log_a,
            log_b=log_b,
            tau=np.exp(self.grid[arms])[::-1],
            k=x[1:-1][arms][::-1],
            spring=float(x[0]),
            dashpot=float(x[-1]) * self.end,
            model=model,
            slope=by_rate,
            residual=residual,
            leverage=np.einsum("ij,ij->i", taken, taken),
            covariance=covariance[covariance.shape[0] - shifts :, covariance.shape[0] - shifts :],
            chi2=float(residual @ residual),
            freedom=float(residual.size - kept.sum()),
            vertical_fall=0.0 if self.with_b else float(((more.T @ residual) ** 2).sum()),
            magnitude_noise=self.magnitude_noise,
            phase_noise=self.phase_noise,
            with_b=self.with_b,
        )

    def _of_curve(self, x: Float, matrix: Float, slope: Complex) -> Float:
        """Columns of what the curve itself leaves open: the springs, and the relaxation time of an arm on one grid point.

        Two neighbours on the grid are one arm between them, whose spring and relaxation time their columns span already.
        """
        active = x > 0
        alone = active & ~np.roll(active, 1) & ~np.roll(active, -1)
        alone[[0, -1]] = False
        return np.concatenate([matrix[:, active], self.rows(slope[:, alone] * x[alone])], axis=1)


def find_start(data: Data) -> Float:
    """ln a (m,) to begin with: each isotherm is put where its magnitudes are those of its neighbour in stiffness.

    Where two have no magnitude in common, they are put end to end along their slopes.
    """
    curves = []
    for number in range(data.count):
        mask = data.of == number
        order = np.argsort(data.log_rate[mask])
        level = np.log(np.maximum(np.abs(data.value[mask]), 1e-300))[order]
        curves.append((data.log_rate[mask][order], np.maximum.accumulate(level)))
    by_level = np.argsort([np.median(level - rate * 1e-9) for rate, level in curves])[::-1]
    log_a = np.zeros(data.count)
    for upper, lower in itertools.pairwise(by_level):
        log_a[lower] = log_a[upper] + _offset(curves[upper], curves[lower])
    return np.asarray(log_a - log_a[data.reference])


def _offset(upper: tuple[Float, Float], lower: tuple[Float, Float]) -> float:
    """How far the lower of two curves (rates, levels) has to be moved along the rates to continue the upper one."""
    low, high = max(upper[1][0], lower[1][0]), min(upper[1][-1], lower[1][-1])
    if high > low:
        levels = np.linspace(low, high, 9)
        return float(np.median(np.interp(levels, upper[1], upper[0]) - np.interp(levels, lower[1], lower[0])))
    slopes = [np.ptp(level) / max(np.ptp(rate), 1e-9) for rate, level in (upper, lower)]
    gap = upper[1][0] - lower[1][-1]
    return float(upper[0][0] - lower[0][-1] - gap / max(np.mean(slopes), 1e-3))


def _orthonormal(columns: Float) -> Float:
    """Orthonormal basis (R, r) of columns (R, n)."""
    size = np.linalg.norm(columns, axis=0)
    if not size.any():
        return np.zeros((columns.shape[0], 0))
    left, values, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return np.asarray(left[:, values > 1e-9 * values[0]])
