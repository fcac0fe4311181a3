"""The way in for one raw file: read, checked, joined with its rig's file, and then a recording or a table.

Does not belong here: which raw files there are (`ingest.discover`), how a format is read (`ingest.read`), what is
computed from a recording (`pipeline.analyse`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ingest.canonical import canonical
from ingest.discover import SourceFile, check_unchanged
from ingest.paths import spell_source
from ingest.read import Content, read_raw
from ingest.rigs import find_rig
from schemas.recording import RawRecording, Recording, Source


def read_source(source: SourceFile) -> Content:
    """What a raw file holds, in its own units.

    Raises
    ------
    DealabError : it cannot be used, or its mapping cannot
    PendingError : it changed while it was read
    """
    if source.error is not None:
        raise source.error
    raw = read_raw(source.path, source.mapping)
    check_unchanged(source.path, size=source.size, mtime_ns=source.mtime_ns)
    return raw


def name_rig(raw: Content | None) -> str | None:
    """The id of the rig that a recording names; None where it names none, and for tables."""
    if not isinstance(raw, RawRecording):
        return None
    rig_id = raw.rig.get("rig_id") or raw.metadata.get("rig_id")
    return None if rig_id is None else str(rig_id)


def list_metadata(raw: Content | None) -> Mapping[str, Any]:
    """The metadata as they stand in the file, whether they can be used or not; empty for a file that was not read."""
    if raw is None:
        return {}
    if isinstance(raw, RawRecording):
        return raw.metadata
    return {key: getattr(raw.metadata, key) for key in ("recording_id", "specimen_id")}


def check_recording(raw: RawRecording, source: SourceFile, *, sha256: str, rigs: Path | None) -> Recording:
    """The recording that a raw file holds, checked and in canonical units, with the constants of its rig's file.

    Parameters
    ----------
    raw, source, sha256 : what was read, from which file, and the SHA-256 of its content
    rigs : folder of rig files, None to look beside the recording

    Raises
    ------
    DealabError : the recording, or its rig's file, cannot be used
    """
    rig = find_rig(name_rig(raw), source.path, root=source.root, rigs=rigs)
    return canonical(
        raw,
        where=source.path.name,
        rig_file=None if rig is None else rig.values,
        source=Source(spell_source(source), sha256, source.size),
    )
