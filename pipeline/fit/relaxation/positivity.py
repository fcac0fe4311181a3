"""The positivity alarm: can relaxation of any order explain these responses?

Does not belong here: finding the best relaxation (`reference`), what else the cause could be (`pipeline.diagnose`).
"""

from __future__ import annotations

import numpy as np

from pipeline.fit.relaxation.reference import Reference, misfit_probability
from pipeline.fit.relaxation.results import Positivity
from schemas.numbers import p_equals, significant

LEVEL = 0.001
"""A lab has many specimens and looks every night: one false alarm in a thousand."""


def positivity(parts: list[Reference], *, variance_estimated: bool) -> Positivity:
    """The alarm from the best relaxation of each recording group by itself, so that differences between groups cannot raise it.

    The reference is χ² with N − (active coefficients) degrees of freedom.
    """
    chi2 = sum(p.chi2 for p in parts)
    data = sum(p.observations.data for p in parts)
    freedom = sum(p.observations.data - p.active for p in parts)
    per_line = chi2 / max(data, 1.0)
    if variance_estimated:
        return Positivity(
            per_line,
            float("nan"),
            False,
            "no variance was given: the noise was taken from the misfit of the best relaxation, so that no alarm is possible",
        )
    if freedom < 2:
        return Positivity(per_line, float("nan"), False, "too few values to tell whether relaxation can explain them")
    p = misfit_probability(chi2, freedom)
    if p >= LEVEL or not np.isfinite(p):
        return Positivity(
            per_line, p, False, f"relaxation can explain the response (reduced χ² {significant(per_line)})"
        )
    return Positivity(
        per_line,
        p,
        True,
        f"no relaxation of any order reaches the response within its noise (reduced χ² {significant(per_line)}, {p_equals(p)}): "
        "look at rig, sensors, amplitude dependence or drift; more arms cannot help",
    )
