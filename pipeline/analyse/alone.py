"""Records that say something without a session: which of a recording's samples the diagnosis gets, and what it makes of them.

A large cycle shows no response over frequency, a system of another kind has no film: neither belongs into the simulation of a
specimen's session.
"""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.analyse.cycle import given_law, stretch_and_stress
from pipeline.analyse.inputs import Measured
from pipeline.analyse.session_features import CYCLE, Alone, SessionFeatures
from pipeline.diagnose.contest import Contest
from pipeline.diagnose.cycle_causes import large_cycle
from pipeline.diagnose.cycle_diagnosis import diagnose_cycle
from pipeline.diagnose.results import Diagnosis
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata
from schemas.recording import Recording

_MOST = 700
"""Samples of a cycle that are asked; of more, equally spaced ones: a cycle is smooth."""


def alone_of(recording: Recording) -> Alone | None:
    """What the diagnosis can ask of a recording without others; None for recordings that belong to a session."""
    if recording.metadata.protocol != CYCLE:
        return None
    try:
        time, stretch, stress = stretch_and_stress(recording)
        given = given_law(recording.metadata)
    except NotIdentifiableError:
        return None  # the cycle's own fits say why
    every = -(-time.size // _MOST)
    channels = {"time_s": time[::every], "stretch": stretch[::every], "stress": stress[::every]}
    return Alone(CYCLE, channels, given or {})


def diagnosed_alone(specimen_id: str, recordings: Sequence[Measured]) -> tuple[Diagnosis, Contest] | None:
    """The diagnosis of a specimen of which there is one record that can be asked alone; None where there is none, or several.

    Raises `NotIdentifiableError` where the record does not carry it.
    """
    found = [(r, kept.alone) for r in recordings for kept in r.of(SessionFeatures) if kept.alone is not None]
    if len(found) != 1 or any(isinstance(r.metadata, RecordingMetadata) and r is not found[0][0] for r in recordings):
        return None
    recording, alone = found[0]
    c = alone.channels
    cycle = large_cycle(
        c["time_s"], c["stretch"], c["stress"], alone.given or None, recording.recording_id, specimen_id
    )
    return diagnose_cycle(cycle)
