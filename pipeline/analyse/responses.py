"""Rows of `frequency_responses`, `relaxation_curves` and `distortions`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import Distortion, FrequencyResponse
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

MEASURED, CORRECTED, AVERAGED = "measured", "corrected", "averaged"


def response_table(responses: Iterable[FrequencyResponse], stage: str = MEASURED) -> pa.Table:
    """Rows of `frequency_responses` for responses of one stage."""
    return TABLES["frequency_responses"].stack(_response_rows(response, stage) for response in responses)


def relaxation_table(curve: RelaxationCurve) -> pa.Table:
    """Rows of `relaxation_curves`."""
    return TABLES["relaxation_curves"].arrays(
        curve.time_s.size,
        recording_id=curve.recording_id,
        specimen_id=curve.specimen_id,
        quantity=curve.quantity,
        time_s=curve.time_s,
        value=curve.stiffness,
        standard_error=np.sqrt(curve.variance),
        usable=curve.usable,
        unusable_because=[why or None for why in curve.unusable_because],
        ramp_s=curve.ramp_s,
        step=curve.step,
        step_number=curve.step_number,
    )


def distortion_table(recording_id: str, distortions: Iterable[Distortion]) -> pa.Table:
    """Rows of `distortions` for the distortions of one recording."""
    table = TABLES["distortions"]
    return table.stack(
        table.arrays(
            one.frequency_hz.size,
            recording_id=recording_id,
            frequency_hz=one.frequency_hz,
            kind=one.kind,
            level=one.level,
            unit=one.unit,
            harmonic=one.harmonic,
        )
        for one in distortions
    )


def _response_rows(response: FrequencyResponse, stage: str) -> pa.Table:
    value = response.value
    return TABLES["frequency_responses"].arrays(
        value.size,
        recording_id=None if stage == AVERAGED else response.recording_id,
        specimen_id=response.specimen_id,
        loading=response.loading,
        quantity=response.quantity,
        stage=stage,
        frequency_hz=response.frequency_hz,
        real=value.real,
        imag=value.imag,
        magnitude=np.abs(value),
        phase_deg=np.degrees(np.angle(value)),
        standard_error=response.standard_error,
        coherence=response.coherence,
        amplification=response.amplification,
        usable=response.usable,
        unusable_because=[why or None for why in response.unusable_because],
        amplitude=response.amplitude,
        between_spread=response.between_spread,
    )
