"""What people say about recordings: taken out of the analysis or back in, by whom, when and why.

The file in the lab is only appended to, so that it outlives every rebuild of the database. An exclusion takes effect
on the results with the next nightly, and on `dealab status` at once.
"""

from __future__ import annotations

import getpass
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ingest.atomic import written_whole
from ingest.plain_files import open_plain
from pipeline.lab.lab import Lab
from schemas.errors import LabError, UsageError
from schemas.metadata import RECORDING_ID

EXCLUDE, INCLUDE = "exclude", "include"
UNREADABLE = "unreadable"
"""The only key of a line that holds what was no annotation."""
_EARLIEST, _LATEST = 1970, 9998
_WHY_LIMIT = 10_000


@dataclass(frozen=True)
class Annotation:
    """One line of the file. `at` is an ISO 8601 time in UTC."""

    recording_id: str
    action: str
    why: str
    author: str
    at: str


def annotate(lab: Lab, recording_id: str, action: str, why: str) -> Annotation:
    """Appends an annotation, whole and on disk when this returns.

    Lines that are none, such as half a line after a full disk, are kept as `UNREADABLE` lines, which say what stood
    there and mean nothing.

    Raises
    ------
    UsageError : an annotation that says nothing
    LabError : the file cannot be written; it is as it was
    """
    check_annotation(recording_id, why)
    lab.refuse_links()
    annotation = Annotation(
        recording_id, action, why, _name_author(), datetime.now(UTC).isoformat(timespec="milliseconds")
    )
    try:
        _set_broken_lines_aside(lab.annotations)
        _append(lab.annotations, _spell(asdict(annotation)))
    except OSError as error:
        raise LabError(
            f"what you said could not be written: {error.strerror or error}",
            where=str(lab.annotations),
            remedy="Free disk space or permissions and say it again",
        ) from None
    return annotation


def _spell(values: Mapping[str, str]) -> bytes:
    return json.dumps(values, ensure_ascii=True).encode("ascii") + b"\n"


def _append(file: Path, line: bytes) -> None:
    """Appends a line, or nothing of it. Raises `OSError`."""
    handle = os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
    try:
        before = os.fstat(handle).st_size
        try:
            left = line
            while left:
                left = left[os.write(handle, left) :]
            os.fsync(handle)
        except OSError:
            os.ftruncate(handle, before)
            raise
    finally:
        os.close(handle)


def _set_broken_lines_aside(file: Path) -> None:
    """Rewrites a file in which there are lines that are no annotations. Raises `OSError`."""
    read = list(_parse_lines(file))
    if all(one.problem is None and one.line.endswith(b"\n") for one in read):
        return
    with written_whole(file) as temporary:
        temporary.write_bytes(
            b"".join(
                one.line.rstrip(b"\r\n") + b"\n"
                if one.problem is None
                else _spell({UNREADABLE: one.line.decode("utf-8", "backslashreplace").rstrip("\r\n")})
                for one in read
            )
        )


def check_annotation(recording_id: str, why: str) -> None:
    """Raises `UsageError` for an annotation that says nothing, or about something that can be no recording."""
    if not RECORDING_ID.fullmatch(recording_id):
        raise UsageError(
            f'"{recording_id[:80]}" cannot be a recording id',
            expected="1 to 80 of A-Z a-z 0-9 . _ -, the first a letter or digit",
        )
    if not why.strip() or len(why) > _WHY_LIMIT:
        raise UsageError("--why is empty or too long", expected=f"a reason of 1 to {_WHY_LIMIT} characters")


def read_annotations(lab: Lab) -> tuple[Annotation, ...]:
    """All annotations, oldest first. What is none is left to `find_broken_lines`. Raises `LabError`."""
    return tuple(one.annotation for one in _read_lines(lab) if one.annotation is not None)


def find_broken_lines(lab: Lab) -> tuple[str, ...]:
    """The lines of the file that are no annotations and say nothing to a night, each with its place and the remedy."""
    return tuple(
        f"{lab.annotations.name}, line {number}: {one.problem}; what it said does not count. Say it again with"
        f" {lab.spell_command('exclude RECORDING --why TEXT')} or include, which sets this line aside"
        for number, one in enumerate(_read_lines(lab), start=1)
        if one.problem is not None
    )


@dataclass(frozen=True)
class _Line:
    """A line of the file: the annotation in it, or what is wrong with it; neither for one that was set aside."""

    line: bytes
    annotation: Annotation | None = None
    problem: str | None = None


def _read_lines(lab: Lab) -> list[_Line]:
    try:
        return list(_parse_lines(lab.annotations))
    except OSError as error:
        raise LabError(
            f"the annotations cannot be read: {error.strerror or error}",
            where=str(lab.annotations),
            remedy="Give this user the right to read them",
        ) from None


def _parse_lines(file: Path) -> Iterator[_Line]:
    if not os.path.lexists(file):
        return
    with open_plain(file) as lines:
        for line in lines:
            if not line.strip():
                yield _Line(line)
                continue
            try:
                content = json.loads(line.decode("utf-8"))
                yield _Line(line) if set(content) == {UNREADABLE} else _Line(line, _check_line(content))
            except (ValueError, TypeError, RecursionError, UsageError) as error:
                yield _Line(line, problem=f"not an annotation ({str(error)[:120]})")


def _check_line(content: Any) -> Annotation:
    """The annotation in a line. Raises `ValueError`, `TypeError` or `UsageError` for one that was not written by us."""
    found = Annotation(**content)
    for name, value in asdict(found).items():
        if not isinstance(value, str):
            raise TypeError(f"{name} is {type(value).__name__}")
        value.encode()
    check_annotation(found.recording_id, found.why)
    if found.action not in (EXCLUDE, INCLUDE):
        raise ValueError(f"action is {found.action[:40]}")
    at = datetime.fromisoformat(found.at)
    if at.tzinfo is None or not _EARLIEST <= at.year <= _LATEST:
        raise ValueError(f"at is {found.at[:40]}")
    return found


def list_excluded(found: Sequence[Annotation]) -> frozenset[str]:
    """The recordings whose last annotation takes them out."""
    last = {annotation.recording_id: annotation.action for annotation in found}
    return frozenset(name for name, action in last.items() if action == EXCLUDE)


def _name_author() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"user {os.getuid()}" if hasattr(os, "getuid") else "unknown"
