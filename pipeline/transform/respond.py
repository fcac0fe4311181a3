"""The door to the responses of a recording: the protocol decides which transform runs."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.transform import quality
from pipeline.transform.channels import drive
from pipeline.transform.chirp import chirp_response
from pipeline.transform.cyclic import cyclic_response
from pipeline.transform.random_noise import noise_response
from pipeline.transform.relaxation import RelaxationCurve, relaxation_curve
from pipeline.transform.response import Distortion, FrequencyResponse
from pipeline.transform.sphs import sphs_response
from schemas.errors import NotIdentifiableError
from schemas.protocols import ELECTRICAL
from schemas.recording import Recording


@dataclass(frozen=True)
class RecordingResponse:
    """What a recording says about its specimen: responses, distortions, a relaxation curve, and warnings in words."""

    responses: tuple[FrequencyResponse, ...] = ()
    distortions: tuple[Distortion, ...] = ()
    relaxation: RelaxationCurve | None = None
    warnings: tuple[str, ...] = ()


def respond(recording: Recording) -> RecordingResponse:
    """Responses of a recording of any protocol; empty for protocols that have none (lifetimes, force maps, steps of
    voltage, large cycles, calibrations).

    Raises `NotIdentifiableError` with the recording, what is wrong and what was expected when the recording cannot carry
    a response: too short, not excited in its band, saturated, with gaps, or lost in noise.
    """
    try:
        return _respond(recording)
    except NotIdentifiableError as error:
        if error.where:
            raise
        raise NotIdentifiableError(
            error.problem,
            where=recording.metadata.recording_id,
            expected=error.expected,
            remedy=error.remedy,
        ) from error


def _respond(recording: Recording) -> RecordingResponse:
    protocol = recording.metadata.protocol
    if protocol == "chirp":
        response, warnings = chirp_response(recording)
        return RecordingResponse((response,), warnings=warnings)
    if protocol == "sphs":
        response, distortions, warnings = sphs_response(recording)
        return RecordingResponse((response,), distortions, warnings=warnings)
    if protocol == "noise":
        response, warnings = noise_response(recording)
        return RecordingResponse((response,), warnings=warnings)
    if protocol == "cyclic":
        response, distortions, warnings = cyclic_response(recording)
        return RecordingResponse((response,), distortions, warnings=warnings)
    if protocol == "step" and recording.metadata.loading != ELECTRICAL:
        overload = quality.refuse_overload(recording, drive(recording))
        curve, warnings = relaxation_curve(recording)
        return RecordingResponse(relaxation=curve, warnings=overload + warnings)
    return RecordingResponse()
