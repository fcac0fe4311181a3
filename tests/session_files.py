"""Recordings of the truth rig as the files that a rig's computer would leave."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ingest.mcap_writer import RecordingWriter
from schemas.quantities import QUANTITIES
from schemas.recording import Recording


def write_recordings(folder: Path, recordings: Sequence[Recording]) -> list[Path]:
    """One native file per recording, with its rig's constants."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for recording in recordings:
        path = folder / f"{recording.metadata.recording_id}.mcap"
        with RecordingWriter(path, recording.metadata, recording.rig) as writer:
            for name, channel in recording.channels.items():
                interval_s = float(channel.time_ns[1] - channel.time_ns[0]) * 1e-9
                writer.add_channel(name, QUANTITIES[name].unit, resolution=channel.resolution)
                writer.append(name, int(channel.time_ns[0]), interval_s, channel.values)
        paths.append(path)
    return paths
