"""Constants of a rig from `<rig_id>.toml`: found beside the recordings or in the folder given with `--rigs`.

The file wins over what a recording says about its rig, key by key. Does not belong here: what the constants mean
(`schemas.metadata.RigConstants`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ingest.toml_files import content_hash, load_toml
from schemas.errors import AccidentError, RefusedError
from schemas.metadata import RECORDING_ID
from schemas.recording import Recording

FOLDER = "rigs"


@dataclass(frozen=True)
class RigFile:
    """A rig's file: its keys and the SHA-256 of its content (comments do not count)."""

    path: Path
    values: Mapping[str, Any]
    hash: str


def find_rig(rig_id: str | None, path: Path, *, root: Path | None = None, rigs: Path | None = None) -> RigFile | None:
    """The file of a rig, or None where there is none.

    Looks in `rigs` when given, else in a folder `rigs` beside the recording `path` and in each folder above it up to
    `root` (the folder named on the command line; the recording's own folder when absent). Raises `RefusedError` when
    the file is not TOML or names another rig, `AccidentError` when file or folder cannot be read. A `rig_id` that is not a plain name has no file.
    """
    if rig_id is None or not RECORDING_ID.fullmatch(rig_id):
        return None
    for folder in (rigs,) if rigs is not None else _folders(path, root):
        candidate = folder / f"{rig_id}.toml"
        if _is_file(candidate):
            return _loaded(candidate, rig_id)
    return None


def find_home(path: Path) -> Path:
    """The folder that a nightly has to be given so that it finds the rig files of a recording: the nearest one around it
    that holds a folder `rigs`, the recording's own where none does. Relative where `path` is."""
    own = Path(os.path.abspath(path.parent))
    home = next((folder for folder in (own, *own.parents) if (folder / FOLDER).is_dir()), own)
    return home if path.is_absolute() else Path(os.path.relpath(home))


def list_rigs(path: Path, rigs: Path | None = None) -> list[str]:
    """The rigs that have a file, in `rigs` or else in the folder of rig files nearest to a recording; in order."""
    folder = find_home(path) / FOLDER if rigs is None else rigs
    return sorted(file.stem for file in folder.glob("*.toml") if RECORDING_ID.fullmatch(file.stem))


def tell_absent(recording: Recording, path: Path, rigs: Path | None = None) -> str:
    """That the rig which a recording names has no file, in `rigs` or around it, nor constants of its own; else empty."""
    rig_id = recording.rig.rig_id or recording.metadata.rig_id
    own = recording.rig.to_text().keys() - {"rig_id"}
    if rig_id is None or own or find_rig(rig_id, path, root=find_home(path), rigs=rigs) is not None:
        return ""
    return f"rig file {FOLDER}/{rig_id}.toml is not there: no constants of the rig, no resonance correction"


def _is_file(candidate: Path) -> bool:
    try:
        return candidate.is_file()
    except OSError as error:
        raise AccidentError(
            f"the folder of rig files cannot be read: {error.strerror or error}",
            where=str(candidate.parent),
            remedy="Give this user the right to read it",
        ) from None


def _folders(path: Path, root: Path | None) -> list[Path]:
    own = Path(os.path.abspath(path.parent))
    top = own if root is None else Path(os.path.abspath(root if root.is_dir() else root.parent))
    folders = [own / FOLDER]
    if own != top and top in own.parents:
        for parent in own.parents:
            folders.append(parent / FOLDER)
            if parent == top:
                break
    return folders


def _loaded(path: Path, rig_id: str) -> RigFile:
    values = load_toml(path)
    where = f"{FOLDER}/{path.name}"
    for key, value in values.items():
        if isinstance(value, dict | list):
            raise RefusedError(f"{key} is a {type(value).__name__}", where=where, expected="a number or text per key")
    if str(values.get("rig_id", rig_id)) != rig_id:
        raise RefusedError(
            f'rig_id is "{str(values["rig_id"])[:80]}"',
            where=where,
            expected=f'"{rig_id}", as the file is named',
            remedy="Rename the file or correct its rig_id",
        )
    return RigFile(path, values, content_hash(values))
