"""Texts that are stored compressed, `run7.csv.gz` or a zip archive of one file: their names without it, their content.

A file that ends too early is read as far as it goes. One whose checksum does not agree is refused: nobody can say which
of its values are whole. Does not belong here: workbooks and NumPy archives, which are zipped by themselves.
"""

from __future__ import annotations

import bz2
import contextlib
import lzma
import re
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from ingest.zip_cut import list_members
from schemas.errors import RefusedError

TEXTS = ("csv", "lvm", "trios", "uff")
"""Formats that are read from compressed files: texts shrink to a tenth, the others are compressed already."""
ZIP = ".zip"
_SMALLEST_LIMIT, _LARGEST_LIMIT, _MOST_TIMES = 1 << 26, 1 << 30, 200
"""Bytes that any file may inflate to, bytes that none may, and how many times its size one in between may. Measured
texts inflate 3 to 30 times, a column of a single value 200 times; a file made to fill the memory 1000 times."""
_MOST_OF_XZ = 1 << 28
"""Bytes that xz may take to inflate anything: its strongest setting takes 65 MiB."""
_PIECE, _MADE = 1 << 16, 1 << 20
"""Bytes that are inflated, and made, at a time."""
_FILLED = re.compile(rb"[^\x00]")
_OF_A_MAC = "__MACOSX/"


@dataclass(frozen=True)
class Plain:
    """The bytes of a file as they were before it was compressed, and what is wrong with them."""

    content: bytes
    problems: tuple[str, ...] = ()


def is_compressed(path: PurePath) -> bool:
    """Whether the name is that of a compressed file, in capitals or not."""
    return path.suffix.lower() in (*_INFLATERS, ZIP)


def find_inner_name(path: PurePath) -> PurePath:
    """The name without the ending of the compression: `run7.csv` of `run7.csv.gz`; other names as they are."""
    return PurePath(path.stem) if is_compressed(path) else PurePath(path.name)


def find_stem(path: PurePath) -> str:
    """The name without its endings, for identities; bytes that are no UTF-8 become question marks."""
    return find_inner_name(path).stem.encode("utf-8", "replace").decode()


def find_suffix(path: PurePath) -> str:
    """The ending that tells the format: `.csv` of `run7.csv.gz`."""
    return find_inner_name(path).suffix


def find_held_suffix(path: Path) -> str:
    """The ending of the one file in an archive whose own name does not tell it. Raises `RefusedError`."""
    if path.suffix.lower() != ZIP or find_suffix(path):
        return find_suffix(path)
    with _refused(path), zipfile.ZipFile(path) as archive:
        return PurePath(_only_member(archive, path).filename).suffix


def read_plain_content(path: Path) -> Plain:
    """The bytes of a file, inflated where its name says that it is compressed.

    Raises
    ------
    RefusedError
        It is damaged, locked, an archive of several files, or inflates to more than a file of its size may.
    OSError
        It cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ZIP:
        return _read_archive(path)
    content = path.read_bytes()
    if suffix not in _INFLATERS:
        return Plain(content)
    with _refused(path):
        return _inflate(content, suffix, path)


@contextlib.contextmanager
def plain_file(path: Path) -> Iterator[tuple[Path, tuple[str, ...]]]:
    """The file, or an inflated copy for as long as it is needed, for parsers that want a path; and its problems."""
    if not is_compressed(path):
        yield path, ()
        return
    plain = read_plain_content(path)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / find_inner_name(path).name
        copy.write_bytes(plain.content)
        yield copy, plain.problems


def _limit(size: int) -> int:
    return min(_LARGEST_LIMIT, max(_SMALLEST_LIMIT, _MOST_TIMES * size))


def _inflate(content: bytes, suffix: str, path: Path) -> Plain:
    """All streams of a file, one behind the other, as the usual programs read them."""
    limit = _limit(len(content))
    inflated = bytearray()
    at = 0
    while True:
        end = _inflate_stream(_INFLATERS[suffix](), content, at, inflated, limit, path)
        if end is None:
            whole = inflated.rfind(b"\n") + 1
            whole += inflated[whole : whole + 1] == b"\x00"  # the second byte of a line end in UTF-16
            if not whole:
                raise _damaged(path, EOFError("it ends before its first line does"))
            return Plain(bytes(inflated[:whole]), ("the compressed file ends too early: what comes after is lost",))
        found = _FILLED.search(content, end)
        if found is None:
            return Plain(bytes(inflated))
        at = found.start()
        if not content.startswith(_BEGINNINGS[suffix], at):
            lost = f"{len(content) - at} bytes behind the compressed data are something else and were left out"
            return Plain(bytes(inflated), (lost,))


def _inflate_stream(inflater: Any, content: bytes, at: int, inflated: bytearray, limit: int, path: Path) -> int | None:
    """Adds what the stream at a place inflates to; the place behind it, None where it does not come to its end."""
    view = memoryview(content)
    for start in range(at, len(content), _PIECE):
        piece: Any = view[start : start + _PIECE]
        while True:
            made = inflater.decompress(piece, _MADE)
            inflated += made
            if len(inflated) > limit:
                raise _too_large(path, limit)
            if inflater.eof:
                return min(start + _PIECE, len(content)) - len(inflater.unused_data)
            piece = getattr(inflater, "unconsumed_tail", b"")  # bz2 and lzma keep it to themselves
            if not piece and len(made) < _MADE:
                break
    return None


def _gunzip() -> Any:
    return zlib.decompressobj(wbits=31)


_INFLATERS: dict[str, Callable[[], Any]] = {
    ".gz": _gunzip,
    ".bz2": bz2.BZ2Decompressor,
    ".xz": lambda: lzma.LZMADecompressor(memlimit=_MOST_OF_XZ),
}
# RuntimeError is also what zipfile raises for a kind of compression that it does not know.
_DAMAGED = (
    zlib.error, lzma.LZMAError, zipfile.BadZipFile, struct.error, EOFError, OSError, ValueError, RuntimeError,
    OverflowError, LookupError,
)  # fmt: skip
"""What the decompressors raise for damaged files."""
_BEGINNINGS = {".gz": b"\x1f\x8b", ".bz2": b"BZh", ".xz": b"\xfd7zXZ\x00"}


def _read_archive(path: Path) -> Plain:
    if not zipfile.is_zipfile(path):  # the list of its files, at the end, is lost
        return _read_cut_archive(path)
    with _refused(path), zipfile.ZipFile(path) as archive:
        member = _only_member(archive, path)
        limit = _limit(path.stat().st_size)
        if member.file_size > limit:
            raise _too_large(path, limit)
        if member.flag_bits & 1:
            raise RefusedError(
                "the archive is locked with a password",
                where=path.name,
                expected="a readable archive",
                remedy="Unpack it",
            )
        with archive.open(member) as file:
            return Plain(file.read(limit + 1))


def _read_cut_archive(path: Path) -> Plain:
    """The one file of an archive without its end, as far as it goes. Raises `RefusedError` where there is none."""
    content = path.read_bytes()
    limit = _limit(len(content))
    with _refused(path):
        members = [m for m in list_members(content) if not _is_no_file(m.name)]
        if not members or not members[0].deflated:
            raise zipfile.BadZipFile("it is no archive, or its end is missing")
        if len(members) > 1:
            raise zipfile.BadZipFile("its end is missing, and it holds several files")
        (member,) = members
        inflated = member.begin(limit + 1)
        if len(inflated) > limit:
            raise _too_large(path, limit)
        if member.is_there and not member.is_whole:
            raise zipfile.BadZipFile("its end is missing, and its checksum does not agree")
    whole = len(inflated) if member.is_there else inflated.rfind(b"\n") + 1
    if not whole:
        raise _damaged(path, EOFError("it ends before its first line does"))
    return Plain(inflated[:whole], ("the compressed file ends too early: what comes after is lost",))


def _is_no_file(name: str) -> bool:
    """A folder, or what a Mac adds."""
    return name.endswith("/") or name.startswith(_OF_A_MAC)


def _only_member(archive: zipfile.ZipFile, path: Path) -> zipfile.ZipInfo:
    members = [m for m in archive.infolist() if not _is_no_file(m.filename)]
    if len(members) != 1:
        shown = ", ".join(m.filename[:60] for m in members[:10]) + (", …" if len(members) > 10 else "")
        raise RefusedError(
            f"the archive holds {len(members)} files{': ' if shown else ''}{shown}",
            where=path.name,
            expected="one file",
            remedy="Unpack it",
        )
    return members[0]


@contextlib.contextmanager
def _refused(path: Path) -> Iterator[None]:
    """What the decompressors raise for damaged files becomes a `RefusedError`."""
    try:
        yield
    except FileNotFoundError:
        raise
    except _DAMAGED as error:
        raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> RefusedError:
    return RefusedError(
        f"the compressed file is damaged: {str(error)[:200] or type(error).__name__}",
        where=path.name,
        expected="a whole compressed file",
        remedy="Copy the file again, or compress it anew",
    )


def _too_large(path: Path, limit: int) -> RefusedError:
    return RefusedError(
        f"the file inflates to more than {limit >> 20} MiB",
        where=path.name,
        expected=f"at most {_SMALLEST_LIMIT >> 20} MiB or {_MOST_TIMES} times its size, and {_LARGEST_LIMIT >> 20} MiB",
        remedy="Unpack it where that is meant",
    )
