"""Films whose shifts over temperature are known: written out in closed form, noise drawn here.

The relaxation is a power law of fractional order between two plateaus (Cole and Cole), whose spectrum is continuous: no sum
of springs and dashpots, and nothing of the code under test.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.transform.superposition_fit import Isotherm

Float = NDArray[np.float64]
C1, C2, REFERENCE = 8.0, 150.0, 25.0
TEMPERATURES = (0.0, 10.0, 25.0, 40.0, 60.0)
PLATEAU, RISE, TIME, ORDER = 0.2, 2.0, 0.01, 0.45
"""N/mm, N/mm, s at the reference, and the fractional order."""


def log_shift(temperature_c: float) -> float:
    """log10 a_T of the law above."""
    rise = temperature_c - REFERENCE
    return -C1 * rise / (C2 + rise)


def cole_cole(omega: Float, temperature_c: float, *, second: float = 0.0) -> NDArray[np.complex128]:
    """Complex stiffness (n,) at (n,) rad/s. `second`: N/mm of another process, which does not move with temperature."""
    z = (1j * omega * 10 ** log_shift(temperature_c) * TIME) ** ORDER
    other = 1j * omega * 0.05
    return np.asarray(PLATEAU + RISE * z / (1 + z) + second * other / (1 + other))


def frequency_isotherms(
    rng: np.random.Generator,
    *,
    temperatures: Sequence[float] = TEMPERATURES,
    frequency_hz: Float | None = None,
    magnitude_noise: float = 0.01,
    phase_noise: float = 0.003,
    parts_noise: float = 0.0,
    second: float = 0.0,
    vertical: float = 0.0,
) -> list[Isotherm]:
    """Responses with relative noise of the magnitude and noise of the phase in rad, or relative noise of storage and loss.

    `vertical`: ln b per 100 K.
    """
    frequency = np.geomspace(0.1, 50.0, 19) if frequency_hz is None else frequency_hz
    found = []
    for temperature in temperatures:
        value = cole_cole(2 * np.pi * frequency, temperature, second=second)
        value = value * np.exp(vertical * (temperature - REFERENCE) / 100)
        noise = rng.normal(size=(4, frequency.size))
        value = value * np.exp(magnitude_noise * noise[0] + 1j * phase_noise * noise[1])
        value = value.real * (1 + parts_noise * noise[2]) + 1j * value.imag * (1 + parts_noise * noise[3])
        unknown = np.full(frequency.size, np.nan)
        found.append(Isotherm(temperature, frequency, value, unknown, recording_id=f"sweep-{temperature:g}"))
    return found


def relaxation_isotherms(rng: np.random.Generator, *, noise: float = 0.003) -> list[Isotherm]:
    """Relaxations from 1 to 1000 s; the Mittag-Leffler function by its series, where it converges, and its tail."""
    time = np.geomspace(1.0, 1000.0, 19)
    found = []
    for temperature in TEMPERATURES:
        argument = (time / (100.0 * 10 ** log_shift(temperature))) ** ORDER
        value = (PLATEAU + RISE * _mittag_leffler(argument)) * (1 + noise * rng.normal(size=time.size))
        found.append(Isotherm(temperature, time, value, np.full(time.size, np.nan), in_time=True))
    return found


def _mittag_leffler(x: Float) -> Float:
    """E_α(−x) (n,) for α = `ORDER`, from its spectrum: an integral over rates, by the trapezoidal rule in their logarithm."""
    log_rate = np.linspace(-60.0, 60.0, 4001)
    rate = np.exp(log_rate)
    weight = (
        np.sin(np.pi * ORDER)
        / np.pi
        * rate**ORDER
        / (1 + 2 * rate**ORDER * np.cos(np.pi * ORDER) + rate ** (2 * ORDER))
    )
    return np.asarray(np.trapezoid(weight * np.exp(-np.multiply.outer(x ** (1 / ORDER), rate)), log_rate, axis=1))
