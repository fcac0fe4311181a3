"""Errors in the thesis' metric, and the modulus that goes with k0.

Reported always, optimised never. Does not belong here: likelihoods.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.arrays import Complex
from schemas.metadata import RecordingMetadata


@dataclass(frozen=True)
class Errors:
    """Mean | |model| − |measured| | in the unit of the response, mean |arg(model/measured)| in degrees, and the root mean
    square of |model − measured|/|measured|. They depend on the lines, so their number and range belong beside them.
    """

    magnitude: float
    phase_deg: float
    relative: float
    lines: int


def errors(model: Complex, measured: Complex) -> Errors | None:
    """Errors (thesis, eq 4.14; phases wrapped) over (m,) lines, those that are not finite left out; None without lines."""
    good = np.isfinite(measured) & (measured != 0)
    model, measured = model[good], measured[good]
    if not measured.size:
        return None
    return Errors(
        magnitude=float(np.mean(np.abs(np.abs(model) - np.abs(measured)))),
        phase_deg=float(np.degrees(np.mean(np.abs(np.angle(model * measured.conj()))))),
        relative=float(np.sqrt(np.mean(np.abs(model / measured - 1) ** 2))),
        lines=int(measured.size),
    )


@dataclass(frozen=True)
class Geometry:
    """Stretched length in mm and stretched cross-section in mm² of the film between the clamps."""

    length_mm: float
    section_mm2: float

    @classmethod
    def of(cls, metadata: RecordingMetadata) -> Geometry | None:
        """From the undeformed sizes and the pre-stretch, for an incompressible film: section = A0/λ. None where one is missing.

        Film that is held rigid (`constrained_length_mm`) does not count in the length.
        """
        length, section, stretch = metadata.film_length_mm, metadata.undeformed_section_mm2, metadata.pre_stretch
        if length is None or section is None or stretch is None:
            return None
        free = length * stretch - (metadata.constrained_length_mm or 0.0)
        return cls(free, section / stretch) if free > 0 else None

    def modulus_mpa(self, stiffness_n_per_mm: float) -> float:
        """Y = k l/A in MPa with stretched length and section (thesis, section 4.4.1: 0.16 MPa needs the stretched area)."""
        return stiffness_n_per_mm * self.length_mm / self.section_mm2
