"""What would put a fault right, as keys and values of metadata, mapping or rig file."""

from __future__ import annotations

from pipeline.diagnose.faults import fault as ids
from pipeline.diagnose.faults.fault import Correction
from pipeline.diagnose.faults.hypotheses import Hypothesis
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.observed import AMPLITUDE, STATED

_DIGITS, _RATIO_DIGITS = 6, 9
"""Significant digits of a value that is proposed, and of a ratio of two clocks, which differs from 1 by millionths."""
_SCALE, _DELAY, _COLUMN = "columns.{}.scale", "columns.{}.delay_s", "columns.{}.column"


def list_corrections(own: RecordingFeatures, hypothesis: Hypothesis, probability: float) -> tuple[Correction, ...]:
    """What would put one recording right under a hypothesis; empty where nothing that is written would."""
    cause, channel = hypothesis.cause, hypothesis.channel
    pairs: list[tuple[str, str, str]] = []
    if cause == ids.STRAIN_WRONG and STATED + AMPLITUDE in own.values:
        stated = own.values[STATED + AMPLITUDE] / own.values["strain_length_mm"]
        pairs = [("strain_pp", write(stated), write(stated / hypothesis.factor))]
    elif cause == ids.CHANNELS_SWAPPED:
        pairs = [(_COLUMN.format(a), a, b) for a, b in (("force", "displacement"), ("displacement", "force"))]
    elif cause in (ids.UNIT_SLIP, ids.SIGN_FLIPPED):
        pairs = [(_SCALE.format(channel), "1", write(1 / hypothesis.factor))]
    elif cause == ids.CHANNEL_SKEW:
        pairs = [(_DELAY.format(channel), "", write(hypothesis.late[0]))]
    elif cause == ids.SAMPLE_RATE_WRONG:
        pairs = [("time.scale", "1", write(1 / hypothesis.stretch))]
    elif cause == ids.CLOCK_DRIFT:
        pairs = [(f"columns.{channel}.time_scale", "1", write_ratio(1 / (1 + hypothesis.late[1])))]
    elif cause == ids.FOREIGN_RECORDING:
        pairs = [("specimen_id", own.specimen_id, "")]
    elif cause == ids.FOREIGN_RIG and own.rig.rig_id:
        pairs = [("rig_id", own.rig.rig_id, "")]
    return tuple(Correction(own.recording_id, cause, key, now, then, probability) for key, now, then in pairs)


def write(value: float) -> str:
    """A value as it stands in a file."""
    return f"{value:.{_DIGITS}g}"


def write_ratio(value: float) -> str:
    """A ratio of two clocks as it stands in a file."""
    return f"{value:.{_RATIO_DIGITS}g}"
