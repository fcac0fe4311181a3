"""The one door for files: from a path and its mapping to what the file holds, whatever its format.

Does not belong here: finding files (`ingest.discover`) and mappings (`ingest.mapping`), validation (`ingest.canonical`).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from ingest.assemble import assemble
from ingest.columns import ColumnFile, telling
from ingest.compressed import TEXTS, find_stem, is_compressed
from ingest.mapping import FileMapping, format_of
from ingest.mapping_keys import FREQUENCY_RESPONSE, LIFETIMES, RECORDING, RELAXATION
from ingest.readers import find_reader
from ingest.tables import (
    LifetimeTable,
    RelaxationTable,
    ResponseTable,
    lifetime_table,
    relaxation_table,
    response_table,
)
from ingest.times import with_zone, zone_of
from schemas.errors import PendingError, RefusedError, UnmappedError
from schemas.recording import RawRecording
from schemas.visible import quote_path

Content: TypeAlias = RawRecording | LifetimeTable | ResponseTable | RelaxationTable


def read_raw(path: Path, mapping: FileMapping | None) -> Content:
    """What a file holds, in its own units.

    Raises `UnmappedError` for a foreign format without a mapping, `RefusedError` for content that cannot be used,
    `MissingExtraError` where the format's reader is not installed, `PendingError` when the file has gone.
    """
    found = format_of(path, mapping)
    if found is None:
        raise RefusedError(
            f'the format of "{path.suffix[:40]}" files is unknown',
            where=path.name,
            expected="a known file ending, or format in the mapping TOML",
        )
    if mapping is None and found != "mcap":
        asked = path.name if path.is_absolute() else str(path)  # as it was typed, so that the command works from there
        raise UnmappedError(
            "there is no mapping TOML for this file",
            where=path.name,
            remedy=f"`dealab add {quote_path(asked)}` writes one, {path.name[:100]}.toml, beside the file",
        )
    try:
        if found == "mcap":
            return _read_mcap(path, mapping)
        assert mapping is not None
        return _read_columns(path, found, mapping)
    except FileNotFoundError:
        raise PendingError("the file has gone since it was found", where=path.name) from None
    except OSError as error:
        raise RefusedError(
            f"the file cannot be read: {error.strerror or error}", where=path.name, expected="a readable file"
        ) from None


def open_columns(path: Path, found: str, mapping: FileMapping) -> ColumnFile:
    """The columns of a file of a foreign format. Raises `RefusedError`, also for a compressed file of one that is no text."""
    if is_compressed(path) and found not in TEXTS:
        raise RefusedError(
            f"a compressed file of the format {found} is not read",
            where=path.name,
            expected="the file itself: of compressed files only texts are read, " + ", ".join(TEXTS),
            remedy="Unpack it",
        )
    return find_reader(found)(path, mapping)


def _read_columns(path: Path, found: str, mapping: FileMapping) -> Content:
    if mapping.parts_file:
        raise RefusedError(
            "the file holds several recordings: [[select]] has each",
            where=path.name,
            expected="one of its parts",
            remedy=f"`dealab inspect {quote_path(path.name)}` lists them; the nightly reads each",
        )
    file = open_columns(path, found, mapping)
    with telling(file.problems):
        return _take_columns(file, path, mapping)


def _take_columns(file: ColumnFile, path: Path, mapping: FileMapping) -> Content:
    if mapping.kind == LIFETIMES:
        return lifetime_table(file, mapping, stem=find_stem(path), where=path.name)
    if mapping.kind == FREQUENCY_RESPONSE:
        return response_table(file, mapping, where=path.name)
    if mapping.kind == RELAXATION:
        return relaxation_table(file, mapping, where=path.name)
    return assemble(file, mapping, where=path.name)


def _read_mcap(path: Path, mapping: FileMapping | None) -> RawRecording:
    from ingest.mcap_reader import read_mcap

    if mapping is None:
        return read_mcap(path)
    if mapping.kind != RECORDING:
        raise RefusedError(
            f'kind is "{mapping.kind}" for an MCAP file', where=mapping.source or path.name, expected=f'"{RECORDING}"'
        )
    raw = read_mcap(path, mapping)
    return replace(raw, metadata=with_zone(raw.metadata, zone_of(mapping.time, mapping.source)))
