"""Courses of the simplest film there is, for mechanisms that act on strain and tension over time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.diagnose.simulation.effects import Course, Scale

Float = NDArray[np.float64]
STIFFNESS_N_PER_MM = 3.0


def of_a_spring(
    strain: Float, *, length_mm: float, largest: float, periodic: bool, cycles: tuple[Float, Float] | None = None
) -> Course:
    """A spring under a strain over time (..., P), in a session whose largest strain is `largest`."""
    most = STIFFNESS_N_PER_MM * length_mm * largest
    return Course(
        strain=strain,
        tension=STIFFNESS_N_PER_MM * length_mm * strain,
        periodic=periodic,
        rest_force_n=np.ones((1, 1)),
        largest_tension_n=most,
        largest_fall_n=most,
        stiffness=np.full((1, 1), STIFFNESS_N_PER_MM + 0j),
        static=STIFFNESS_N_PER_MM,
        interval_s=np.full((1, 1), 1 / 64),
        scale=Scale(largest, 5.0, 100.0, 4000.0, length_mm),
        cycles=cycles,
    )
