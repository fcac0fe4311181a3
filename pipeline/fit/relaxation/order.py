"""How many arms do the data carry? Likelihood-ratio test n against n + 1, with BIC and the held-out error beside it.

The usual χ² reference is wrong here: under the null the extra arm's spring is at its bound 0 and its relaxation time means
nothing. To first order the likelihood ratio is max over τ of Z(τ)₊², with Z a Gaussian process of unit variance whose
correlation is that of the columns φ(τ) left over when everything the smaller model can explain is projected out. Its tail
is known (Davies 1987; the tube formula of Hotelling and Weyl, with the end points counted once):

    P(Λ > x) ≈ ½ P(χ²₁ > x) + L/(2π) e^{−x/2},      L = length of the curve of normalised columns on the unit sphere

so that the test is calibrated for the very lines, noise, rig and model in hand, without a bootstrap. A parametric bootstrap with
full fits agrees: under seven nulls p falls below 1, 5 and 20 % in 1.1, 4.4 and 15.7 % of 1050 draws
(python -m tests.studies.study_fit order).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import erfc

from pipeline.fit.relaxation.forward import Solution
from pipeline.fit.relaxation.linear import Expansion, Linearisation
from pipeline.fit.relaxation.observations import Lines, Observations
from pipeline.physics.film import stiffness_and_slopes
from schemas.arrays import Float, Int
from schemas.numbers import p_equals

LEVEL = 0.01
"""Level of the test."""
PER_DECADE = 8


def expansion_at(observations: Observations, solution: Solution) -> Expansion:
    """Expansion about a fitted model."""
    k = tuple(
        stiffness_and_slopes(solution.theta, solution.shape, b.omega)[0] if isinstance(b, Lines) else None
        for b in observations.blocks
    )
    return Expansion(k, solution.q, (solution.theta, solution.shape))


def arc_length(observations: Observations, solution: Solution, log_tau_bounds: tuple[float, float]) -> float:
    """L: length of the curve of what an added arm would contribute, over its relaxation time, as an angle in rad."""
    low, high = log_tau_bounds
    count = int(np.ceil((high - low) / np.log(10) * PER_DECADE)) + 1
    problem = Linearisation(observations, expansion_at(observations, solution))
    columns = problem.raw_columns(np.exp(np.linspace(low, high, count)))[:, 1:]
    return arc_of(columns[:, np.r_[columns.shape[1] - 1, 0 : columns.shape[1] - 1]], solution.jacobian)


def arc_of(columns: Float, jacobian: Float) -> float:
    """Length in rad of the curve that columns (R, K) run through, one after the other, with what a model's `jacobian` (R, p) explains
    taken out."""
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    scale = np.linalg.norm(jacobian, axis=0)
    q, r = np.linalg.qr(jacobian / np.where(scale > 0, scale, 1.0))
    q = q[:, np.abs(np.diag(r)) > 1e-12]
    left = columns - q @ (q.T @ columns)
    left -= q @ (q.T @ left)
    norm = np.linalg.norm(left, axis=0)
    left = left[:, norm > 1e-9] / norm[norm > 1e-9]
    cosine = np.clip(np.einsum("ij,ij->j", left[:, 1:], left[:, :-1]), -1, 1)
    return float(np.arccos(cosine).sum())


def tail_probability(ratio: float, length: float) -> float:
    """P(Λ > ratio) when the smaller model is true."""
    if ratio <= 0:
        return 1.0
    tube = length / (2 * np.pi) * np.exp(-ratio / 2)
    return float(min(1.0, 0.5 * erfc(np.sqrt(ratio / 2)) + tube))


def bic(chi2: float, dispersion: float, parameters: int, data: float) -> float:
    """χ²/dispersion + p ln N: −2 ln L + p ln N up to a constant that all orders share. N independent real data."""
    return chi2 / dispersion + parameters * float(np.log(max(data, 2.0)))


def held_out_error(observations: Observations, solution: Solution) -> float:
    """Root mean square error on data left out, in standard deviations of the noise.

    One recording group at a time where there are several and the others reach over the same frequencies, else one line at a
    time. Leaving data out changes the optimum by one
    Gauss-Newton step, which needs no new fit: the error is (1 − H)⁻¹ r with H the part of the hat matrix that belongs to the
    data left out. NaN where the rest cannot determine the model.
    """
    j, r = solution.jacobian, solution.residual
    scale = np.linalg.norm(j, axis=0)
    j = j / np.where(scale > 0, scale, 1.0)
    total = j.T @ j + 1e-12 * np.eye(j.shape[1])
    if len(observations.groups) > 1 and _overlapping(observations):
        error = _left_out(j, r, total, _labels(observations, by_group=True))
        if np.isfinite(error):
            return error
    return _left_out(j, r, total, _labels(observations, by_group=False))


def _left_out(j: Float, r: Float, total: Float, labels: Int) -> float:
    rows, count = labels.size, int(labels.max()) + 1
    order = np.argsort(labels, kind="stable")
    sizes = np.bincount(labels, minlength=count)
    if (sizes == sizes[0]).all() and sizes[0] <= 2:
        parts = order.reshape(count, int(sizes[0]))
        unit = np.eye(int(sizes[0]))
        leverage = j[parts] @ np.linalg.solve(total, j[parts].transpose(0, 2, 1))
        error = np.linalg.solve((1 + 1e-9) * unit - leverage, r[parts][:, :, None])
        return float(np.sqrt((error**2).sum() / rows))
    squares = 0.0
    for label in range(count):
        part = np.flatnonzero(labels == label)
        own = j[part]
        remaining = total - own.T @ own
        if np.linalg.cond(remaining) > 1e11:
            return float("nan")
        left = r[part] + own @ np.linalg.solve(remaining, own.T @ r[part])
        squares += float(left @ left)
    return float(np.sqrt(squares / rows))


def _overlapping(observations: Observations) -> bool:
    """Whether each group lies within the frequencies of the others, but for a fifth of its values."""
    values: dict[int, list[Float]] = {}
    for block in observations.blocks:
        group = np.broadcast_to(block.group, block.omega.shape)
        for g in np.unique(group):
            values.setdefault(int(g), []).append(block.omega[group == g])
    own = {g: np.concatenate(parts) for g, parts in values.items()}
    for g, omega in own.items():
        others = np.concatenate([o for h, o in own.items() if h != g])
        inside = (omega >= 0.99 * others.min()) & (omega <= 1.01 * others.max())
        if inside.mean() < 0.8:
            return False
    return True


def _labels(observations: Observations, *, by_group: bool) -> Int:
    """Per real data row: which part is left out with it."""
    labels: list[Int] = []
    start = 0
    for block in observations.blocks:
        m = block.weight.size
        if by_group:
            own = np.asarray(block.group) * np.ones(m, dtype=np.int64)
        else:
            own = start + np.arange(m)
        labels.append(np.tile(own, 2) if isinstance(block, Lines) else own)
        start += m
    _, numbered = np.unique(np.concatenate(labels), return_inverse=True)
    return np.asarray(numbered, dtype=np.int64)


def describe_end(order: int, p_value: float) -> str:
    """Says that an order was chosen because none above it was tried, not because it is enough."""
    return f"order {order + 1} would fit better still ({p_equals(p_value)}); none above {order} was tried"


def choose(
    orders: Sequence[int],
    p_values: Mapping[int, float | None],
    bics: Mapping[int, float],
    held_out: Mapping[int, float | None],
) -> dict[str, int]:
    """What each rule chooses among `orders` (ascending).

    `test`: the smallest order that is not rejected against the next; the largest where all are. `bic` and `held_out`: the
    smallest value.
    """
    test = next((n for n in orders if (p_values.get(n) or 0.0) >= LEVEL), orders[-1])
    chosen = {"test": test, "bic": min(orders, key=lambda n: bics[n])}
    errors = {n: held_out.get(n) for n in orders}
    known = {n: e for n, e in errors.items() if e is not None and np.isfinite(e)}
    if known:
        chosen["held_out"] = min(known, key=lambda n: known[n])
    return chosen
