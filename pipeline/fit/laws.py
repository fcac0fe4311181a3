"""Hyperelastic laws through a stress-stretch curve: moduli, the shape parameter, and which law the curve asks for.

The residual of such a fit is what the law cannot do, and no noise: laws are judged by their error on parts of the curve
that were left out, and standard deviations are widened for residuals that hang together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar, nnls

from pipeline.physics.hyperelastic import NEO_HOOKEAN, NON_AFFINE, OGDEN, Law
from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError

PARTS = 5
"""Parts of the curve, equally long, of which each is left out once; the first and the last are always kept."""
WORTH = 0.1
"""Share by which a law with more parameters must lower the error on the parts left out."""
_STARTS = 24
_STEP = 1e-4
"""Relative step of numerical derivatives."""


@dataclass(frozen=True)
class LawFit:
    """One law through one curve. Stresses in the unit of the data.

    Parameters
    ----------
    law : name of the law
    parameters, sds : moduli and shape with standard deviations; NaN where the data do not tell one
    rmse, held_out_rmse : root mean square errors, of all and of parts left out
    young : slope at stretch 1
    selected : the law that the curve asks for
    """

    law: str
    parameters: Mapping[str, float]
    sds: Mapping[str, float]
    rmse: float
    held_out_rmse: float
    young: float
    selected: bool = False


def fit_laws(
    stretch: Float, stress: Float, laws: Sequence[Law] = (NEO_HOOKEAN, OGDEN, NON_AFFINE), *, where: str = ""
) -> tuple[tuple[LawFit, ...], Mapping[str, Float]]:
    """Each law through a curve, and its stress at the curve's stretches by its name.

    Parameters
    ----------
    stretch, stress : (n,) uniaxial stretch and nominal stress
    laws : with few parameters first

    Raises
    ------
    NotIdentifiableError : fewer samples than parameters, or no tension
    """
    if stretch.size < 4 * PARTS or not np.max(stress) > 0:
        raise NotIdentifiableError(
            f"{stretch.size} samples for a hyperelastic law", where=where, expected=f"{4 * PARTS} samples in tension"
        )
    place = np.minimum((PARTS * (stretch - stretch[0]) / np.ptp(stretch)).astype(int), PARTS - 1)
    fits, curves = [], {}
    for law in laws:
        parameters = _fit(law, stretch, stress, float(stretch.max()))
        curves[law.name] = law.stress(stretch, parameters)
        rest = stress - curves[law.name]
        missed = []
        for part in range(1, PARTS - 1):
            out: Bool = place == part
            if out.any():
                learned = _fit(law, stretch[~out], stress[~out], float(stretch.max()))
                missed.append(stress[out] - law.stress(stretch[out], learned))
        held = float(np.sqrt(np.mean(np.concatenate(missed) ** 2))) if missed else math.nan
        around = law.stress(np.array([1 - 1e-5, 1 + 1e-5]), parameters)
        fits.append(
            LawFit(
                law.name,
                parameters,
                _measure_sds(law, parameters, stretch, rest),
                float(np.sqrt(np.mean(rest**2))),
                held,
                float(np.diff(around)[0] / 2e-5),
            )
        )
    best = fits[0]
    for fit in fits[1:]:
        if fit.held_out_rmse < (1 - WORTH) * best.held_out_rmse:
            best = fit
    return tuple(LawFit(**{**vars(fit), "selected": fit is best}) for fit in fits), curves


def _fit(law: Law, stretch: Float, stress: Float, largest: float) -> dict[str, float]:
    """Least squares: for a given shape the stress is linear in the moduli, which are not negative."""

    def solve(shape: float) -> tuple[Float, float]:
        moduli, error = nnls(law.columns(stretch, shape), stress)
        return moduli, float(error)

    shape = 1.0
    if law.shape is not None:
        low, high = (math.log(end) for end in law.range(largest))
        starts = np.linspace(low, high, _STARTS)
        errors = [solve(math.exp(s))[1] for s in starts]
        i = int(np.argmin(errors))
        ends = (starts[max(i - 1, 0)], starts[min(i + 1, _STARTS - 1)])
        found = minimize_scalar(lambda s: solve(math.exp(s))[1], bounds=ends, method="bounded", options={"xatol": 1e-8})
        shape = math.exp(float(found.x))
    values = dict(zip(law.moduli, map(float, solve(shape)[0]), strict=True))
    return values if law.shape is None else {**values, law.shape: shape}


def _measure_sds(law: Law, parameters: Mapping[str, float], stretch: Float, rest: Float) -> dict[str, float]:
    """Standard deviations by the curvature of the sum of squares; NaN of those that lie at an end or are not told."""
    free = [name for name, value in parameters.items() if value > 0]
    columns = []
    for name in free:
        step = _STEP * parameters[name]
        up, down = ({**parameters, name: parameters[name] + sign * step} for sign in (1, -1))
        columns.append((law.stress(stretch, up) - law.stress(stretch, down)) / (2 * step) * parameters[name])
    sds = dict.fromkeys(parameters, math.nan)
    if not free or stretch.size <= len(free):
        return sds
    design = np.stack(columns, 1)
    variance = float(rest @ rest) / (stretch.size - len(free))
    together = min(max(float(rest[1:] @ rest[:-1]) / max(float(rest @ rest), 1e-300), 0.0), 0.98)
    normal = design.T @ design
    if np.linalg.cond(normal) > 1e12:
        return sds
    covariance = np.linalg.inv(normal) * variance * (1 + together) / (1 - together)
    return {**sds, **{name: parameters[name] * math.sqrt(covariance[i, i]) for i, name in enumerate(free)}}
