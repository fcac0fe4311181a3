"""The thesis' own identification (fig 4-4): parameters adjusted in turn against the errors of eq 4.14. The baseline to beat.

The order is raised from the fitted lower order by splitting its fastest arm; each parameter in turn is tried larger and smaller,
what lowers the error stays, and the step is halved when nothing does. The error is the mean error of magnitude over the mean
magnitude, plus the mean error of phase in rad: the thesis does not say how it weighs the two.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]


def stiffness(f: Float, parameters: Float) -> Complex:
    """k(jω) of (k0, k1…kn, c1…cn)."""
    n = (parameters.size - 1) // 2
    s = 2j * np.pi * f[:, None]
    k, c = parameters[1 : 1 + n], parameters[1 + n :]
    return np.asarray(parameters[0] + (k * c * s / (k + c * s)).sum(axis=1))


def error(f: Float, parameters: Float, measured: Complex) -> float:
    model = stiffness(f, parameters)
    magnitude = np.mean(np.abs(np.abs(model) - np.abs(measured))) / np.mean(np.abs(measured))
    return float(magnitude + np.mean(np.abs(np.angle(model * measured.conj()))))


def adjust(f: Float, measured: Complex, parameters: Float, smallest: float = 1e-3) -> Float:
    """Parameters one after the other, factors 1 ± step, until a step of `smallest` helps none."""
    best = error(f, parameters, measured)
    step = 0.5
    while step > smallest:
        improved = False
        for i in range(parameters.size):
            for factor in (1 + step, 1 / (1 + step)):
                trial = parameters.copy()
                trial[i] *= factor
                value = error(f, trial, measured)
                if value < best:
                    best, parameters, improved = value, trial, True
                    break
        if not improved:
            step /= 2
    return parameters


def identify(f: Float, measured: Complex, orders: tuple[int, ...] = (1, 2, 3)) -> Float:
    """Parameters (k0, k, c) of the highest order."""
    size = np.abs(measured)
    k0, k1 = float(size[0]), float(max(size[-1] - size[0], 0.1 * size[0]))
    middle = np.sqrt(f[0] * f[-1])
    parameters = np.array([k0, k1, k1 / (2 * np.pi * middle)])
    for n in orders:
        if n > 1:
            k, c = parameters[1:n], parameters[n:]
            parameters = np.concatenate([parameters[:1], k, [k[-1]], c, [c[-1] / 5]])
        parameters = adjust(f, measured, parameters)
    return parameters
