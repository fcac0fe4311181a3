"""Truths for the tests of the fits: responses written out in closed form and integrated in time, noise drawn here.

Nothing of the package's models is used.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import FORCE_PER_VOLTAGE_SQUARED, STIFFNESS, FrequencyResponse
from schemas.metadata import RigConstants

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

BAND = np.logspace(0, 2, 100)
SLOW_BAND = np.logspace(-2, np.log10(5), 30)
ACRYLATE = (1.0, (1.5, 2.0, 30.0), (0.05, 0.02, 0.02))  # thesis, table 4.3, third order
STACK = (0.4, (0.4, 1.0, 50.0), (1.0, 0.1, 0.05))  # thesis, table 4.2, third order
SILICONE = (0.29, (0.30,), (1.4e-4,))
CELL, CLAMP_HZ = 20.0, 52.0
MASS = CELL / (2 * np.pi * CLAMP_HZ) ** 2  # tonnes
DAMPING = 2 * 0.005 * np.sqrt(CELL * MASS)


def film(f: Float, model: tuple[float, tuple[float, ...], tuple[float, ...]]) -> Complex:
    """Springs ki in series with dampers ci, all parallel to k0."""
    s = 2j * np.pi * np.asarray(f, dtype=float)
    return model[0] + sum(k * c * s / (k + c * s) for k, c in zip(model[1], model[2], strict=True))


def mechanical(f: Float, k: Complex, mass: float = MASS, cell: float = CELL, damping: float = DAMPING) -> Complex:
    w = 2 * np.pi * np.asarray(f)
    return k * cell / (k + cell - mass * w**2 + 1j * w * damping)


def electrical(f: Float, k: Complex, force_per_v2: float, mass: float = MASS, cell: float = CELL) -> Complex:
    w = 2 * np.pi * np.asarray(f)
    return force_per_v2 * cell / (k + cell - mass * w**2 + 1j * w * DAMPING)


def rig(mass_factor: float = 1.0, **changes: float) -> RigConstants:
    """The rig file of these tests: mass ± 3 %, stiffness ± 2 %, damping ± 100 %."""
    values = {
        "clamp_mass_kg": 1e3 * MASS * mass_factor,
        "clamp_mass_kg_sd": 0.03e3 * MASS,
        "load_cell_stiffness_n_per_mm": CELL,
        "load_cell_stiffness_n_per_mm_sd": 0.02 * CELL,
        "load_cell_damping_n_s_per_mm": DAMPING,
        "load_cell_damping_n_s_per_mm_sd": DAMPING,
    }
    return RigConstants(**(values | changes))


def response(
    f: Float,
    value: Complex,
    rng: np.random.Generator | None,
    *,
    relative: float = 0.01,
    quantity: str = STIFFNESS,
    recording_id: str = "r1",
    amplitude: float | None = None,
    variance: bool = True,
) -> FrequencyResponse:
    """A response with √E|ΔG|² = relative · |G|; without noise when `rng` is None."""
    f = np.atleast_1d(np.asarray(f, dtype=float))
    value = np.atleast_1d(value)
    sd = relative * np.abs(value)
    if rng is not None:
        value = value + sd / np.sqrt(2) * (rng.normal(size=f.size) + 1j * rng.normal(size=f.size))
    return FrequencyResponse(
        frequency_hz=f,
        value=value,
        variance=sd**2 if variance else np.full(f.size, np.nan),
        usable=np.ones(f.size, dtype=bool),
        quantity=quantity,
        loading="mechanical" if quantity == STIFFNESS else "electrical",
        recording_id=recording_id,
        specimen_id="film-1",
        amplitude=amplitude,
    )


def electrical_response(
    f: Float, value: Complex, rng: np.random.Generator | None, **options: object
) -> FrequencyResponse:
    return response(f, value, rng, quantity=FORCE_PER_VOLTAGE_SQUARED, **options)  # type: ignore[arg-type]


def relaxation_force(
    time: Float, model: tuple[float, tuple[float, ...], tuple[float, ...]], ramp: float, cell: float | None
) -> Float:
    """Force over final displacement after a ramp, by integration of the springs and dampers (adaptive, 1e-10)."""
    k0, k, c = model[0], np.array(model[1]), np.array(model[2])

    def rate(t: float, f: Float) -> Float:
        pull = 1 / ramp if t < ramp else 0.0
        if cell is None:
            return k * pull - f * k / c
        # extension e of the film: cell (x0 − e) = k0 e + Σ f, with ḟ = k ė − f k/c
        extension = (cell * pull + (f * k / c).sum()) / (cell + k0 + k.sum())
        return k * extension - f * k / c

    def force(t: Float, f: Float) -> Float:
        x = np.minimum(t / ramp, 1.0)
        if cell is None:
            return k0 * x + f.sum(axis=0)
        extension = (cell * x - f.sum(axis=0)) / (cell + k0)
        return cell * (x - extension)

    options = {"rtol": 1e-10, "atol": 1e-13, "dense_output": True}
    up = solve_ivp(rate, (0, ramp), np.zeros(k.size), max_step=ramp / 20, **options)
    held = solve_ivp(rate, (ramp, time.max() * 1.01), up.y[:, -1], method="LSODA", **options)
    return np.where(
        time <= ramp, force(time, up.sol(np.minimum(time, ramp))), force(time, held.sol(np.maximum(time, ramp)))
    )


def relaxation_curve(
    model: tuple[float, tuple[float, ...], tuple[float, ...]],
    rng: np.random.Generator,
    *,
    ramp: float = 0.05,
    until: float = 100.0,
    cell: float | None = None,
    relative: float = 0.003,
) -> RelaxationCurve:
    """Means over 40 log-spaced windows, with noise."""
    edges = np.geomspace(1.1 * ramp, until, 41)
    window = np.stack([edges[:-1], edges[1:]], axis=1)
    nodes = np.linspace(edges[:-1], edges[1:], 101)
    clean = relaxation_force(nodes.ravel(), model, ramp, cell).reshape(nodes.shape)
    value = np.trapezoid(clean, nodes, axis=0) / np.diff(window, axis=1)[:, 0]
    sd = relative * value
    return RelaxationCurve(
        time_s=window.mean(axis=1),
        window_s=window,
        stiffness=value + sd * rng.normal(size=40),
        variance=sd**2,
        usable=np.ones(40, dtype=bool),
        ramp_s=ramp,
        step=2.0,
        rest_variance=1e-8,
        step_sd=1e-4,
        unusable_because=("",) * 40,
        quantity=STIFFNESS,
        recording_id="step-1",
        specimen_id="film-1",
    )
