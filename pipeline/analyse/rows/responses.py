"""Rows of `frequency_responses` and `distortions`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from pipeline.transform.response import Distortion, FrequencyResponse
from schemas.arrays import Float
from schemas.tables import TABLES

MEASURED, CORRECTED, AVERAGED = "measured", "corrected", "averaged"


def response_table(responses: Iterable[FrequencyResponse], stage: str = MEASURED) -> pa.Table:
    """Rows of `frequency_responses` for responses of one stage. What is not finite becomes NULL."""
    table = TABLES["frequency_responses"]
    return pa.concat_tables([table.empty(), *(_response_rows(response, stage) for response in responses)])


def distortion_table(recording_id: str, distortions: Iterable[Distortion]) -> pa.Table:
    """Rows of `distortions` for the distortions of one recording."""
    table = TABLES["distortions"]
    rows = [
        table.arrays(
            one.frequency_hz.size,
            recording_id=recording_id,
            frequency_hz=one.frequency_hz,
            kind=one.kind,
            level=_finite(one.level),
            unit=one.unit,
            harmonic=one.harmonic,
        )
        for one in distortions
    ]
    return pa.concat_tables([table.empty(), *rows])


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
        real=_finite(value.real),
        imag=_finite(value.imag),
        magnitude=_finite(np.abs(value)),
        phase_deg=_finite(np.degrees(np.angle(value))),
        standard_error=_finite(response.standard_error),
        coherence=_finite(response.coherence),
        amplification=_finite(response.amplification),
        usable=response.usable,
        unusable_because=[why or None for why in response.unusable_because],
        amplitude=response.amplitude,
        between_spread=_finite(response.between_spread),
    )


def _finite(values: Float | None) -> Float | None:
    return None if values is None else np.where(np.isfinite(values), values, np.nan)
