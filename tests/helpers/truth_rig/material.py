"""Random films and rigs around tables 4.2 and 4.3 of the thesis, with a rig file that says nominal values ± sd.

The truth lies within the file's standard deviations unless an effect moves it. Does not belong here: tests, effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

EPSILON_0_N_PER_KV2 = 8.8541878e-6
EPSILON_0_PF_PER_MM = 8.8541878e-3
NOMINAL_GAIN_KV_PER_V = 1.5


@dataclass(frozen=True)
class Film:
    """Film as stretched on the rig: spring `k0` N/mm, arms `k` N/mm with relaxation times `tau` s, longest first."""

    k0: float
    k: tuple[float, ...]
    tau: tuple[float, ...]

    def stiffness(self, frequency_hz: Float) -> Complex:
        """k(jω) in N/mm, shape as given."""
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
        total = np.full(s.shape, self.k0, dtype=complex)
        for k, tau in zip(self.k, self.tau, strict=True):
            total += k * s * tau / (1 + s * tau)
        return total

    def relaxation(self, time_s: Float) -> Float:
        """Relaxation function in N/mm, shape as given."""
        t = np.asarray(time_s, dtype=float)
        return self.k0 + sum((k * np.exp(-t / tau) for k, tau in zip(self.k, self.tau, strict=True)), np.zeros(t.shape))


@dataclass(frozen=True)
class Rig:
    """Clamp and load cell: mass N s²/mm, stiffness N/mm, damping N s/mm; amplifier kV/V."""

    mass: float
    stiffness: float
    damping: float
    amplifier_gain: float

    @property
    def clamp_frequency_hz(self) -> float:
        return math.sqrt(self.stiffness / self.mass) / (2 * math.pi)


@dataclass(frozen=True)
class Specimen:
    """One film on one rig as it truly is, and what the files say about it.

    `rig_file` has keys of the contract's `rig` block, `geometry` keys of its `recording` block. `preload_margin` is the
    preload over the largest fall of tension in the plain session, `noise_share` the force noise over the cell's range,
    `pink_share` the share of the noise variance that is 1/f.
    """

    name: str
    kind: str
    film: Film
    rig: Rig
    rig_file: Mapping[str, float]
    geometry: Mapping[str, Any]
    permittivity: float
    preload_margin: float = 1.3
    noise_share: float = 6e-5
    pink_share: float = 0.25

    @property
    def length_mm(self) -> float:
        """Stretched length between the clamps."""
        return float(self.geometry["total_length_mm"])

    @property
    def thickness_mm(self) -> float:
        """Stretched thickness of a uniaxially stretched film."""
        return float(self.geometry["film_thickness_mm"]) / math.sqrt(float(self.geometry["stretch_1"]))

    @property
    def force_per_voltage_squared(self) -> float:
        """Drop of tension per voltage squared at the ends of the film held at fixed length, N/kV²."""
        g = self.geometry
        share = float(g["active_length_mm"]) / self.length_mm
        return EPSILON_0_N_PER_KV2 * self.permittivity * float(g["active_width_mm"]) / self.thickness_mm * share

    @property
    def rest_capacitance_pf(self) -> float:
        g = self.geometry
        area = float(g["sensing_length_mm"]) * float(g["sensing_width_mm"])
        return EPSILON_0_PF_PER_MM * self.permittivity * area / self.thickness_mm


_TABLES: Mapping[str, tuple[float, tuple[float, ...], tuple[float, ...]]] = {
    "polyacrylate": (1.00, (1.50, 2.00, 30.0), (0.0333, 0.0100, 6.67e-4)),
    "stack": (0.40, (0.40, 1.00, 50.0), (2.5, 0.100, 1.0e-3)),
    "silicone": (0.29, (0.30,), (4.67e-4,)),
}
MATERIALS: tuple[str, ...] = tuple(_TABLES)
"""Films of table 4.3 (polyacrylate third order, silicone first order) and table 4.2 (the stack, third order)."""
_PERMITTIVITY = {"polyacrylate": 4.7, "stack": 4.7, "silicone": 2.8}
_SD = {"clamp_mass_kg": 0.02, "load_cell_stiffness_n_per_mm": 0.02, "load_cell_damping_n_s_per_mm": 0.3}
_LARGEST_DRAW = 2.0


def _within(rng: np.random.Generator) -> float:
    """A standard normal number cut at ± 2: what a laboratory states as sd is not broken by its own rig."""
    return float(np.clip(rng.normal(), -_LARGEST_DRAW, _LARGEST_DRAW))


def random_film(kind: str, rng: np.random.Generator) -> Film:
    """A film around the thesis' one: springs scatter by 20 %, the whole by 15 %, times by 25 %."""
    k0, k, tau = _TABLES[kind]
    whole = math.exp(0.15 * _within(rng))
    times = [t * math.exp(0.25 * _within(rng)) for t in tau]
    springs = [spring * whole * math.exp(0.2 * _within(rng)) for spring in k]
    arms = sorted(zip(times, springs, strict=True), reverse=True)
    return Film(k0 * whole * math.exp(0.1 * _within(rng)), tuple(s for _, s in arms), tuple(t for t, _ in arms))


def random_specimen(rng: np.random.Generator, *, kind: str | None = None, name: str = "S-1") -> Specimen:
    """A specimen on a rig whose clamp alone rings at 45 to 60 Hz on a cell of 6 to 35 N/mm."""
    if kind is None:
        kind = str(rng.choice(np.asarray(MATERIALS)))
    if kind not in _TABLES:
        raise ValueError(f"no material {kind!r}; there are {', '.join(_TABLES)}")
    film = random_film(kind, rng)
    stiffness = math.exp(rng.uniform(math.log(6.0), math.log(35.0)))
    omega = 2 * math.pi * rng.uniform(46.0, 60.0)
    mass = stiffness / omega**2
    damping = 2 * rng.uniform(0.004, 0.008) * math.sqrt(stiffness * mass)
    stated = {
        "clamp_mass_kg": 1e3 * mass,
        "load_cell_stiffness_n_per_mm": stiffness,
        "load_cell_damping_n_s_per_mm": damping,
    }
    stated = {key: value / (1 + _SD[key] * _within(rng)) for key, value in stated.items()}
    rig_file = {key: float(f"{value:.4g}") for key, value in stated.items()}
    rig_file |= {f"{key}_sd": float(f"{_SD[key] * value:.3g}") for key, value in stated.items()}
    rig_file |= {"amplifier_gain_kv_per_v": NOMINAL_GAIN_KV_PER_V, "amplifier_gain_kv_per_v_sd": 0.003}
    stretch = round(rng.uniform(1.35, 1.8), 2)
    length = round(rng.uniform(25.0, 35.0), 1)
    total = round(length * stretch, 1)
    nominal = _PERMITTIVITY[kind]
    geometry = {
        "film_length_mm": length,
        "film_width_mm": 50.0,
        "film_thickness_mm": 0.6 if kind == "silicone" else 1.0,
        "stretch_1": stretch,
        "layers": 1,
        "active_length_mm": round(0.4 * total, 1),
        "active_width_mm": 40.0,
        "active_drawn": "stretched",
        "sensing_length_mm": round(0.25 * total, 1),
        "sensing_width_mm": 30.0,
        "total_length_mm": total,
        "relative_permittivity": nominal,
        "relative_permittivity_sd": 0.1 * nominal,
    }
    return Specimen(
        name=name,
        kind=kind,
        film=film,
        rig=Rig(mass, stiffness, damping, NOMINAL_GAIN_KV_PER_V * (1 + 0.002 * _within(rng))),
        rig_file=rig_file,
        geometry=geometry,
        permittivity=nominal * (1 + 0.07 * _within(rng)),
        preload_margin=float(rng.uniform(1.15, 1.5)),
        noise_share=float(math.exp(rng.uniform(math.log(4e-5), math.log(1e-4)))),
        pink_share=float(rng.uniform(0.1, 0.4)),
    )
