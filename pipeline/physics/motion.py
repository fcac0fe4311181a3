"""Film and rig in time: equations of motion of a film between driven end and clamp, and their exact solution.

Nothing here uses the formulas in frequency of `film` and `rig`: what one of them simulates, the other can be tested
with. Belongs here: linear mechanics. What drives it, and what the sensors make of it, does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eig, expm
from scipy.signal import lfilter

from pipeline.physics.film import RelaxationModel
from pipeline.physics.rig import Rig
from schemas.arrays import Float


@dataclass(frozen=True)
class StateSpace:
    """ẋ = A x + B u, y = C x + D u."""

    a: Float
    b: Float
    c: Float
    d: Float


def assemble(
    parts: Sequence[RelaxationModel], rig: Rig, *, active: int | None = None, watched: int | None = None
) -> StateSpace:
    """Equations of motion of film parts in series on clamp and load cell.

    Parameters
    ----------
    parts : films in series, from the driven end to the clamp; none: only clamp and load cell
    rig : constants of one rig, of finite stiffness; its gain is not looked at
    active : place of the part in which the Maxwell force acts
    watched : place of the part whose extension is an output

    Returns
    -------
    System with the inputs displacement of the driven end (mm) and Maxwell force (N), which lowers the tension; outputs
    are the force on the load cell (N, change from rest) and, with `watched`, the extension of that part (mm). Without
    any part the second input acts on the clamp itself (a tap, with the sign of a loss of tension).

    Raises
    ------
    ValueError
        A pure dashpot in a chain of several parts.

    Notes
    -----
    Part j with extension e_j and internal points q_ji: T = K_j e_j − Σ k_ji q_ji − F_A, q̇_ji = (e_j − q_ji)/τ_ji,
    K_j = k_j0 + Σ k_ji; the tension T is common, the extensions add up to x0 − x′, and M ẍ′ = T − kL x′ − cL ẋ′ (in
    place of thesis, eq 4.5 and 4.6, which do not close). The share of a pure dashpot in the velocity is taken into the
    state, so that the velocity of the driven end is never needed.
    """
    springs = [(j, k, tau) for j, part in enumerate(parts) for k, tau in _merged(part)]
    n = len(springs)
    dashpot = parts[0].c_inf if len(parts) == 1 else 0.0
    if len(parts) > 1 and any(part.c_inf for part in parts):
        raise ValueError("a pure dashpot needs a film of one part")
    mass, stiffness, damping, _ = rig.numbers

    # Rows over [q (n), x', w, x0, F_A]; the tension without the dashpot, then the extensions of the parts.
    width = n + 4
    at_clamp, at_end, at_maxwell = n, n + 2, n + 3
    tension = np.zeros(width)
    extensions = np.zeros((len(parts), width))
    if parts:
        instant = np.array([part.k0 + sum(part.k) for part in parts])
        pull = np.zeros((len(parts), width))
        for i, (j, k, _) in enumerate(springs):
            pull[j, i] = k
        if active is not None:
            pull[active, at_maxwell] = 1.0
        tension[at_end], tension[at_clamp] = 1.0, -1.0
        tension = (tension - (pull / instant[:, None]).sum(axis=0)) / (1 / instant).sum()
        extensions = (tension + pull) / instant[:, None]
    else:
        tension[at_maxwell] = -1.0

    velocity = np.zeros(width)
    velocity[n + 1], velocity[at_end] = 1.0, dashpot / mass
    rates = np.zeros((n + 2, width))
    for i, (j, _, tau) in enumerate(springs):
        rates[i] = extensions[j] / tau
        rates[i, i] -= 1 / tau
    rates[n] = velocity
    rates[n + 1] = (tension - (damping + dashpot) * velocity) / mass
    rates[n + 1, at_clamp] -= stiffness / mass
    outputs = np.zeros((1 if watched is None else 2, width))
    outputs[0, at_clamp] = stiffness
    if watched is not None:
        outputs[1] = extensions[watched]
    return StateSpace(rates[:, : n + 2], rates[:, n + 2 :], outputs[:, : n + 2], outputs[:, n + 2 :])


def _merged(part: RelaxationModel) -> list[tuple[float, float]]:
    """Springs and times of the arms; arms of one time are one arm (their sum), and arms without spring are none."""
    merged: dict[float, float] = {}
    for k, tau in zip(part.k, part.tau, strict=True):
        near = next((t for t in merged if abs(t - tau) <= 1e-9 * tau), tau)
        merged[near] = merged.get(near, 0.0) + k
    return [(k, tau) for tau, k in merged.items() if k > 0]


def integrate(system: StateSpace, inputs: Sequence[Float | None], interval_s: float) -> Float:
    """Outputs of a system from equilibrium with the first values of its inputs.

    Parameters
    ----------
    system : with a state that ends in position and velocity of the clamp, as `assemble` makes it
    inputs : (n,) each, straight lines between samples; None for one that stays 0
    interval_s : s from sample to sample

    Returns
    -------
    (outputs, n)

    Notes
    -----
    Exact for such inputs: the system is taken apart into its modes, each of which is a first-order recursion
    (first-order hold). Straight lines lower a sine of the frequency f by (2πf h)²/12: sample finely.
    """
    given = {i: np.asarray(u, dtype=np.float64) for i, u in enumerate(inputs) if u is not None}
    static = system.d - system.c @ np.linalg.solve(system.a, system.b)
    # In balanced units (the velocity over a typical rate) the eigenvectors are well conditioned.
    scale = np.ones(system.a.shape[0])
    scale[-1] = max(float(np.sqrt(np.abs(system.a[-1, -2]))), 1.0)
    values, vectors = eig(system.a * scale[None, :] / scale[:, None])
    into = np.linalg.solve(vectors, (system.b / scale[:, None]).astype(complex))
    out = (system.c * scale[None, :]) @ vectors

    outputs = np.zeros((system.c.shape[0], next(iter(given.values())).size))
    for column, signal in given.items():
        change = signal - signal[0]
        for row in range(outputs.shape[0]):
            outputs[row] += static[row, column] * signal[0]
            if system.d[row, column]:
                outputs[row] += system.d[row, column] * change
            for i, value in enumerate(values):
                if value.imag >= 0:
                    residue = out[row, i] * into[i, column] * interval_s
                    outputs[row] += lfilter(*_recursion(value * interval_s, residue), change)
    return outputs


def _recursion(step: complex, residue: complex) -> tuple[list[float], list[float]]:
    """Numerator and denominator of one mode, or of a pair of conjugate ones, driven by straight lines."""
    pole, first, second = _hold(step)
    if step.imag == 0:
        return [(residue * second).real, (residue * first).real], [1.0, -pole.real]
    back = pole.conjugate()
    numerator = [residue * second, residue * (first - second * back), -residue * first * back]
    return [2 * n.real for n in numerator], [1.0, -2 * pole.real, abs(pole) ** 2]


def _hold(step: complex) -> tuple[complex, complex, complex]:
    """e^L and the weights of the first and the second sample of a straight line over a step, L = eigenvalue × step."""
    if abs(step) < 1e-2:
        # Series of (e^L − 1)/L and (e^L − 1 − L)/L²: the closed forms lose digits here.
        one = sum(step**n / _factorial(n + 1) for n in range(8))
        two = sum(step**n / _factorial(n + 2) for n in range(8))
    else:
        one = (np.exp(step) - 1) / step
        two = (np.exp(step) - 1 - step) / step**2
    return complex(np.exp(step)), complex(one - two), complex(two)


def _factorial(n: int) -> float:
    return float(np.prod(np.arange(1, n + 1), dtype=float)) if n else 1.0


@dataclass(frozen=True)
class Propagator:
    """The same exact solution for a block of `samples` intervals at once, for a loop that decides between blocks.

    x_end = `advance` x_start + `gather` u, u (samples + 1,) the single input at both ends and in between.
    """

    advance: Float
    gather: Float

    @classmethod
    def of(cls, system: StateSpace, column: int, interval_s: float, samples: int) -> Propagator:
        """Block propagator for the input `column` of the system."""
        n = system.a.shape[0]
        block = np.zeros((n + 2, n + 2))
        block[:n, :n] = system.a * interval_s
        block[:n, n] = system.b[:, column] * interval_s
        block[n, n + 1] = 1.0
        whole = expm(block)
        phi, one, two = whole[:n, :n], whole[:n, n], whole[:n, n + 1]
        gather = np.zeros((n, samples + 1))
        for i in range(samples):
            gather = phi @ gather
            gather[:, i] += one - two
            gather[:, i + 1] += two
        return cls(np.linalg.matrix_power(phi, samples), gather)
