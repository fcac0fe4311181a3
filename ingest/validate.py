"""`dealab validate`: whether files that other software wrote keep to the published formats, and all that is wrong at once.

Mappings and rig files are TOML, metadata of a recording JSON with the tables `recording` and `rig`; every other file is a
recording or table, which is read with its mapping. Does not belong here: the JSON Schemas (`ingest.mapping_schema`), which
other software may use; the messages here are those of the night.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ingest.compressed import find_stem, find_suffix
from ingest.faults import find_faults, list_static_faults
from ingest.inspect import FITS, inspect
from ingest.mapping import FOLDER_FILE, list_entries
from ingest.plain_files import read_plain
from ingest.rigs import FOLDER
from ingest.toml_files import load_toml
from schemas.errors import DealabError, RefusedError
from schemas.metadata import RecordingMetadata, RigConstants, list_faults
from schemas.visible import shown

_LIMIT = 1 << 20
"""Bytes of metadata that are read."""


@dataclass(frozen=True)
class Validation:
    """What a file is, and all that is wrong with it; no fault: it is valid."""

    path: Path
    what: str
    faults: tuple[DealabError, ...]


def validate(path: Path, *, rigs: Path | None = None) -> Validation:
    """Checks one file.

    Parameters
    ----------
    path : a mapping, a rig file, metadata as JSON, or a recording or table
    rigs : folder with rig files, as for the night

    Raises
    ------
    RefusedError
        The path is no file.
    """
    if not path.is_file():
        raise RefusedError("not a file", where=shown(path), expected="a mapping, a rig file, metadata or a recording")
    what = _kind_of(path)
    try:
        return Validation(path, what, tuple(_CHECKS[what](path, rigs)))
    except DealabError as error:
        return Validation(path, what, (error,))


def _kind_of(path: Path) -> str:
    if path.suffix == ".json":
        return "metadata of a recording"
    if path.suffix != ".toml":
        return "recording or table"
    return "rig file" if path.parent.name == FOLDER else "mapping"


def _check_mapping(path: Path, rigs: Path | None) -> Iterator[DealabError]:
    """A mapping by itself, and with its data file where that lies beside it."""
    content = load_toml(path)
    if path.name == FOLDER_FILE:
        for number, entry in enumerate(list_entries(content, path.name), start=1):
            source = f"{path.name}, [[files]] number {number}"
            yield from list_static_faults(entry, stem="stem", suffix=find_suffix(Path(entry["match"])), source=source)
        return
    data = path.with_suffix("")
    if data.is_file():
        yield from find_faults(data, content, source=path.name, rigs=rigs)
    else:
        yield from list_static_faults(content, stem=find_stem(data), suffix=find_suffix(data), source=path.name)


def _check_rig(path: Path, _rigs: Path | None) -> Iterator[DealabError]:
    yield from list_faults(load_toml(path), RigConstants, where=f"{FOLDER}/{path.name}")


def _check_metadata(path: Path, _rigs: Path | None) -> Iterator[DealabError]:
    try:
        content = json.loads(read_plain(path, _LIMIT).decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise _malformed(path, f"not valid JSON: {error}") from None
    if not isinstance(content, dict) or not isinstance(content.get("recording"), dict):
        raise _malformed(path, 'there is no table "recording"')
    yield from list_faults(content["recording"], RecordingMetadata, where=path.name)
    rig = content.get("rig", {})
    if not isinstance(rig, Mapping):
        raise _malformed(path, '"rig" is no table')
    yield from list_faults(rig, RigConstants, where=path.name)


def _malformed(path: Path, problem: str) -> RefusedError:
    return RefusedError(
        problem,
        where=path.name,
        expected='{"recording": {…}, "rig": {…}}',
        remedy="`dealab validate --schema recording` prints what may stand there",
    )


def _check_content(path: Path, rigs: Path | None) -> Iterator[DealabError]:
    found = inspect(path, rigs=rigs)
    if found.error is not None:
        yield found.error
        yield from found.others
    elif found.verdict != FITS:
        yield from (RefusedError(problem, where=path.name) for problem in found.problems)


_CHECKS: Mapping[str, Any] = {
    "mapping": _check_mapping,
    "rig file": _check_rig,
    "metadata of a recording": _check_metadata,
    "recording or table": _check_content,
}
