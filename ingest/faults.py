"""All that is wrong with a mapping and the file it maps, at once: a person mends everything in one go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ingest.assemble import assemble
from ingest.canonical import canonical
from ingest.compressed import find_stem, find_suffix
from ingest.mapping import FileMapping, format_of
from ingest.mapping import list_faults as list_mapping_faults
from ingest.mapping_keys import EACH, IGNORE, RECORDING
from ingest.parts import content_of_part, list_parts, name_parts, part_of
from ingest.read import open_columns, read_raw
from ingest.rigs import find_home, find_rig
from schemas.errors import DealabError
from schemas.metadata import RecordingMetadata, TableMetadata, list_faults
from schemas.recording import RawRecording, Recording


def find_faults(
    path: Path, content: Mapping[str, Any], *, source: str = "", rigs: Path | None = None
) -> tuple[DealabError, ...]:
    """All that keeps a file from being taken in with a mapping; empty where nothing does.

    Parameters
    ----------
    path : the data file
    content : the mapping's tables
    source : name of the mapping, for messages
    rigs : folder of rig files; None: those that a night over the folder around the file would find
    """
    stem, suffix = find_stem(path), find_suffix(path)
    faults = list(list_static_faults(content, stem=stem, suffix=suffix, source=source))
    kind = content.get("kind", RECORDING)
    if faults or kind == IGNORE:
        return _each_once(faults)
    mapping = FileMapping.parse(content, stem=stem, suffix=suffix, source=source)
    try:
        parts = [part_of(mapping, label) for label in list_parts(path, mapping)] if mapping.parts_file else [mapping]
    except DealabError as fault:
        return (fault,)
    for part in parts:
        try:
            raw = read_raw(path, part)
            if isinstance(raw, RawRecording):
                check(raw, path, rigs=rigs)
        except DealabError as first:
            faults += [first, *_of_columns(path, part)]
    return _each_once(faults)


def list_static_faults(
    content: Mapping[str, Any], *, stem: str, suffix: str, source: str = ""
) -> tuple[DealabError, ...]:
    """All that is wrong with a mapping and the metadata in it, whatever the file; `stem` and `suffix` are the file's name."""
    faults: list[DealabError] = list(list_mapping_faults(content, stem=stem, suffix=suffix, source=source))
    kind = content.get("kind", RECORDING)
    for about in _list_abouts(content, stem) if kind != IGNORE else ():
        stamped = {k: v.replace(EACH, "each") if isinstance(v, str) else v for k, v in about.items()}
        if kind == RECORDING and "started_at" not in stamped:
            stamped["started_at"] = "2020-01-01T00:00:00+00:00"  # the file's own times, or the zone, say it
        elif isinstance(stamped.get("started_at"), str) and isinstance(content.get("time"), Mapping):
            stamped["started_at"] += "" if "zone" not in content["time"] or "+" in stamped["started_at"] else "+00:00"
        faults += list_faults(stamped, RecordingMetadata if kind == RECORDING else TableMetadata, where=source)
    return tuple({str(fault): fault for fault in faults}.values())


def _list_abouts(content: Mapping[str, Any], stem: str) -> list[Mapping[str, Any]]:
    """The tables `[recording]` of a mapping: one, or one for each part that it names."""
    about = content.get("recording", {})
    if not isinstance(about, Mapping):
        return []
    about = {k: v.replace("{stem}", stem) if isinstance(v, str) else v for k, v in about.items()}
    stamped = {**content, "recording": about}
    return [content_of_part(stamped, name)["recording"] for name in name_parts(content)] or [about]


def check(raw: RawRecording, path: Path, *, rigs: Path | None = None) -> Recording:
    """The recording in canonical units, with the file of its rig. Raises `DealabError` where it cannot be one."""
    rig_id = RecordingMetadata.parse(raw.metadata, where=path.name).rig_id or raw.rig.get("rig_id")
    rig_file = find_rig(rig_id, path, root=find_home(path), rigs=rigs)
    return canonical(raw, where=path.name, rig_file=None if rig_file is None else rig_file.values)


def _of_columns(path: Path, mapping: FileMapping) -> list[DealabError]:
    """What is wrong with each channel of a recording by itself."""
    found = format_of(path, mapping)
    if mapping.kind != RECORDING or found in (None, "mcap"):
        return []
    faults: list[DealabError] = []
    for quantity, column in mapping.columns.items():
        alone = replace(mapping, columns={quantity: column})
        try:
            assemble(open_columns(path, str(found), alone), alone, where=path.name)
        except DealabError as error:
            faults.append(error)
    return faults


def _each_once(faults: list[DealabError]) -> tuple[DealabError, ...]:
    return tuple({str(fault): fault for fault in faults}.values())
