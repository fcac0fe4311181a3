"""Which channels of a recording are the input and the output of its test, in the units that responses have.

A machine that gives stretch and stress instead of displacement and force is translated here, once. How the channels
come onto one clock is in `sampling`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from pipeline.transform.response import FORCE_PER_VOLTAGE_SQUARED, OUTPUT_PER_INPUT, STIFFNESS
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata
from schemas.protocols import ELECTRICAL, MECHANICAL
from schemas.recording import Channel, Recording
from schemas.units import Conversion


@dataclass(frozen=True)
class Drive:
    """Input and output of a test.

    `square` says that the physical input is the square of `input` (measured voltage), `sign` is the sign that the output
    takes in the response: a drop of tension counts positive under voltage. `quantity` is the name of output over input.
    """

    input: Channel
    output: Channel
    quantity: str
    loading: str
    sign: float = 1.0
    square: bool = False
    output_unit: str = "N"
    input_unit: str = "mm"


def drive(recording: Recording) -> Drive:
    """Input and output channels of a recording, N and mm (stretch and stress translated) or N and kV.

    Raises `NotIdentifiableError` when a channel of the pair is missing.
    """
    metadata, channels = recording.metadata, recording.channels
    if metadata.loading == MECHANICAL:
        if "displacement" in channels and "force" in channels:
            return Drive(channels["displacement"], channels["force"], STIFFNESS, MECHANICAL)
        length, section = undeformed(metadata)
        displacement = _converted(_required(recording, "stretch"), "displacement", Conversion(length, -length))
        force = _converted(_required(recording, "stress"), "force", Conversion(1e-3 * section))
        return Drive(displacement, force, STIFFNESS, MECHANICAL)
    if metadata.loading == ELECTRICAL:
        voltage, force = _required(recording, "voltage"), _required(recording, "force")
        return Drive(voltage, force, FORCE_PER_VOLTAGE_SQUARED, ELECTRICAL, sign=-1.0, square=True, input_unit="kV^2")
    given, found = _required(recording, "input"), _required(recording, "output")
    return Drive(
        given,
        found,
        OUTPUT_PER_INPUT,
        metadata.loading,
        input_unit=given.unit or "",
        output_unit=found.unit or "",
    )


def undeformed(metadata: RecordingMetadata) -> tuple[float, float]:
    """Undeformed length in mm and section in mm² that turn stretch and nominal stress (kPa) into mm and N.

    Without the whole geometry those of a cube of 1 mm: 1 MPa reads 1 N, and stretch − 1 reads mm.
    """
    length, section = metadata.film_length_mm, metadata.undeformed_section_mm2
    return (1.0, 1.0) if length is None or section is None else (length, section)


def _converted(channel: Channel, quantity: str, change: Conversion) -> Channel:
    resolution = None if channel.resolution is None else change.apply_difference(channel.resolution)
    return replace(channel, quantity=quantity, values=change.apply(channel.values), resolution=resolution)


def _required(recording: Recording, quantity: str) -> Channel:
    channel = recording.channels.get(quantity)
    if channel is None or channel.values.size == 0:
        raise NotIdentifiableError(
            f"the recording has no {quantity} channel",
            where=recording.metadata.recording_id,
            expected=f"{quantity} for {recording.metadata.loading} {recording.metadata.protocol}",
        )
    return channel
