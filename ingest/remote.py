"""Raw files behind a URL (s3://…, sftp://…, anything fsspec knows): listed, and fetched one by one to a local place.

The readers stay as they are: they get a local file. What lies beside the recordings and says how to read them (TOML
files) is always fetched; a recording only when its content is not known yet, and it is removed once it is read.
Does not belong here: which files are recordings (`ingest.discover`), what is new (`pipeline.nightly.look`).
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from ingest.atomic import written_whole
from ingest.extras import advise_install
from ingest.passed_over import Passed
from schemas.errors import LabError, PendingError, UsageError

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
_TIMES = ("LastModified", "last_modified", "mtime", "modified", "updated", "timeModified")
_OF_OBJECTS = ("ETag", "etag", "md5Hash", "content_md5")
"""Marks of object stores, which show an object only once it is whole."""
_VERSIONS = (*_OF_OBJECTS, "ino")
_SMALL = 1 << 20
"""Largest TOML file that is fetched, bytes."""


@dataclass(frozen=True, slots=True)
class RemoteFile:
    """A file as its store lists it.

    `url` the whole address, `name` the path below the address that was given, `mtime_ns` the time of its last change
    (0 where the store has none), `version` a number made of the store's own mark for this content (0 where it has none).
    `whole` where the store shows a file only once all of it is there.
    """

    url: str
    name: str
    size: int
    mtime_ns: int
    version: int
    whole: bool


@dataclass(frozen=True)
class Mirror:
    """A remote folder (or file) and the local folder that stands for it: its files by path, and what was passed over."""

    url: str
    folder: Path
    files: tuple[tuple[Path, RemoteFile], ...]
    passed_over: tuple[Passed, ...]


def is_url(given: str | os.PathLike[str]) -> bool:
    """Whether something given is a URL instead of a path."""
    return isinstance(given, str) and _URL.match(given) is not None


def mirror(url: str, folder: Path) -> Mirror:
    """Lists what lies behind a URL and fetches its TOML files into a folder below `folder`.

    Raises `UsageError` where there is nothing, `LabError` where the store does not answer or fsspec is not installed.
    """
    root, files = _listed(url)
    own = (
        folder
        / f"{re.sub(r'[^A-Za-z0-9]+', '-', root)[-40:].strip('-')}-{hashlib.sha256(root.encode()).hexdigest()[:12]}"
    )
    passed, placed, kept = [], [], set()
    for file in files:
        parts = file.name.split("/")
        if any(part in ("", ".", "..") or "\0" in part or len(os.fsencode(part)) > 200 for part in parts):
            passed.append(Passed(file.url, "its name cannot be that of a local file: passed over"))
            continue
        path = own.joinpath(*parts)
        if path.suffix.lower() != ".toml":
            placed.append((path, file))
        elif file.size <= _SMALL and not any(part.startswith(".") for part in parts):
            kept.add(path)
            _instructed(file, path)
    for path in own.rglob("*.toml"):
        if path not in kept:
            path.unlink()
    return Mirror(root, own, tuple(placed), tuple(passed))


def _instructed(file: RemoteFile, path: Path) -> None:
    """Fetches a TOML file where it is not there yet. Without it recordings would be read in another way: `LabError`."""
    try:
        if not is_staged(path, file):
            fetch(file, path)
    except PendingError as error:
        raise LabError(error.problem, where=error.where, remedy="Run the nightly again") from error


def fetch(file: RemoteFile, path: Path) -> None:
    """Fetches a file's content; whole and with its time of change when this returns.

    Raises `PendingError` when it has gone or changed since it was listed or cannot be had now: a later night tries again.
    """
    try:
        with written_whole(path, durable=False) as temporary:
            store, place = _open(file.url)
            store.get_file(place, os.fspath(temporary))
            now = _described(file.url, file.name, store.info(place))
            if (now.size, now.mtime_ns, now.version) != (file.size, file.mtime_ns, file.version):
                raise PendingError("the file changed while it was fetched", where=file.url)
            if temporary.stat().st_size != file.size:
                raise PendingError("the file came in part only", where=file.url)
            os.utime(temporary, ns=(file.mtime_ns, file.mtime_ns))
    except PendingError:
        raise
    except FileNotFoundError:
        raise PendingError("the file has gone since it was found", where=file.url) from None
    except Exception as error:
        raise PendingError(f"the file cannot be fetched: {_words(error)}", where=file.url) from error


def is_staged(path: Path, file: RemoteFile) -> bool:
    """Whether the local file is the listed one."""
    try:
        info = path.stat()
    except OSError:
        return False
    return (info.st_size, info.st_mtime_ns) == (file.size, file.mtime_ns)


@contextlib.contextmanager
def staged(path: Path, file: RemoteFile | None) -> Iterator[None]:
    """The local file is there inside the block and gone after it. Does nothing for what is no remote file."""
    if file is None:
        yield
        return
    if not is_staged(path, file):
        fetch(file, path)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def forget(folder: Path) -> None:
    """Removes the recordings that were fetched below the folder of all mirrors; TOML files stay."""
    for path in folder.rglob("*"):
        if path.suffix.lower() != ".toml" and path.is_file():
            path.unlink(missing_ok=True)


def _listed(url: str) -> tuple[str, list[RemoteFile]]:
    """The whole address of what was given, and all files below it (or it alone, with what lies beside it in TOML)."""
    try:
        store, place = _open(url)
        found: dict[str, dict[str, Any]] = store.find(place, detail=True)
        if not found and not store.exists(place):
            raise FileNotFoundError
        base = place.rstrip("/")
        if set(found) == {base}:
            base = base.rpartition("/")[0]
            beside = store.find(base, maxdepth=2, detail=True)
            found |= {name: info for name, info in beside.items() if name.lower().endswith(".toml")}
        root = str(store.unstrip_protocol(place)).rstrip("/")
        files = [
            _described(str(store.unstrip_protocol(name)), name.removeprefix(f"{base}/"), info)
            for name, info in sorted(found.items())
            if info.get("type", "file") == "file"
        ]
    except FileNotFoundError:
        raise UsageError(
            "there is nothing at this address", where=url, expected="recordings or folders of them"
        ) from None
    except (LabError, UsageError):
        raise
    except Exception as error:
        raise LabError(
            f"the raw files cannot be listed: {_words(error)}",
            where=url,
            remedy="Look at the address, the rights and the network; the lab is as it was",
        ) from error
    return root, files


def _open(url: str) -> tuple[Any, str]:
    """The store behind a URL and the place in it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise LabError(
            "fsspec is not installed, which reads raw files behind URLs",
            where=url,
            remedy=advise_install("remote"),
        ) from None
    try:
        store, place = url_to_fs(url, use_listings_cache=False)
    except (ImportError, ValueError) as error:
        raise UsageError(f"this kind of address cannot be read: {_words(error)}", where=url) from None
    return store, str(place)


def _described(url: str, name: str, info: dict[str, Any]) -> RemoteFile:
    time = next((info[key] for key in _TIMES if info.get(key) is not None), 0)
    mark = next((str(info[key]) for key in _VERSIONS if info.get(key) is not None), "")
    version = int.from_bytes(hashlib.sha256(mark.encode()).digest()[:7], "big") if mark else 0
    whole = any(info.get(key) is not None for key in _OF_OBJECTS)
    return RemoteFile(url, name, int(info.get("size") or 0), _ns(time), version, whole)


def _ns(time: Any) -> int:
    if isinstance(time, str):
        time = datetime.fromisoformat(time)
    if isinstance(time, datetime):
        return int(time.timestamp()) * 1_000_000_000 + time.microsecond * 1000
    return int(float(time) * 1_000_000) * 1000


def _words(error: BaseException) -> str:
    text = str(error).strip()
    return f"{type(error).__name__}: {text.splitlines()[0][:300]}" if text else type(error).__name__
