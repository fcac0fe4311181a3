"""Recordings like another one: what a mechanism does in that would show in them as well."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.simulation.session import Session


def list_peers(own: RecordingFeatures, session: Session, asked: frozenset[str]) -> list[RecordingFeatures]:
    """Recordings of the same loading that agree with the others; none where more of them do not: those few may be what the film was
    fitted to, and say nothing of what a mechanism does at other levels.
    """
    alike = [r for r in session.recordings if r.loading == own.loading]
    agreeing = [r for r in alike if r.recording_id not in asked]
    return agreeing if 2 * len(agreeing) >= len(alike) else []


def has_peer(own: RecordingFeatures, others: Sequence[RecordingFeatures]) -> bool:
    """Whether a recording like this one is among those that agree: what a mechanism does in it would show there as well."""
    key = "largest_voltage_kv" if own.loading == "electrical" else "largest_strain"
    return any(
        (r.protocol, r.loading) == (own.protocol, own.loading)
        and r.values.get(key, 0.0) >= 0.8 * own.values.get(key, 0.0)
        for r in others
    )
