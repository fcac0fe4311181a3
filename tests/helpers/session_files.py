"""Recordings of the truth rig as the files that a rig's computer would leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ingest.mcap_writer import RecordingWriter
from schemas.quantities import QUANTITIES
from schemas.recording import Recording


def write_recordings(
    folder: Path, recordings: Sequence[Recording], units: Mapping[str, tuple[str, float]] | None = None
) -> list[Path]:
    """One native file per recording, with its rig's constants.

    `units` : quantity → unit of the file instead of the canonical one, and how many of it make one of those.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for recording in recordings:
        path = folder / f"{recording.metadata.recording_id}.mcap"
        with RecordingWriter(path, recording.metadata, recording.rig) as writer:
            for name, channel in recording.channels.items():
                interval_s = float(channel.time_ns[1] - channel.time_ns[0]) * 1e-9
                unit, factor = (units or {}).get(name, (QUANTITIES[name].unit, 1.0))
                step = None if channel.resolution is None else channel.resolution * factor
                writer.add_channel(name, unit, resolution=step)
                writer.append(name, int(channel.time_ns[0]), interval_s, channel.values * factor)
        paths.append(path)
    return paths
