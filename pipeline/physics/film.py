"""The Maxwell-Wiechert relaxation model: one definition of what its parameters mean.

Does not belong here: how the parameters are found (`varpro`, `forward`) or how sure they are (`intervals`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from schemas.arrays import Complex, Float


@dataclass(frozen=True)
class RelaxationModel:
    """k(jω) = k0 + Σ kᵢ jωτᵢ/(1 + jωτᵢ) + jω c_inf (generalised Maxwell model; thesis, eq 4.1 and 4.11 corrected).

    Parameters
    ----------
    k0 : N/mm, main spring
    k : (n,) N/mm, springs of the arms
    tau : (n,) s, relaxation times, longest first; the dampers are c = k τ in N s/mm
    c_inf : N s/mm, a pure dashpot beside the arms (an arm whose spring is rigid); 0 when there is none
    """

    k0: float
    k: tuple[float, ...]
    tau: tuple[float, ...]
    c_inf: float = 0.0

    def __post_init__(self) -> None:
        if len(self.k) != len(self.tau):
            raise ValueError(f"{len(self.k)} springs but {len(self.tau)} relaxation times")

    @property
    def order(self) -> int:
        """Number of arms, the pure dashpot included."""
        return len(self.k) + (self.c_inf > 0)

    @property
    def c(self) -> tuple[float, ...]:
        """(n,) N s/mm, dampers of the arms."""
        return tuple(k * t for k, t in zip(self.k, self.tau, strict=True))

    def stiffness(self, frequency_hz: ArrayLike) -> Complex:
        """Complex dynamic stiffness in N/mm at frequencies in Hz; shape of the input."""
        return np.asarray(stiffnesses((self,), frequency_hz)[0])

    def relaxation(self, time_s: ArrayLike) -> Float:
        """Relaxation function k0 + Σ kᵢ e^{−t/τᵢ} in N/mm at t > 0 in s. A pure dashpot has none (`ValueError`)."""
        if self.c_inf:
            raise ValueError("a model with a pure dashpot has no relaxation function")
        t = np.asarray(time_s, dtype=float)
        total = np.full(t.shape, self.k0)
        for k, tau in zip(self.k, self.tau, strict=True):
            total = total + k * np.exp(-t / tau)
        return np.asarray(total)


def stiffnesses(models: Sequence[RelaxationModel], frequency_hz: ArrayLike) -> Complex:
    """Complex dynamic stiffness in N/mm of several models with as many arms each, one by one along a first axis; else as above."""
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)

    def column(values: Iterable[float]) -> Float:
        return np.array(list(values)).reshape(-1, *[1] * omega.ndim)

    total = np.empty((len(models), *omega.shape), dtype=complex)
    total.real, total.imag = column(m.k0 for m in models), omega * column(m.c_inf for m in models)
    for i in range(len(models[0].k)):
        k, tau = column(m.k[i] for m in models), column(m.tau[i] for m in models)
        # In parts, for a complex division costs more than all the rest of it.
        turn = omega * tau
        loss = k * turn / (1 + turn**2)
        total.real += loss * turn
        total.imag += loss
    return total
