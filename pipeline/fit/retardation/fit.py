"""Retardation times of a film under a drive that is held, by the search that relaxation uses.

    x(t) = offset + drift t + Σ over levels of [J0 u + Σ Jᵢ R(u, λᵢ) + φ ∫u dt] + noise,      R = u − response of a Maxwell arm

u is the measured drive (load, or squared voltage). For given λ that is linear in J ≥ 0: `varpro` searches, the tube test of
`order` says how many. Offset and drift of the displacement are projected out, and all is weighted by the covariance that
`slow_noise` estimates against the best retardation of any number of times.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear, nnls

from pipeline.fit.relaxation.order import LEVEL, arc_of, describe_end, tail_probability
from pipeline.fit.relaxation.starts import candidates
from pipeline.fit.relaxation.varpro import Candidate, LinearProblem
from pipeline.fit.retardation.slow_noise import SlowNoise, best_score, estimate_noise
from pipeline.physics.compliance import Compliance, integral
from pipeline.physics.film import integrate_arms
from pipeline.transform.holds import HeldRecord
from schemas.arrays import Float
from schemas.numbers import digits

ORDERS = (1, 2, 3)
MOST = 5
"""Highest order that is tried on where the test does not stop before."""
RESOLVED = 0.3
"""Largest standard deviation of a logarithm that is reported as a number."""
_FASTER, _SLOWER = 2.0, 3.0
"""Retardation times are searched from the first window over 2 to the length of the record times 3: a faster one is a spring, a
slower one a flow."""
_PER_DECADE = 8
_ROUNDS = 2
_ACTIVE = 1e-6
_STEP = 1e-4


@dataclass(frozen=True)
class RetardationFit:
    """One order. `parameters` (p,) are offset and drift (where fitted), J0, the Jᵢ, φ (where there is one) and the log λᵢ.

    `compliance` of the film; `covariance` (p, p) of the parameters; `chi2` against the noise that was estimated; `p_value` of the
    hypothesis that no further retardation is needed.
    """

    order: int
    compliance: Compliance
    parameters: Float
    covariance: Float
    nuisance: int
    drifts: bool
    chi2: float
    freedom: int
    p_value: float
    warnings: tuple[str, ...] = ()

    def with_parameters(self, parameters: Float) -> RetardationFit:
        """The same order with other parameters."""
        n, count = self.nuisance, len(self.compliance.times_s)
        retarded = tuple(parameters[n + 1 : n + 1 + count].tolist())
        times = tuple(np.exp(parameters[parameters.size - count :]).tolist())
        flow = float(parameters[n + 1 + count]) if self.compliance.flow else 0.0
        return replace(self, parameters=parameters, compliance=Compliance(float(parameters[n]), retarded, times, flow))

    @property
    def drift(self) -> tuple[float, float]:
        """Drift of the displacement, mm/s, and its standard deviation; 0 and 0 where none was fitted."""
        if not self.drifts:
            return 0.0, 0.0
        return float(self.parameters[self.nuisance - 1]), math.sqrt(
            float(self.covariance[self.nuisance - 1, self.nuisance - 1])
        )


@dataclass(frozen=True)
class Retardation:
    """All orders of one record, which of them the data ask for, and the noise that they were weighed by.

    `sign` is −1 for a film that contracts under the drive; `fastest_log_s` the logarithm of the least retardation time that was looked for.
    """

    record: HeldRecord
    noise: SlowNoise
    fits: tuple[RetardationFit, ...]
    selected_order: int
    sign: float
    fastest_log_s: float

    @property
    def selected(self) -> RetardationFit:
        return next(f for f in self.fits if f.order == self.selected_order)

    def modelled(self, fit: RetardationFit) -> Float:
        """Displacement (n,) of the windows by one order, offset and drift included."""
        record = self.record
        film = record.mean @ fit.compliance.response(record.history_s, record.drive)
        return np.asarray(self.sign * (film + nuisance_columns(record, fit.drifts) @ fit.parameters[: fit.nuisance]))


def fit_retardation(record: HeldRecord, *, drifts: bool, orders: Sequence[int] = ORDERS) -> Retardation:
    """Fits all orders, and on as long as the test asks for more, up to `MOST`. `drifts`: a constant drift of the displacement can be told from creep, because a load was taken off."""
    sign = _sign_of(record)
    noise = estimate_noise(record, _Problem(record, _first_noise(record), sign, drifts).spectrum()[1])
    for _ in range(_ROUNDS):
        noise = estimate_noise(record, _Problem(record, noise, sign, drifts).spectrum()[1], noise)
    problem = _Problem(record, noise, sign, drifts)
    spectrum, _ = problem.spectrum()
    linear = LinearProblem(problem, problem.low, problem.high, per_decade=_PER_DECADE)
    fits: list[RetardationFit] = []
    here = _best(linear, min(orders), None, spectrum)
    while True:
        # The order above the highest is fitted for the test of it, and kept where that does not stop.
        order = fits[-1].order + 1 if fits else min(orders)
        following = _best(linear, order + 1, here, spectrum)
        p_value = problem.test(here, following, noise)
        fits.append(problem.report(order, here, p_value))
        stops = any(fit.p_value > LEVEL for fit in fits)
        if order >= (max(orders) if stops else max(MOST, *orders)):
            break
        here = following
    selected = next((f.order for f in fits if f.p_value > LEVEL), fits[-1].order)
    if fits[-1].p_value <= LEVEL and selected == fits[-1].order:
        fits[-1] = replace(fits[-1], warnings=(*fits[-1].warnings, describe_end(selected, fits[-1].p_value)))
    return Retardation(record, noise, tuple(fits), selected, sign, problem.low)


def _best(linear: LinearProblem, order: int, lower: Candidate | None, spectrum: tuple[Float, Float]) -> Candidate:
    """The best candidate of an order: no worse than that of the order below."""
    best = candidates(linear, order, lower, spectrum)[0]
    return best if lower is None or best.cost <= lower.cost else lower


def _sign_of(record: HeldRecord) -> float:
    """1 where the film gives way along the drive, −1 where it contracts under it; both from rest where there is no offset."""
    drive, moved = record.mean @ record.drive, record.displacement
    if record.offset:
        drive, moved = drive - drive.mean(), moved - moved.mean()
    return 1.0 if float(moved @ drive) >= 0 else -1.0


def _first_noise(record: HeldRecord) -> SlowNoise:
    told = record.scatter[record.scatter > 0]
    span = float(np.ptp(record.displacement)) or 1.0
    return SlowNoise(max(float(np.median(told)) if told.size else 0.0, 1e-3 * span), 0.0)


def nuisance_columns(record: HeldRecord, drifts: bool) -> Float:
    """Columns (n, 0 to 2) of what the displacement does by itself: its offset, where it has one, and its drift."""
    since = record.time_s - record.history_s[0]
    parts = [np.ones(since.size)] if record.offset else []
    parts += [since] if drifts else []
    return np.column_stack(parts) if parts else np.zeros((since.size, 0))


def columns_of(record: HeldRecord, tau: Float) -> Float:
    """(n, k) mm per unit of the compliance that is retarded by `tau` (k,) s."""
    arms = record.drive[:, None] - integrate_arms(record.history_s, record.drive, tau)
    return np.asarray(record.mean @ arms)


def slopes_by_log_time(record: HeldRecord, tau: Float) -> Float:
    """Derivatives (n, k) of `columns_of` by the logarithms of the times."""
    later, earlier = columns_of(record, tau * math.exp(_STEP)), columns_of(record, tau * math.exp(-_STEP))
    return np.asarray((later - earlier) / (2 * _STEP))


class _Problem:
    """The weighted linear problem that `varpro` searches, offset and drift projected out."""

    def __init__(self, record: HeldRecord, noise: SlowNoise, sign: float, drifts: bool) -> None:
        self.record, self.rows, self.drifts = record, record.usable, drifts
        covariance = noise.covariance(record)[np.ix_(self.rows, self.rows)]
        self.root = cholesky(covariance, lower=True)
        self.nuisance = nuisance_columns(record, drifts)
        self.basis, _ = np.linalg.qr(self._white(self.nuisance))
        self.measured = self._white(sign * record.displacement)
        self.target = self._left(self.measured)
        seen, of = record.time_s[self.rows], record.hold[self.rows]
        first = float(np.min(np.diff(seen)[np.diff(of) == 0], initial=math.inf))
        for i, hold in enumerate(record.holds):
            own = seen[of == i]
            if own.size and (i or not record.rests):
                first = min(first, max(float(own[0]) - hold.begins_s, 1e-12))
        length = record.end_s - record.history_s[0]
        self.low, self.high = math.log(first / _FASTER), math.log(_SLOWER * length)

    def _white(self, rows: Float) -> Float:
        return np.asarray(solve_triangular(self.root, rows[self.rows], lower=True))

    def _left(self, rows: Float) -> Float:
        return np.asarray(rows - self.basis @ (self.basis.T @ rows))

    def raw_ends(self) -> Float:
        """(n, 2) of J0 and φ."""
        record = self.record
        both = np.column_stack([record.drive, integral(record.history_s, record.drive)])
        return np.asarray(record.mean @ both)

    def columns(self, tau: Float) -> Float:
        return self._left(self._white(columns_of(self.record, tau)))

    def ends(self) -> Float:
        return self._left(self._white(self.raw_ends()))

    def spectrum(self) -> tuple[tuple[Float, Float], Float]:
        """Log times and weights of the best retardation of any number of times, and the columns (n, p) that it uses."""
        grid = np.linspace(self.low, self.high, int((self.high - self.low) / math.log(10) * _PER_DECADE) + 2)
        raw = np.column_stack([self.raw_ends(), columns_of(self.record, np.exp(grid))])
        white = self._left(self._white(raw))
        size = np.linalg.norm(white, axis=0)
        size[size == 0] = 1.0
        weight = nnls(white / size, self.target, maxiter=50 * raw.shape[1])[0] / size
        used = weight * size > _ACTIVE * float((weight * size).max(initial=1e-300))
        arms = used[2:]
        return (grid[arms], weight[2:][arms]), np.column_stack([self.nuisance, raw[:, used]])

    def test(self, smaller: Candidate, larger: Candidate, noise: SlowNoise) -> float:
        """Probability of a gain so large by one more retardation, where the smaller model is true.

        Both are given the noise that suits them best: how far a displacement wanders is itself known from few windows.
        """
        scores = [best_score(self.record, self._design(c), noise) for c in (smaller, larger)]
        ratio = scores[0] - scores[1]
        grid = np.linspace(self.low, self.high, int((self.high - self.low) / math.log(10) * _PER_DECADE) + 2)
        curve = np.column_stack([self.columns(np.exp(grid)), self.ends()[:, 1]])
        return tail_probability(ratio, arc_of(curve, self._jacobian(smaller)))

    def _design(self, candidate: Candidate) -> Float:
        """Columns (n, p) of a model that is linear at given retardation times, offset and drift first."""
        times = np.exp(candidate.log_tau[candidate.k > 0])
        ends = self.raw_ends()
        return np.hstack(
            [
                self.nuisance,
                ends[:, :1],
                columns_of(self.record, times),
                ends[:, 1:] if candidate.c > 0 else ends[:, :0],
            ]
        )

    def _jacobian(self, candidate: Candidate) -> Float:
        used = candidate.k > 0
        times = np.exp(candidate.log_tau[used])
        ends = self.ends()
        parts = [ends[:, :1], self.columns(times), self._slopes(times) * candidate.k[used]]
        if candidate.c > 0:
            parts.append(ends[:, 1:])
        return np.hstack(parts)

    def _slopes(self, times: Float) -> Float:
        return self._left(self._white(slopes_by_log_time(self.record, times)))

    def report(self, order: int, candidate: Candidate, p_value: float) -> RetardationFit:
        used = candidate.k > 0
        times = np.exp(candidate.log_tau[used])
        white = self._white(self._design(candidate))
        nuisance = self.nuisance.shape[1]
        solution = _solve_within(white, self.measured, free=nuisance)
        retarded = solution[nuisance + 1 : nuisance + 1 + times.size]
        jacobian = np.hstack([white, self._white(slopes_by_log_time(self.record, times)) * retarded])
        scale = np.linalg.norm(jacobian, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        rest = self.measured - white @ solution
        freedom = max(rest.size - jacobian.shape[1], 1)
        chi2 = float(rest @ rest)
        _, s, vt = np.linalg.svd(jacobian / scale, full_matrices=False)
        half = (vt.T / np.maximum(s, 1e-9 * s[0])) / scale[:, None]
        covariance = half @ half.T * max(chi2 / freedom, 1.0)
        scaled = np.concatenate([np.zeros(nuisance), solution[nuisance:], np.zeros(times.size)])
        covariance += self.record.drive_error**2 * np.outer(scaled, scaled)
        flow = float(solution[-1]) if candidate.c > 0 else 0.0
        found = Compliance(float(solution[nuisance]), tuple(retarded.tolist()), tuple(times.tolist()), flow)
        warnings = []
        if times.size + (candidate.c > 0) < order:
            warnings.append(f"only {times.size + (candidate.c > 0)} of {digits(order, 'retardation')} resolved")
        parameters = np.concatenate([solution, candidate.log_tau[used]])
        return RetardationFit(
            order, found, parameters, covariance, nuisance, self.drifts, chi2, freedom, p_value, tuple(warnings)
        )


def _solve_within(columns: Float, target: Float, *, free: int) -> Float:
    """Least squares in which all but the first `free` coefficients stay at 0 or above."""
    solution = np.asarray(np.linalg.lstsq(columns, target, rcond=None)[0])
    if (solution[free:] >= 0).all():
        return solution
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    least = np.where(np.arange(size.size) < free, -np.inf, 0.0)
    found = lsq_linear(columns / size, target, (least, np.inf), method="bvls")
    return np.asarray(np.maximum(found.x, least) / size)
