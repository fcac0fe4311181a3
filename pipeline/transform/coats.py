"""Capacitance at rest of a sensing region that was given a number of coats of electrode."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.transform.sampling import seconds
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording


@dataclass(frozen=True)
class Coat:
    """Capacitance in pF of a sensing region after a number of coats, with its standard deviation."""

    recording_id: str
    specimen_id: str
    coats: int
    capacitance_pf: float
    capacitance_sd_pf: float


def measure_coat(recording: Recording) -> Coat:
    """Mean of the capacitance over the recording.

    Raises `NotIdentifiableError` without `coats` in the metadata and for fewer than two samples.
    """
    about = recording.metadata
    if about.coats is None:
        raise NotIdentifiableError(
            "coats is missing", where=about.recording_id, expected="the number of coats so far, in the metadata"
        )
    _, values = seconds(recording.channels["capacitance"], recording.start_ns)
    values = values[np.isfinite(values)]
    if values.size < 2:
        raise NotIdentifiableError(
            f"{values.size} samples of the capacitance", where=about.recording_id, expected="two"
        )
    noise = float(np.std(np.diff(values))) / math.sqrt(2) if values.size > 2 else float(np.std(values))
    resolution = recording.channels["capacitance"].resolution or 0.0
    sd = max(noise / math.sqrt(values.size), resolution / math.sqrt(12))
    return Coat(about.recording_id, about.specimen_id, about.coats, float(values.mean()), sd)
