"""The frequency response that every transform yields and every fit takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from schemas.arrays import Bool, Complex, Float, Int

STIFFNESS = "stiffness_n_per_mm"
FORCE_PER_VOLTAGE_SQUARED = "force_per_voltage_squared_n_per_kv2"
OUTPUT_PER_INPUT = "output_per_input"
_PER_LINE = (
    "frequency_hz",
    "value",
    "variance",
    "usable",
    "noise_variance",
    "coherence",
    "amplification",
    "systematic",
    "between_spread",
)


@dataclass(frozen=True)
class FrequencyResponse:
    """A response at n frequencies, phasors e^{+jωt}: a delayed output has negative phase.

    Mechanical: G = F/x0 in N/mm. Electrical: H = −F/V² in N/kV² (a drop of tension counts positive).

    Parameters
    ----------
    frequency_hz : (n,) Hz, ascending
    value : (n,) complex, unit of `quantity`
    variance : (n,) E|Δvalue|², both components together; one component has half of it. NaN where unknown
    usable : (n,) may be used for fits and errors
    unusable_because : (n,) reason, "" where usable
    quantity : one of the constants above
    loading : `mechanical`, `electrical` or `other`
    noise_variance : (n,) the part of `variance` that repeats within the record as noise; NaN where not separated
    coherence, amplification : (n,) or None
    systematic : (n, m) complex, one column per calibration constant: derivative of `value` by the constant times the
        constant's standard deviation (columns may be rotated). Its covariance S Sᴴ is fully correlated over frequency
        and comes on top of `variance`; None where there is none
    between_spread : (n,) of averages: standard deviation between the recordings beyond their noise, both components
    effective_lines : number of independent complex values (less than n when neighbouring lines share data)
    repeats : periods or repeats that were averaged
    amplitude : amplitude of the input in its unit (strain amplitude for cyclic tests), None where not defined
    recording_id, specimen_id : what it belongs to; recording_id None for averages
    details : what the estimator wants to report (settled periods, repeat differences, ...), plain values only
    """

    frequency_hz: Float
    value: Complex
    variance: Float
    usable: Bool
    quantity: str
    loading: str
    unusable_because: tuple[str, ...] = ()
    noise_variance: Float | None = None
    coherence: Float | None = None
    amplification: Float | None = None
    systematic: Complex | None = None
    between_spread: Float | None = None
    effective_lines: float | None = None
    repeats: int = 1
    amplitude: float | None = None
    recording_id: str | None = None
    specimen_id: str | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = self.frequency_hz.shape
        for name in ("value", "variance", "usable"):
            if getattr(self, name).shape != n:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, frequency_hz {n}")
        if not self.unusable_because:
            object.__setattr__(self, "unusable_because", ("",) * n[0])

    @property
    def standard_error(self) -> Float:
        """√E|Δvalue|², both components together (column `standard_error`)."""
        return np.sqrt(self.variance)

    def only_usable(self) -> Self:
        return self.select(self.usable)

    def select(self, mask: Bool) -> Self:
        """The response at the masked frequencies."""
        chosen: dict[str, Any] = {
            name: getattr(self, name)[mask] for name in _PER_LINE if getattr(self, name) is not None
        }
        share = mask.mean() if mask.size else 0.0
        return replace(
            self,
            **chosen,
            unusable_because=tuple(r for r, keep in zip(self.unusable_because, mask, strict=True) if keep),
            effective_lines=None if self.effective_lines is None else self.effective_lines * float(share),
        )

    def mark(self, mask: Bool, reason: str) -> Self:
        """The same response with the masked lines unusable, for that reason; earlier reasons are kept."""
        reasons = tuple(
            (f"{old}; {reason}" if old else reason) if hit else old
            for old, hit in zip(self.unusable_because, mask, strict=True)
        )
        return replace(self, usable=self.usable & ~mask, unusable_because=reasons)


@dataclass(frozen=True)
class Distortion:
    """Level of lines that a linear system would leave empty. `level` (n,) in `unit` at `frequency_hz` (n,).

    `kind` is `even`, `odd` or `noise`; `harmonic` (n,) the order of the harmonic for cyclic tests, None otherwise.
    """

    kind: str
    frequency_hz: Float
    level: Float
    unit: str
    harmonic: Int | None = None
