"""The best relaxation of any order: a non-negative spectrum on a dense grid of relaxation times.

It is the point about which the searches are linearised, the yardstick of the positivity alarm, and the smooth reference from
which unknown noise and the spread between recordings are estimated. Found by Gauss-Newton steps, each an NNLS problem.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from pipeline.fit.relaxation.linear import Expansion, Linearisation, amplitude_given, first_expansion, solve
from pipeline.fit.relaxation.observations import ELECTRICAL, Curve, Lines, Observations
from pipeline.physics.film import Shape, debye
from schemas.arrays import Bool, Complex, Float, Int
from schemas.errors import NotIdentifiableError

PER_DECADE = 10
MARGIN = 1e3
"""The grid reaches from 1/(1000 ω_max) to 1000/ω_min, beyond which an arm is a dashpot or a spring."""
STEPS = 12
HELD = 1e4
DAMPING = (0.0, 1.0, 10.0, 100.0)
"""Strengths of the hold on nuisance parameters that a step tries, in units of the misfit."""
REFINEMENTS = 4
WORTH_REFINING = 0.5
MOST_COARSE = 60
NOTHING = 0.9
"""Share of the weighted sum of squares that must not stay unexplained."""
LARGEST_STEP = 20.0
"""Of a nuisance parameter within one Gauss-Newton step: standard deviations, or the logarithm of an amplitude."""


@dataclass(frozen=True)
class Reference:
    """The spectrum `x` (K + 2,): spring, arms at `tau` (K,), dashpot; nuisance parameters `q`; and how well it fits.

    `chi2` includes the priors; `active` counts positive coefficients; `freedom` = data − active.
    """

    observations: Observations
    tau: Float
    x: Float
    q: Float
    chi2: float
    residual: Float

    @property
    def active(self) -> int:
        return int((self.x > 0).sum())

    @property
    def freedom(self) -> float:
        return max(self.observations.data - self.active, 1.0)

    @property
    def dispersion(self) -> float:
        """max(1, χ² over degrees of freedom): factor on the variances where no relaxation reaches the data."""
        if self.observations.data - self.active < 4:
            return 1.0
        return max(1.0, self.chi2 / self.freedom)

    def material(self) -> tuple[Float, Shape]:
        """The spectrum as θ and shape."""
        arms = self.x[1:-1] > 0
        shape = Shape(int(arms.sum()), bool(self.x[0] > 0), bool(self.x[-1] > 0))
        return shape.join(self.x[0], self.x[1:-1][arms], self.tau[arms], self.x[-1]), shape

    def stiffness(self, omega: Float) -> Complex:
        return _stiffness(self.x, self.tau, omega)

    def expansion(self) -> Expansion:
        k = tuple(self.stiffness(b.omega) if isinstance(b, Lines) else None for b in self.observations.blocks)
        return Expansion(k, self.q, self.material())


def find_reference(observations: Observations, start: Reference | None = None) -> Reference:
    """The reference of these observations; `start` from the same data with other weights or gains saves steps."""
    if start is None:
        low, high = observations.omega_range
        decades = np.log10(MARGIN**2 * high / low)
        tau = np.geomspace(1 / (MARGIN * high), MARGIN / low, int(np.ceil(PER_DECADE * decades)) + 1)
        current = _first(observations, tau)
    else:
        q = np.zeros(observations.nuisance.size)
        names = {n: i for i, n in enumerate(start.observations.nuisance.names)}
        for i, name in enumerate(observations.nuisance.names):
            if name in names:
                q[i] = start.q[names[name]]
        current = _reference(observations, start.tau, start.x, q)
    current = _converged(current)
    # a spectrum on a fixed grid misses sharp data by the squared distance of its points: move points to where the spikes are
    spacing = np.log(10) / PER_DECADE
    for _ in range(REFINEMENTS):
        spacing /= 3
        finer, _ = _step(_refined(current, spacing))
        gain = current.chi2 - finer.chi2
        current = finer
        if gain < WORTH_REFINING:
            break
    return current


def _converged(current: Reference) -> Reference:
    for _ in range(STEPS):
        current, gain = _step(current)
        if gain < 1e-2 + 1e-4 * current.chi2 or _is_linear(current.observations):
            break
    return current


def _refined(current: Reference, spacing: float) -> Reference:
    """The same spectrum on a grid with further points on both sides of each spike."""
    log_tau = np.log(current.tau)
    spikes = log_tau[current.x[1:-1] > 0]
    further = (spikes[:, None] + spacing * np.array([-2.0, -1.0, 1.0, 2.0])).ravel()
    further = further[(further > log_tau[0]) & (further < log_tau[-1])]
    coarse = log_tau[:: max(1, log_tau.size // MOST_COARSE)]
    grid = np.unique(np.concatenate([coarse, spikes, further]))
    keep = np.concatenate([[True], np.diff(grid) > 1e-9])
    grid = np.unique(np.concatenate([grid[keep], spikes]))
    x = np.zeros(grid.size + 2)
    x[0], x[-1] = current.x[0], current.x[-1]
    x[1 + np.searchsorted(grid, spikes)] = current.x[1:-1][current.x[1:-1] > 0]
    return _reference(current.observations, np.exp(grid), x, current.q)


def _is_linear(observations: Observations) -> bool:
    return not observations.nuisance.gains and all(b.rig is None for b in observations.blocks)


def _first(observations: Observations, tau: Float) -> Reference:
    at = first_expansion(observations)
    strength = np.zeros(observations.nuisance.size)
    if observations.nuisance.amplitude is not None:
        # the stiffness found must go with the amplitude that was guessed
        strength[observations.nuisance.amplitude] = HELD
    problem = Linearisation(_held(observations, at.q, strength), at)
    raw = problem.raw_columns(tau)
    seen = _seen_at_once(observations, tau)
    x = np.zeros(seen.size)
    x[seen], _ = solve(problem.project(raw)[:, seen], problem.target)
    if not x.any():
        x[0] = 1e-9
    q = problem.nuisance_at(raw, x)
    place = observations.nuisance.amplitude
    if place is not None:
        if any((isinstance(b, Lines) and b.kind != ELECTRICAL) or isinstance(b, Curve) for b in observations.blocks):
            k = [
                _stiffness(x, tau, b.omega) if isinstance(b, Lines) else np.zeros(0, complex)
                for b in observations.blocks
            ]
            q[place] = np.log(amplitude_given(observations, k, q))
        else:
            q[place] = at.q[place]
    limit = np.where([n.startswith("log gain") for n in observations.nuisance.names], 1.0, 3.0)
    if place is not None:
        limit[place] = np.inf
    return _reference(observations, tau, x, np.clip(q, -limit, limit))


def _seen_at_once(observations: Observations, tau: Float) -> Bool:
    """Columns of the spectrum (k0, arms, c_inf) for the first pass, which takes the load cell as rigid.

    A curve then shows nothing of arms that are over before its first window: they would be given any stiffness.
    """
    shown = np.ones(tau.size + 2, bool)
    if all(isinstance(b, Curve) for b in observations.blocks):
        begins = min(1 / float(b.omega.max()) for b in observations.blocks if isinstance(b, Curve))
        shown[1:-1] = tau >= begins / 3
        shown[-1] = False
    return shown


def _held(observations: Observations, q: Float, strength: Float) -> Observations:
    """The same data with further prior rows that hold the nuisance parameters near q: standard deviations 1/strength."""
    chosen = np.flatnonzero(strength)
    rows = np.eye(q.size)[chosen] * strength[chosen, None]
    nuisance = observations.nuisance
    return replace(
        observations,
        nuisance=replace(
            nuisance,
            prior=np.vstack([nuisance.prior, rows]),
            target=np.concatenate([nuisance.target, strength[chosen] * q[chosen]]),
        ),
    )


def _step(current: Reference) -> tuple[Reference, float]:
    """One Gauss-Newton step, damped in the nuisance parameters (Levenberg) and shortened until χ² falls.

    Returns the new reference and the fall of χ².
    """
    observations = current.observations
    size = np.sqrt(max(current.chi2 / max(observations.data, 1.0), 1.0))
    for damping in DAMPING:
        held = _held(observations, current.q, np.full(current.q.size, damping * size))
        problem = Linearisation(held, current.expansion())
        raw = problem.raw_columns(current.tau)
        x, _ = solve(problem.project(raw), problem.target)
        if not x.any():  # the nuisance parameters alone explain it: too long a step for a film that has some stiffness
            continue
        q = problem.nuisance_at(raw, x)
        for share in (1.0, 0.3):
            change = share * (q - current.q)
            if np.abs(change).max(initial=0.0) > LARGEST_STEP:
                continue
            trial = _reference(observations, current.tau, current.x + share * (x - current.x), current.q + change)
            if trial.chi2 < current.chi2:
                return trial, current.chi2 - trial.chi2
    return current, 0.0


def _reference(observations: Observations, tau: Float, x: Float, q: Float) -> Reference:
    residuals = []
    draft = Reference(observations, tau, x, q, np.inf, np.zeros(0))
    for block in observations.blocks:
        if isinstance(block, Lines):
            value = observations.predict_lines(block, draft.stiffness(block.omega), q)[0]
            difference = (value - block.value) * block.weight
            residuals += [difference.real, difference.imag]
        else:
            theta, shape = draft.material()
            residuals.append((observations.predict_curve(block, theta, shape, q)[0] - block.value) * block.weight)
    residuals.append(observations.nuisance.prior @ q - observations.nuisance.target)
    residual = np.concatenate(residuals)
    return replace(draft, chi2=float(residual @ residual), residual=residual)


def _stiffness(x: Float, tau: Float, omega: Float) -> Complex:
    arms = x[1:-1] > 0
    return np.asarray(x[0] + debye(omega, tau[arms]) @ x[1:-1][arms] + 1j * omega * x[-1])


def with_estimated_noise(reference: Reference, unknown: frozenset[int]) -> Reference:
    """Weights of groups without variance scaled so that each group's χ² equals its degrees of freedom.

    The noise of such a group is taken as a constant share of the magnitude; its size is the misfit of the best relaxation of
    any order, so that a misfit of the relaxation model itself counts as noise and cannot raise the alarm.
    """
    observations = reference.observations
    for _ in range(2):
        factors = []
        chi2, count = np.zeros(len(observations.groups)), np.zeros(len(observations.groups))
        for group, squares in zip(*_squares(reference), strict=True):
            np.add.at(chi2, group, squares)
            np.add.at(count, group, 1.0)
        share = observations.data / max(sum(b.rows for b in observations.blocks), 1)
        freedom = np.maximum(share * count - reference.active * count / count.sum(), 1.0)
        scale = np.ones(len(observations.groups))
        for g in unknown:
            scale[g] = np.sqrt(max(chi2[g] / freedom[g], 1e-12))
        for block in observations.blocks:
            factors.append(1 / scale[block.group] * np.ones(block.weight.size))
        observations = observations.reweighted(factors)
        reference = find_reference(observations, reference)
    return reference


def _squares(reference: Reference) -> tuple[list[Int], list[Float]]:
    """Per block: group of each real row, and its squared weighted residual."""
    groups, squares = [], []
    start = 0
    for block in reference.observations.blocks:
        rows = reference.residual[start : start + block.rows] ** 2
        if isinstance(block, Lines):
            groups.append(np.tile(block.group, 2))
        else:
            groups.append(np.full(block.rows, block.group))
        squares.append(rows)
        start += block.rows
    return groups, squares


def refuse_hopeless(reference: Reference) -> None:
    """Raises `NotIdentifiableError` where even the best relaxation explains next to nothing of the response."""
    total = sum(float((np.abs(b.value * b.weight) ** 2).sum()) for b in reference.observations.blocks)
    if reference.chi2 < NOTHING * total:
        return
    real = np.concatenate([np.real(b.value) for b in reference.observations.blocks])
    negative = float(np.mean(real < 0))
    raise NotIdentifiableError(
        f"no relaxation comes near the response: {reference.chi2 / total:.0%} of it stays unexplained, the real part is "
        f"negative at {negative:.0%} of the lines",
        where=", ".join(reference.observations.groups[:3]),
        expected="a stiffness with positive real part at low frequency, above its noise",
        remedy="Check the polarity of force and displacement, the units, and whether anything was excited",
    )


def misfit_probability(chi2: float, freedom: float) -> float:
    """P(χ² ≥ chi2) at these degrees of freedom."""
    return float(chdtrc(freedom, chi2))
