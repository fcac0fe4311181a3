"""What people say about recordings: taken out of the analysis or back in, by whom, when and why.

The file in the lab is only appended to, so that it outlives every rebuild of the database. An exclusion takes effect
on the results with the next nightly, and on `dealab status` at once.
"""

from __future__ import annotations

import getpass
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

from pipeline.lab.lab import Lab
from schemas.errors import LabError, UsageError
from schemas.metadata import RECORDING_ID

EXCLUDE = "exclude"
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
    """Appends an annotation, on disk when this returns. Raises `UsageError` for one that says nothing."""
    check_annotation(recording_id, why)
    annotation = Annotation(
        recording_id, action, why, _name_author(), datetime.now(UTC).isoformat(timespec="milliseconds")
    )
    line = json.dumps(asdict(annotation), ensure_ascii=True) + "\n"
    handle = os.open(lab.annotations, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(handle, line.encode("ascii"))
        os.fsync(handle)
    finally:
        os.close(handle)
    return annotation


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
    """All annotations, oldest first. Raises `LabError` for a line that is none: what people said is never dropped."""
    try:
        lines = lab.annotations.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return ()
    found = []
    for number, line in enumerate(lines, start=1):
        try:
            found.append(Annotation(**json.loads(line)))
        except (ValueError, TypeError):
            raise LabError(
                "not an annotation",
                where=f"{lab.annotations}, line {number}",
                expected="a JSON object with recording_id, action, why, author, at",
                remedy="Correct or remove this line",
            ) from None
    return tuple(found)


def list_excluded(found: Sequence[Annotation]) -> frozenset[str]:
    """The recordings whose last annotation takes them out."""
    last = {annotation.recording_id: annotation.action for annotation in found}
    return frozenset(name for name, action in last.items() if action == EXCLUDE)


def _name_author() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"user {os.getuid()}" if hasattr(os, "getuid") else "unknown"
