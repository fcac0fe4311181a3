"""Which files are there: a walk over the raw files and folders, each file with its format, mapping and state.

Also the content hash that notices a file changing under it, and the look that tells a file still being written.
Does not belong here: reading recordings; the lab's bookkeeping of what is new (pipeline.nightly.night).
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import stat
import time
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ingest.compressed import ZIP, is_compressed
from ingest.mapping import FOLDER_FILE, FileMapping, find_mapping, format_of, own_mapping
from ingest.mapping_keys import IGNORE
from ingest.parts import list_parts, part_of
from ingest.passed_over import STRAY_TOML, Passed, Tally, explain_unread, find_kind_without_data, is_document
from ingest.plain_files import open_plain
from ingest.remote import Mirror, RemoteFile
from ingest.rigs import FOLDER as RIGS
from schemas.alike import ask_meant
from schemas.errors import DealabError, PendingError, RefusedError, UsageError
from schemas.visible import shown

NATIVE, MAPPED, UNMAPPED = "native", "mapped", "unmapped"
_YOUNG_S = 60.0
_LOOK_S = 1.0
_UNFINISHED = (".part", ".partial", ".tmp", ".crdownload", ".filepart", ".swp", "~")
_MCAP_MAGIC = b"\x89MCAP0\r\n"
_FOLDERS_AT_ONCE = 64
"""Folders whose listing is remembered: those on the way down to the one that is walked, mostly."""


@dataclass(frozen=True, slots=True)
class SourceFile:
    """A file that may be a recording.

    `path` as found below what was given, `root` the file or folder that was given, `format` as `ingest.mapping_keys.FORMATS`
    (None when unknown), `state` `native` (MCAP), `mapped` or `unmapped`. `error` says why its mapping cannot be used.
    `part` is the label of one of several recordings in the file. Of a `remote` file, `path` is the local place that it is fetched to when it is read, below `root`, which stands for
    the address that was given.
    """

    path: Path
    root: Path
    size: int
    mtime_ns: int
    format: str | None
    state: str
    mapping: FileMapping | None = None
    error: DealabError | None = None
    remote: RemoteFile | None = None
    part: str = ""


def discover(
    paths: Iterable[Path],
    note: Callable[[Passed], object],
    *,
    skip: Sequence[Path] = (),
    rigs: Path | None = None,
    mirrors: Iterable[Mirror] = (),
    first_time: Callable[[str], bool] | None = None,
) -> Iterator[SourceFile]:
    """The data files among files and folders, as they are found; folders are walked in sorted order.

    All others are passed over and told in a `note`, those that are plainly no data together (`ingest.passed_over`): hidden
    and unfinished files, documents, formats that are not read, links that lead nowhere or in a circle, pipes, devices,
    unreadable folders. Without a word go only mappings, rig files (of `rigs` as well) and what is under `skip`, the lab
    itself. A file that is reached twice counts once: `first_time` says whether a place is new to it, where so many are
    met that memory must not hold them. The files of `mirrors` are taken as they are listed. Raises `UsageError` for a
    given path that does not exist.
    """
    check_given(paths := tuple(paths))
    walk = _Walk([s.resolve() for s in skip], rigs, note, first_time or _Met())
    for given in paths:
        yield from walk.take(given)
    for mirror in mirrors:
        yield from walk.take_mirror(mirror)
    for passed in walk.tally.close():
        note(passed)


def check_given(paths: Iterable[str | os.PathLike[str]]) -> None:
    """Raises `UsageError` for the first path that does not exist, with one beside it that may be meant."""
    for given in paths:
        if not os.path.lexists(given):
            place = Path(given)
            beside = sorted(p.name for p in place.parent.iterdir()) if place.parent.is_dir() else []
            raise UsageError(
                f"there is no such file or folder{ask_meant(place.name, beside)}",
                where=str(given),
                expected="recordings or folders of them",
            )


def with_mapping(source: SourceFile) -> SourceFile:
    """A file that was found, known by its place and state alone, with the mapping that lies beside it now."""
    try:
        mapping = find_mapping(source.path)
    except DealabError as error:
        return replace(source, error=error)
    if mapping is not None and source.part:
        try:
            mapping = part_of(mapping, source.part)
        except DealabError as error:
            return replace(source, error=error)
    if (mapping is not None) != (source.state == MAPPED) or (mapping is not None and mapping.kind == IGNORE):
        return replace(source, error=PendingError("its mapping changed since it was found", where=source.path.name))
    return replace(source, mapping=mapping)


def file_sha256(path: Path, *, chunk: int = 1 << 20) -> str:
    """SHA-256 of a file's content. Raises `PendingError` when it changes while it is read, or has gone."""
    digest = hashlib.sha256()
    try:
        with open_plain(path) as file:
            before = os.fstat(file.fileno())
            read = 0
            while read <= before.st_size and (block := file.read(chunk)):  # what gives more has grown, or never ends
                digest.update(block)
                read += len(block)
            after = os.fstat(file.fileno())
    except FileNotFoundError:
        raise PendingError("the file has gone since it was found", where=path.name) from None
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns) or read != after.st_size:
        raise PendingError(
            f"the file changed while it was read ({before.st_size} to {max(read, after.st_size)} bytes)",
            where=path.name,
        )
    return digest.hexdigest()


def check_unchanged(path: Path, *, size: int, mtime_ns: int) -> None:
    """Raises `PendingError` when a file is no longer as it was found, so what was read of it may be mixed."""
    try:
        now = path.stat()
    except OSError:
        raise PendingError("the file has gone while it was read", where=path.name) from None
    if (now.st_size, now.st_mtime_ns) != (size, mtime_ns):
        raise PendingError(f"the file changed while it was read ({size} to {now.st_size} bytes)", where=path.name)


def growing(
    files: Iterable[SourceFile],
    *,
    now: Callable[[], float] = time.time,
    sleep: Callable[[float], None] = time.sleep,
) -> tuple[SourceFile, ...]:
    """The files that are being written: younger than a minute, without their end, other after a second than before.

    Sleeps once for all of them, and only when there is a file to ask.
    """
    young = [f for f in files if now() - f.mtime_ns * 1e-9 < _YOUNG_S and lacks_end(f.path, f.format)]
    if not young:
        return ()
    before = [_size_and_time(f.path) for f in young]
    sleep(_LOOK_S)
    return tuple(f for f, look in zip(young, before, strict=True) if _size_and_time(f.path) != look)


def lacks_end(path: Path, found: str | None) -> bool:
    """Whether a file lacks what its format ends with: the closing magic of MCAP, the last line end of text, the directory
    of a zipped workbook. Formats without an end are taken to lack it."""
    try:
        with open_plain(path) as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - len(_MCAP_MAGIC)))
            tail = file.read()
    except OSError:
        return False
    if is_compressed(path):
        return path.suffix.lower() != ZIP or not zipfile.is_zipfile(path)
    if found == "mcap":
        return tail != _MCAP_MAGIC
    if found == "csv":
        return not tail.endswith((b"\n", b"\r", b"\n\x00"))
    if found == "excel" and path.suffix.lower() != ".xls":
        return not zipfile.is_zipfile(path)
    return True


@dataclass(frozen=True)
class _Folder:
    """A folder's path without links, the TOML files in it, and the names that are links; None where it cannot be listed."""

    place: str
    instructions: frozenset[str] | None
    links: frozenset[str] | None


class _Met:
    """Says of each place whether it is met for the first time."""

    def __init__(self) -> None:
        self._places: set[str] = set()

    def __call__(self, place: str) -> bool:
        new = place not in self._places
        self._places.add(place)
        return new


_OF_A_LAB = frozenset({"results.duckdb", "samples", "reports"})
"""Names that a folder has together where it is a lab, which may lie among raw files."""


class _Walk:
    def __init__(
        self,
        skip: Sequence[Path],
        rigs: Path | None,
        note: Callable[[Passed], object],
        first_time: Callable[[str], bool],
    ) -> None:
        self.skip = skip
        self.rigs = None if rigs is None else rigs.resolve()
        self.note = note
        self.first_time = first_time
        self.tally = Tally()
        self._urls: dict[Path, str] = {}
        self._beside = functools.lru_cache(maxsize=_FOLDERS_AT_ONCE)(_folder)

    def take(self, root: Path) -> Iterator[SourceFile]:
        """One path: a file or a folder with all that is below it, however deep."""
        waiting = [iter([root])]
        while waiting:
            path = next(waiting[-1], None)
            if path is None:
                waiting.pop()
                continue
            try:
                info = path.stat()
                if stat.S_ISDIR(info.st_mode):
                    waiting.append(self._list(path, root, info))
                elif stat.S_ISREG(info.st_mode):
                    yield from self.file(path, root, info.st_size, info.st_mtime_ns)
                else:
                    self._pass(path, "a pipe, socket or device: passed over")
            except OSError as error:
                what = "a link that leads nowhere or in a circle" if _is_link(path) else error.strerror or "unreadable"
                self._pass(path, f"{what}: passed over")

    def take_mirror(self, mirror: Mirror) -> Iterator[SourceFile]:
        """The files of a remote folder, as they are listed."""
        self._urls[mirror.folder] = mirror.url
        for told in mirror.passed_over:
            self.note(told)
        for path, file in mirror.files:
            if any(part.startswith((".", "~$")) for part in file.name.split("/")):
                self.tally.take_hidden(path.name, mirror.url)
            else:
                yield from self.file(path, mirror.folder, file.size, file.mtime_ns, file)

    def _spell(self, root: Path) -> str:
        """What was given, as it was given: a URL where the root stands for one."""
        return shown(self._urls.get(root, root))

    def _pass(self, path: Path, why: str) -> None:
        """Says, or counts, that a file is passed over."""
        told = self.tally.take(shown(path), why)
        if told is not None:
            self.note(told)

    def _list(self, folder: Path, root: Path, info: os.stat_result) -> Iterator[Path]:
        """What is in a folder, in order; nothing where that has been met before. Raises `OSError`."""
        if any(folder.resolve() == s for s in self.skip) or not self.first_time(f"{info.st_dev}:{info.st_ino}"):
            return iter(())
        if folder.suffix.lower() == ".mcap":
            self._pass(folder, "a folder with the name of a recording: what is in it is looked at")
        names = sorted(os.listdir(folder))
        if set(names) >= _OF_A_LAB:
            self._pass(folder, "another lab: what dealab made is no raw data: passed over")
            return iter(())
        for name in names:
            if name.startswith((".", "~$")):
                self.tally.take_hidden(name, self._spell(root))
        return (folder / name for name in names if not name.startswith((".", "~$")))

    def file(
        self, path: Path, root: Path, size: int, mtime_ns: int, remote: RemoteFile | None = None
    ) -> Iterator[SourceFile]:
        """One file, also one that is not here yet, or each of the recordings in it: nothing but what lies beside it is read.

        Nothing where it is passed over, or has been met before. Raises `OSError`.
        """
        if path.suffix.lower() == ".toml":
            if not self._has_use(path):
                self._pass(path, STRAY_TOML)
            return
        beside = self._beside(os.path.dirname(path))
        plain = beside.links is not None and path.name not in beside.links
        if not self.first_time(os.path.join(beside.place, path.name) if plain else os.path.realpath(path)):
            return
        if path.name.lower().endswith(_UNFINISHED):
            self._pass(path, "an unfinished file: passed over")
            return
        mapping, error = None, None
        try:
            mapping = find_mapping(path, beside.instructions)
        except DealabError as found:
            error = found
        file_format = format_of(path, mapping)
        if mapping is not None and mapping.kind == IGNORE:
            self._pass(path, f"passed over, as {mapping.source} says")
            return
        unread = file_format is None and mapping is None and not own_mapping(path).is_file()
        if unread or (mapping is None and error is None and is_document(path)):
            kind = find_kind_without_data(path)
            if kind is not None:
                self.tally.take_plain(path, kind, self._spell(root))
            else:
                self._pass(path, explain_unread(path))
            return
        if mapping is None and error is None:
            state = NATIVE if file_format == "mcap" else UNMAPPED
        else:
            state = NATIVE if file_format == "mcap" and mapping is None else MAPPED
        found_file = SourceFile(path, root, size, mtime_ns, file_format, state, mapping, error, remote)
        yield from _parts(found_file) if mapping is not None and mapping.parts_file else (found_file,)

    def _has_use(self, toml: Path) -> bool:
        """Whether a TOML is a mapping of something here, or the file of a rig."""
        folder = toml.parent
        if toml.name == FOLDER_FILE or RIGS in (folder.name, folder.resolve().name):
            return True
        return toml.with_name(toml.name[: -len(toml.suffix)]).exists() or folder.resolve() == self.rigs


def _parts(file: SourceFile) -> Iterator[SourceFile]:
    """The recordings of a file that holds several; the file itself, with the reason, where they cannot be told apart."""
    assert file.mapping is not None
    try:
        if file.remote is not None:
            raise RefusedError(
                "[[select]] has each, and the file is not on this machine",
                where=file.path.name,
                expected="a local file: its values have to be read to know its recordings",
            )
        parts = list_parts(file.path, file.mapping)
        yield from [replace(file, mapping=part_of(file.mapping, part), part=part) for part in parts]
    except DealabError as error:
        yield replace(file, error=error)
    except OSError as problem:
        yield replace(file, error=RefusedError(f"the file cannot be read: {problem.strerror}", where=file.path.name))


def _is_link(path: Path) -> bool:
    try:
        return path.is_symlink()
    except OSError:
        return False


def _folder(folder: str) -> _Folder:
    instructions = links = None
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        named, linked = set(), set()
        for entry in entries:
            if entry.name.endswith(".toml"):
                named.add(entry.name)
            if entry.is_symlink():
                linked.add(entry.name)
        instructions, links = frozenset(named), frozenset(linked)
    return _Folder(os.path.realpath(folder), instructions, links)


def _size_and_time(path: Path) -> tuple[int, int] | None:
    try:
        info = path.stat()
    except OSError:
        return None
    return info.st_size, info.st_mtime_ns
