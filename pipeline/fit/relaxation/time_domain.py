"""Large load–unload cycles: an equilibrium (hyperelastic) stress plus Maxwell branches, fitted in time.

    P = P_eq(λ) + Σ Qᵢ,   dQᵢ/dt + Qᵢ/τᵢ = γᵢ dλ/dt,   ηᵢ = γᵢ τᵢ

Q is integrated exactly for a stretch that is linear between samples, whatever their spacing. For given τ the stress is linear in
γ ≥ 0, so that the search is the one of `varpro`. The residual of such a fit is a model discrepancy with long memory, not noise:
standard deviations are widened for its autocorrelation, and a further branch is judged by its error on a part of the cycle that
was left out, never by the sum of squares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from pipeline.fit.relaxation.starts import candidates
from pipeline.fit.relaxation.varpro import Candidate, LinearProblem
from pipeline.physics.film import integrate_arms
from pipeline.physics.hyperelastic import LAWS, LINEAR, NON_AFFINE, Law
from pipeline.physics.least_squares import differ_at_once
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.numbers import counted, digits

HELD_OUT = 0.3
"""Share of the cycle, at its end, that is left out to judge a branch."""
WORTH = 0.1
"""Share by which a further branch must lower the error on the part left out."""
ORDERS, MOST = (1, 2, 3), 5
"""Orders that are fitted unless others are asked for, and the highest that is tried on as long as each predicts better."""
FEWEST = 20
MOST_STEPS = 100
"""Steps of the last refinement: one that takes more runs along a valley in which nothing is determined."""
GONE = 1e-6
"""Modulus of the equilibrium law below which it counts as gone, in units of the stress's standard deviation."""
SHAPES = 8
"""Values of the law's shape parameter from which the fit starts; the best one is refined."""
RESOLVED = 0.3
"""Largest standard deviation of a logarithm that is reported as a number."""


@dataclass(frozen=True)
class CycleFit:
    """One order of a large cycle. Stresses in the unit of the data (kPa), times in s.

    `gamma`, `tau`, `eta` (n,) of the branches, longest first, with `_sd` (None: not resolved); `equilibrium` parameters of the law, and which of
    them were fitted; `sse` sum of squares, `rmse`, and `held_out_rmse` on the last part of the cycle after a fit to the rest;
    `correlation` of neighbouring residuals.
    """

    order: int
    gamma: tuple[float, ...]
    tau: tuple[float, ...]
    gamma_sd: tuple[float | None, ...]
    tau_sd: tuple[float | None, ...]
    eta_sd: tuple[float | None, ...]
    equilibrium: Mapping[str, float]
    sse: float
    rmse: float
    relative_rmse: float
    held_out_rmse: float
    correlation: float
    samples: int
    warnings: tuple[str, ...] = ()

    @property
    def eta(self) -> tuple[float, ...]:
        """Viscosities γ τ."""
        return tuple(g * t for g, t in zip(self.gamma, self.tau, strict=True))

    def in_units(self, law: Law, unit: float, given: Mapping[str, float] | None) -> CycleFit:
        """The fit of a stress that was divided by `unit` as one of that stress; `given` parameters of the law as they were given."""

        def times(values: tuple[float | None, ...]) -> tuple[float | None, ...]:
            return tuple(None if value is None else value * unit for value in values)

        return replace(
            self,
            gamma=tuple(value * unit for value in self.gamma),
            gamma_sd=times(self.gamma_sd),
            eta_sd=times(self.eta_sd),
            equilibrium=law.in_units(self.equilibrium, unit) if given is None else dict(given),
            sse=self.sse * unit**2,
            rmse=self.rmse * unit,
            held_out_rmse=self.held_out_rmse * unit,
        )


@dataclass(frozen=True)
class CycleFits:
    """All orders of one recording; `selected_order` by the error on the part left out.

    `section_over_length_mm` is that of the undeformed film, None where its sizes are not known: a cube of 1 mm then.
    """

    recording_id: str
    specimen_id: str
    law: str
    fixed: bool
    fits: tuple[CycleFit, ...]
    selected_order: int
    warnings: tuple[str, ...] = field(default=())
    section_over_length_mm: float | None = None

    @property
    def n_per_mm_of_kpa(self) -> float:
        """Stiffness of the film in N/mm for each kPa of its modulus: section over length, both undeformed."""
        return 1e-3 * (1.0 if self.section_over_length_mm is None else self.section_over_length_mm)

    @property
    def selected(self) -> CycleFit:
        return next(f for f in self.fits if f.order == self.selected_order)

    def stress(self, fit: CycleFit, time_s: Float, stretch: Float) -> Float:
        """Nominal stress (m,) of one order over a cycle, in the unit of the data."""
        branches = integrate_arms(time_s, stretch, np.array(fit.tau)) @ np.array(fit.gamma)
        return np.asarray(LAWS[self.law].stress(stretch, fit.equilibrium) + branches)

    def slope_at_rest(self, fit: CycleFit) -> float:
        """Slope of the equilibrium stress at stretch 1, in the unit of the stress."""
        around = LAWS[self.law].stress(np.array([1 - 1e-5, 1 + 1e-5]), fit.equilibrium)
        return float(np.diff(around)[0] / 2e-5)


def fit_cycle(
    time_s: Float,
    stretch: Float,
    stress: Float,
    *,
    law: Law = NON_AFFINE,
    equilibrium: Mapping[str, float] | None = None,
    orders: Sequence[int] | None = None,
    recording_id: str = "",
    specimen_id: str = "",
    section_over_length_mm: float | None = None,
) -> CycleFits:
    """Branches, and the equilibrium law unless `equilibrium` gives it, from (m,) s, stretch and nominal stress.

    `section_over_length_mm` of the undeformed film makes stiffnesses of moduli, see `CycleFits`.

    Raises `NotIdentifiableError` for too few samples, times that do not rise, or a stretch that does not change.
    """
    good = np.isfinite(time_s) & np.isfinite(stretch) & np.isfinite(stress)
    t, lam, p = time_s[good], stretch[good], stress[good]
    _check(t, lam, law, recording_id)
    warnings = []
    # Searched in units of its own scatter: what a search takes for small must not depend on the unit of the stress.
    unit = float(np.std(p)) or 1.0
    own, given = p / unit, None if equilibrium is None else law.in_units(equilibrium, 1 / unit)
    if abs(p[0]) > 0.005 * np.ptp(p) and law is not LINEAR:
        warnings.append(f"stress starts at {p[0]:.3g}, not at 0: an offset of the load cell stays in the fit")
    gaps = np.diff(t)
    if gaps.max() > 1.5 * np.median(gaps):
        count = int((gaps > 1.5 * np.median(gaps)).sum())
        warnings.append(f"{counted(count, 'gap')} in time, bridged by a straight line")
    part = t <= t[0] + (1 - HELD_OUT) * (t[-1] - t[0])
    fits: list[CycleFit] = []
    lower: Candidate | None = None
    early: Candidate | None = None
    remaining = sorted(ORDERS if orders is None else orders)
    selected: CycleFit | None = None
    while remaining:
        n = remaining.pop(0)
        problem = _Cycle(t, lam, own, law, given, float(lam.max()))
        lower, solution = problem.fit(n, lower)
        train = _Cycle(t[part], lam[part], own[part], law, given, float(lam.max()))
        early, learned = train.fit(n, early)
        rest = problem.stress(learned)[~part] - own[~part]
        fits.append(problem.report(n, solution, float(np.sqrt(np.mean(rest**2)))).in_units(law, unit, equilibrium))
        if selected is None or fits[-1].held_out_rmse < (1 - WORTH) * selected.held_out_rmse:
            selected = fits[-1]
        if not remaining and orders is None and selected is fits[-1] and n < MOST:
            remaining.append(n + 1)
    assert selected is not None
    if selected is fits[-1] and len(fits) > 1:
        warnings.append(f"order {selected.order} predicts best, and none above it was tried")
    return CycleFits(
        recording_id,
        specimen_id,
        law.name,
        equilibrium is not None,
        tuple(fits),
        selected.order,
        tuple(warnings),
        section_over_length_mm,
    )


def _check(t: Float, lam: Float, law: Law, where: str) -> None:
    if t.size < FEWEST:
        raise NotIdentifiableError(f"{t.size} samples", where=where, expected=f"at least {FEWEST} of a load cycle")
    if not (np.diff(t) > 0).all():
        raise NotIdentifiableError("times do not rise", where=where, expected="ascending times")
    if np.ptp(lam) < 1e-3 or (lam.min() <= 0 and law is not LINEAR):
        raise NotIdentifiableError(
            f"stretch from {lam.min():.4g} to {lam.max():.4g}", where=where, expected="a cycle of some percent"
        )


@dataclass(frozen=True)
class _Solution:
    gamma: Float
    tau: Float
    equilibrium: dict[str, float]
    residual: Float
    jacobian: Float
    names: tuple[str, ...]


class _Cycle:
    """The linear problem that `varpro` searches: columns of branches, with the equilibrium law projected out; stresses in units of their scatter.

    `largest` is the largest stretch that the law has to reach, which may lie in a part left out.
    """

    def __init__(
        self, t: Float, lam: Float, p: Float, law: Law, fixed: Mapping[str, float] | None, largest: float
    ) -> None:
        self.t, self.lam, self.p, self.law, self.fixed = t, lam, p, law, fixed
        self.low = float(np.log(np.median(np.diff(t))))
        self.high = float(np.log(30 * (t[-1] - t[0])))
        self.largest = largest
        self._place(1.0 if fixed is None else fixed.get(law.shape or "", 1.0))

    def _place(self, shape: float) -> None:
        self.shape = shape
        base = self.law.columns(self.lam, shape)
        if self.fixed is not None:
            self.basis = np.zeros((self.t.size, 0))
            self.target = self.p - self.law.stress(self.lam, self.fixed)
        else:
            self.basis, _ = np.linalg.qr(base)
            self.target = self._left(self.p)

    def _left(self, rows: Float) -> Float:
        return np.asarray(rows - self.basis @ (self.basis.T @ rows))

    def columns(self, tau: Float) -> Float:
        return self._left(integrate_arms(self.t, self.lam, tau))

    def ends(self) -> Float:
        """No spring beside the equilibrium law and no dashpot: the stretch rate of a triangle is a constant."""
        return np.zeros((self.t.size, 2))

    def fit(self, order: int, lower: Candidate | None) -> tuple[Candidate, _Solution]:
        """The best model of that order."""
        none = (np.zeros(0), np.zeros(0))

        def best(shape: float) -> Candidate:
            self._place(shape)
            problem = LinearProblem(self, self.low, self.high, per_decade=8)
            found = [c for c in candidates(problem, order, lower, none) if c.c == 0]
            return found[0]

        shapes = [self.shape]
        if self.fixed is None and self.law.shape is not None:
            low, high = self.law.range(self.largest)
            shapes = list(np.geomspace(1.05 * low, high, SHAPES))
        found = [best(float(s)) for s in shapes]
        i = int(np.argmin([c.cost for c in found]))
        candidate = found[i]
        self._place(float(shapes[i]))
        return candidate, self._polished(candidate)

    def _polished(self, candidate: Candidate) -> _Solution:
        used = candidate.k > 0
        n = int(used.sum())
        gamma, tau = candidate.k[used], np.exp(candidate.log_tau[used])
        start = [*np.log(gamma), *np.log(tau)]
        span = np.log([GONE**2, 1 / GONE])
        limits = [(float(span[0]), float(span[1]))] * n + [(self.low, self.high)] * n
        names = tuple(f"log gamma{i + 1}" for i in range(n)) + tuple(f"log tau{i + 1}" for i in range(n))
        if self.fixed is None:
            base = self.law.columns(self.lam, self.shape)
            rest = self.p - integrate_arms(self.t, self.lam, tau) @ gamma
            start += list(np.linalg.lstsq(base, rest, rcond=None)[0])
            limits += [(-np.inf if name in self.law.signed else 0.0, np.inf) for name in self.law.moduli]
            names += self.law.moduli
            if self.law.shape:
                start.append(np.log(self.shape))
                low, high = self.law.range(self.largest)
                limits.append((float(np.log(low)), float(np.log(high))))
                names += (f"log {self.law.shape}",)

        def residual(x: Float) -> Float:
            return np.asarray(self._stress(x, n) - self.p)

        low_limits, high_limits = np.array(limits).T
        start = np.clip(start, low_limits + 1e-9, high_limits - 1e-9)
        found = least_squares(
            residual,
            start,
            jac="3-point",
            x_scale="jac",
            bounds=(low_limits, high_limits),
            xtol=1e-12,
            ftol=1e-12,
            max_nfev=MOST_STEPS,
            workers=differ_at_once(residual),
        )
        order = np.argsort(-found.x[n : 2 * n])
        index = np.concatenate([order, n + order, np.arange(2 * n, found.x.size)]).astype(int)
        x = found.x[index]
        equilibrium = dict(self.fixed) if self.fixed is not None else self._equilibrium(x, n)
        return _Solution(
            np.exp(x[:n]),
            np.exp(x[n : 2 * n]),
            equilibrium,
            found.fun,
            found.jac[:, index],
            names,
        )

    def _equilibrium(self, x: Float, n: int) -> dict[str, float]:
        values = {m: float(v) for m, v in zip(self.law.moduli, x[2 * n :], strict=False)}
        if self.law.shape:
            values[self.law.shape] = float(np.exp(x[-1]))
        return values

    def _stress(self, x: Float, n: int) -> Float:
        """(…, m) of x (…, P)."""
        gamma, tau = np.exp(x[..., :n]), np.exp(x[..., n : 2 * n])
        arms = integrate_arms(self.t, self.lam, tau.ravel()).reshape(self.t.size, *tau.shape)
        q = np.einsum("m...n,...n->...m", arms, gamma)
        if self.fixed is not None:
            return np.asarray(self.law.stress(self.lam, self.fixed) + q)
        entries = x[..., 2 * n :]
        if self.law.shape:
            entries = np.concatenate([entries[..., :-1], np.exp(entries[..., -1:])], axis=-1)
        return np.asarray(self.law.stress_of(self.lam, entries) + q)

    def stress(self, solution: _Solution) -> Float:
        """Stress (m,) of a fitted model on this cycle."""
        q = integrate_arms(self.t, self.lam, solution.tau) @ solution.gamma
        return np.asarray(self.law.stress(self.lam, solution.equilibrium) + q)

    def report(self, order: int, solution: _Solution, held_out: float) -> CycleFit:
        n = solution.gamma.size
        r = solution.residual
        sse = float(r @ r)
        correlation = float(r[1:] @ r[:-1] / (r @ r)) if sse > 0 else 0.0
        freedom = max(r.size - len(solution.names), 1)
        memory = (1 + correlation) / max(1 - correlation, 1e-3)
        scale = np.linalg.norm(solution.jacobian, axis=0)
        scale = np.where(scale > 0, scale, 1e-9)
        _, s, vt = np.linalg.svd(solution.jacobian / scale, full_matrices=False)
        root = (vt.T / np.maximum(s, 1e-9 * s[0])) / scale[:, None]
        c = root @ root.T * (sse / freedom) * max(memory, 1.0)
        sd = np.sqrt(np.diag(c))
        both = [float(np.sqrt(max(c[i, i] + c[n + i, n + i] + 2 * c[i, n + i], 0.0))) for i in range(n)]
        warnings = []
        if n < order:
            warnings.append(f"only {n} of {digits(order, 'branch', 'branches')} resolved")
        for i in range(n):
            if max(sd[i], sd[n + i]) > RESOLVED:
                warnings.append(
                    f"branch {i + 1}: stiffness or relaxation time not resolved by a cycle of {np.ptp(self.t):.3g} s"
                )
        bounded = [m for m in self.law.moduli if m not in self.law.signed]
        gone = [m for m in bounded if self.fixed is None and solution.equilibrium[m] < GONE]
        if gone:
            warnings.append(f"{' and '.join(gone).replace('_', ' ')} at its bound 0")
        if held_out > np.abs(self.p).max():
            warnings.append(
                "the part of the cycle left out is missed by more than its own size: this cycle does not tell the"
                " equilibrium stress from relaxation"
            )
        if correlation > 0.5:
            warnings.append(
                f"residuals are correlated ({correlation:.3f} between neighbours): a discrepancy of the model, not noise"
            )
        return CycleFit(
            order=order,
            gamma=tuple(map(float, solution.gamma)),
            tau=tuple(map(float, solution.tau)),
            gamma_sd=_shown(solution.gamma, sd[:n]),
            tau_sd=_shown(solution.tau, sd[n : 2 * n]),
            eta_sd=_shown(solution.gamma * solution.tau, np.array(both)),
            equilibrium=solution.equilibrium,
            sse=sse,
            rmse=float(np.sqrt(sse / r.size)),
            relative_rmse=float(np.sqrt(sse / r.size) / np.abs(self.p).max()),
            held_out_rmse=held_out,
            correlation=correlation,
            samples=r.size,
            warnings=tuple(warnings),
        )


def _shown(values: Float, sd_log: Float) -> tuple[float | None, ...]:
    return tuple(float(v * e) if e <= RESOLVED else None for v, e in zip(values, sd_log, strict=True))
