"""Curves from the parameters in `model_fits`: what the pages draw through the measured points.

Evaluation only, from the table's own columns, so that pages can be rebuilt from the database without the analysis code.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from schemas.arrays import Complex, Float
from schemas.tables import ARMS


@dataclass(frozen=True)
class Arm:
    """One arm of a stored model: spring in N/mm (None: rigid, a pure dashpot) and damper in N s/mm."""

    k: float | None
    c: float

    @property
    def tau(self) -> float | None:
        """Relaxation time c/k in s; a pure dashpot has none."""
        return self.c / self.k if self.k else None


def arms(row: Mapping[str, Any]) -> tuple[Arm, ...]:
    """The arms of a row of `model_fits`, longest relaxation first as stored."""
    found = ((row[f"k{i}_n_per_mm"], row[f"c{i}_n_s_per_mm"]) for i in range(1, ARMS + 1))
    return tuple(Arm(k, c) for k, c in found if c is not None)


def stiffness(row: Mapping[str, Any], frequency_hz: ArrayLike) -> Complex:
    """k(jω) = k0 + Σ kᵢ cᵢ jω/(kᵢ + cᵢ jω) in N/mm at frequencies (n,) in Hz (thesis, eq 4.11 corrected).

    An arm without spring is a dashpot and adds jω c.
    """
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
    total = np.full(s.shape, complex(row["k0_n_per_mm"] or 0.0))
    for arm in arms(row):
        total = total + (s * arm.c if arm.k is None else arm.k * arm.c * s / (arm.k + arm.c * s))
    return np.asarray(total)


@dataclass(frozen=True)
class Rig:
    """Clamp and load cell: mass in kg, stiffness in N/mm, damping in N s/mm."""

    clamp_mass_kg: float
    load_cell_stiffness: float
    load_cell_damping: float

    def _cell(self, frequency_hz: ArrayLike) -> Complex:
        w = 2 * np.pi * np.asarray(frequency_hz, dtype=float)
        return np.asarray(self.load_cell_stiffness - 1e-3 * self.clamp_mass_kg * w**2 + 1j * w * self.load_cell_damping)

    def recorded(self, k: Complex, frequency_hz: ArrayLike) -> Complex:
        """G = F/x0 = k kL/(k + kL − Mω² + jωcL): what the load cell shows of a film of stiffness k (n,)."""
        return np.asarray(k * self.load_cell_stiffness / (k + self._cell(frequency_hz)))

    def actuated(self, k: Complex, frequency_hz: ArrayLike) -> Complex:
        """H/(F_A/V²) = kL/(k + kL − Mω² + jωcL): share of the actuation force that the load cell shows."""
        return np.asarray(self.load_cell_stiffness / (k + self._cell(frequency_hz)))

    @property
    def resonance_hz(self) -> float:
        """Frequency of the clamp alone on the load cell, √(kL/M)/2π; infinite without mass."""
        mass = 1e-3 * self.clamp_mass_kg
        return float(np.sqrt(self.load_cell_stiffness / mass) / (2 * np.pi)) if mass else float("inf")


def rig(row: Mapping[str, Any], stated: Mapping[str, Any]) -> Rig | None:
    """Rig constants: fitted ones where the fit has them, else those stated with the recording; None without stiffness."""

    def constant(name: str) -> float | None:
        for source in (row, stated):
            try:
                return float(source[name])
            except (KeyError, TypeError, ValueError):
                continue
        return None

    cell = constant("load_cell_stiffness_n_per_mm")
    if not cell:
        return None
    return Rig(constant("clamp_mass_kg") or 0.0, cell, constant("load_cell_damping_n_s_per_mm") or 0.0)


@dataclass(frozen=True)
class Covariance:
    """Covariance (p, p) of the logarithms of the parameters `k0`, `k1`…, `tau1`…, `c3` (a dashpot), by name."""

    names: tuple[str, ...]
    matrix: Float

    def sd(self, name: str) -> float | None:
        """Standard deviation of the logarithm of that parameter; None where it was not fitted or not resolved."""
        if name not in self.names:
            return None
        i = self.names.index(name)
        sd = float(np.sqrt(max(self.matrix[i, i], 0.0)))
        return sd if np.isfinite(sd) and sd < _UNRESOLVED else None


_UNRESOLVED = 1.0
"""A logarithm's standard deviation from which on a ± says nothing."""


def covariance(row: Mapping[str, Any]) -> Covariance | None:
    """The stored covariance of a fit; None where there is none."""
    try:
        stored = json.loads(row["covariance"] or "null")
        names = tuple(str(n).removeprefix("log ") for n in stored["names"])
        matrix = np.asarray(stored["matrix"], dtype=float)
    except (ValueError, KeyError, TypeError):
        return None
    return Covariance(names, matrix) if matrix.shape == (len(names), len(names)) and matrix.size else None


def relaxation_time_sd(row: Mapping[str, Any], arm: int) -> float | None:
    """Standard deviation of the relaxation time of an arm (from 1), s."""
    found, tau = covariance(row), arms(row)[arm - 1].tau
    sd = found.sd(f"tau{arm}") if found else None
    return None if sd is None or tau is None else tau * sd


def band(row: Mapping[str, Any], frequency_hz: Float) -> Float | None:
    """Standard deviations of |k| in N/mm and of arg k in rad, (2, n), linearised from the stored covariance.

    None where none is stored. With z = jωτ: ∂k/∂ln k0 = k0, ∂k/∂ln kᵢ = kᵢ z/(1 + z), ∂k/∂ln τᵢ = kᵢ z/(1 + z)²,
    ∂k/∂ln c = jωc for a pure dashpot. Parameters of the rig do not move k.
    """
    found = covariance(row)
    if found is None:
        return None
    s = 2j * np.pi * frequency_hz
    slopes = np.zeros((len(found.names), frequency_hz.size), dtype=complex)
    moves = {"k0": np.full(s.shape, complex(row["k0_n_per_mm"] or 0.0))}
    for i, arm in enumerate(arms(row), 1):
        if arm.k is None:
            moves[f"c{i}"] = s * arm.c
            continue
        z = s * arm.c / arm.k
        moves |= {f"k{i}": arm.k * z / (1 + z), f"tau{i}": arm.k * z / (1 + z) ** 2}
    for j, name in enumerate(found.names):
        slopes[j] = moves.get(name, 0.0)
    k = stiffness(row, frequency_hz)
    parts = np.stack([(slopes * k.conj()).real / np.abs(k), (slopes / k).imag], axis=1)
    variance = np.einsum("iqf,ij,jqf->qf", parts, found.matrix, parts)
    return np.asarray(np.sqrt(np.clip(variance, 0, None)))
