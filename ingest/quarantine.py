"""Refused files: a copy and `reason.json` in `LAB/quarantine/<name>/`. The raw folders are the laboratory's: nothing is
moved or deleted there.

A copy, not a link: a link would change with the raw file and then no longer be what was refused. Files above
`COPY_LIMIT` are not copied; `reason.json` says so (`"copied": false`) and names where the file stands. Entries appear
whole or not at all. A file that is refused again replaces its entry; one that has become good is released.

Does not belong here: deciding what is refused (`ingest.canonical`, the readers).
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import unicodedata
import uuid
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from ingest.atomic import flush
from ingest.plain_files import open_plain
from ingest.remote import is_url
from schemas.errors import DealabError

FOLDER = "quarantine"
REASON = "reason.json"
COPY_LIMIT = 4 << 30
"""Largest file that is copied, bytes."""
_NAME_LENGTH = 60
_PARTIAL = ".partial-"


@dataclass(frozen=True)
class QuarantineEntry:
    """One refused file: the folder of its entry and the content of its `reason.json`."""

    folder: Path
    reason: dict[str, Any]


def quarantine(
    path: Path,
    lab: Path,
    error: DealabError,
    *,
    sha256: str | None = None,
    when: datetime | None = None,
    copy_limit: int = COPY_LIMIT,
    place: str | None = None,
    root: Path | None = None,
) -> Path:
    """Copies a refused file into the lab with the reason beside it; returns the folder of the entry.

    The same file with the same content and reason leaves its entry as it is, `when` included. Raises `OSError` when the
    lab cannot be written; a raw file that cannot be read (any more) is quarantined by its reason alone. `place` is how the
    database spells where the file is (`ingest.paths.spell_source`). What a link leads to, out of the folder `root` that was
    looked through, is not copied: whoever may read the lab might not be allowed to read that.
    """
    folder = lab / FOLDER / entry_name(place or path)
    reason: dict[str, Any] = {
        **error.as_dict(),
        "source_path": _printable(place or os.fspath(path)),
        "sha256": sha256,
        "when": None if when is None else when.isoformat(),
    }
    known = _load(folder)
    if known is not None and _same_reason(known, reason):
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = _make_partial(folder.parent)
    try:
        reason |= _explain_link() if _leads_out(path, root) else _copied(path, partial, copy_limit)
        (partial / REASON).write_text(json.dumps(reason, indent=2) + "\n", encoding="utf-8")
        flush(partial / REASON)
        _replace_folder(partial, folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    return folder


def release(path: Path | str, lab: Path) -> bool:
    """Removes the entry of a file that has become good; says whether there was one."""
    folder = lab / FOLDER / entry_name(path)
    if not folder.is_dir():
        return False
    _remove(folder)
    return True


def release_strays(lab: Path, refused: Iterable[str], looked_at: Callable[[], Iterable[str]]) -> None:
    """Removes entries of files that are not refused: left by a night that ended early, or of a database that was moved away.

    Parameters
    ----------
    refused : where the files are that the database calls refused (`ingest.paths.spell_source`)
    looked_at : gives the same of the files that this night saw; asked only when there is something to remove

    The entry of a file that was not seen and is not there any more stays: it may hold the last copy.
    """
    folder = lab / FOLDER
    if not folder.is_dir():
        return
    strays = {item.name for item in os.scandir(folder) if not item.name.startswith(".")} - set(map(entry_name, refused))
    seen = set(map(entry_name, looked_at())) if strays else set()
    for name in sorted(strays):
        reason = _load(folder / name)
        place = str((reason or {}).get("source_path"))
        if reason is not None and (name in seen or (not is_url(place) and os.path.isfile(place))):
            _remove(folder / name)


def entries(lab: Path) -> tuple[QuarantineEntry, ...]:
    """All entries, by the name of their folder; half-written ones do not count."""
    folder = lab / FOLDER
    if not folder.is_dir():
        return ()
    found = []
    for item in sorted(folder.iterdir()):
        reason = None if item.name.startswith(".") else _load(item)
        if reason is not None:
            found.append(QuarantineEntry(item, reason))
    return tuple(found)


def entry_name(path: Path | str) -> str:
    """Name of the entry of a file or address: readable, safe on every file system, and its own for each of them."""
    place = os.fsencode(path if is_url(path) else os.path.abspath(path))
    return f"{safe_name(Path(path).stem)}-{hashlib.sha256(place).hexdigest()[:12]}"


def safe_name(name: str) -> str:
    """At most 60 characters of `A-Z a-z 0-9 . _ -`, the first a letter or digit; "file" where nothing is left."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9._-]+", "_", plain).lstrip("._-")[:_NAME_LENGTH].rstrip("._") or "file"


def _copied(path: Path, folder: Path, limit: int) -> dict[str, Any]:
    """Copies the file; what `reason.json` says about that."""
    target = folder / (safe_name(path.stem) + re.sub(r"[^.A-Za-z0-9]", "", path.suffix)[:16])
    if target.name == REASON:
        target = target.with_name("file.json")
    try:
        size = path.stat().st_size
        if size > limit:
            return {"file": None, "copied": False, "size": size}
        with open_plain(path) as read, target.open("xb") as written:
            shutil.copyfileobj(read, written, 1 << 20)
    except OSError as error:
        target.unlink(missing_ok=True)
        return {"file": None, "copied": False, "copy_error": error.strerror or str(error)}
    flush(target)
    return {"file": target.name, "copied": True, "size": size}


def _leads_out(path: Path, root: Path | None) -> bool:
    """Whether a file is a link, or lies below one in the folder that was looked through."""
    if path.is_symlink():
        return True
    return (
        root is not None and root.is_dir() and Path(os.path.realpath(root)) not in Path(os.path.realpath(path)).parents
    )


def _explain_link() -> dict[str, Any]:
    return {"file": None, "copied": False, "copy_error": "what a link leads to is not copied"}


def _make_partial(parent: Path) -> Path:
    """A new folder with the permissions of any new folder."""
    partial = parent / f"{_PARTIAL}{uuid.uuid4().hex}"
    partial.mkdir()
    return partial


def _replace_folder(partial: Path, folder: Path) -> None:
    """Puts the new entry where the old one was; a reader meets the old, the new or for a moment none, never a mixture."""
    if folder.exists():
        _remove(folder)
    os.rename(partial, folder)
    flush(folder.parent)


def _remove(folder: Path) -> None:
    gone = _make_partial(folder.parent)
    os.rename(folder, gone / "old")
    shutil.rmtree(gone, ignore_errors=True)
    flush(folder.parent)


def _same_reason(known: dict[str, Any], new: dict[str, Any]) -> bool:
    keys = ("problem", "where", "expected", "remedy", "source_path", "sha256")
    return new["sha256"] is not None and all(known.get(k) == new[k] for k in keys)


def _load(folder: Path) -> dict[str, Any] | None:
    try:
        content = json.loads((folder / REASON).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def _printable(text: str) -> str:
    """A path as text that every encoder takes: bytes that are no UTF-8 become escapes."""
    return text.encode("utf-8", "backslashreplace").decode()
