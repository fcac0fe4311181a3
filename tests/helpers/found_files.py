"""What is found among files and folders, all of it at once: for tests of the walk."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import ingest.discover
from ingest.discover import SourceFile


@dataclass(frozen=True)
class Discovery:
    """Files in the order of their paths, and notes on what was passed over."""

    files: tuple[SourceFile, ...]
    notes: tuple[str, ...]


def discover(paths: Sequence[Path], *, skip: Sequence[Path] = ()) -> Discovery:
    """All files and notes of a walk."""
    notes: list[str] = []
    files = sorted(
        ingest.discover.discover(paths, lambda passed: notes.append(str(passed)), skip=skip),
        key=lambda one: os.fspath(one.path),
    )
    return Discovery(tuple(files), tuple(notes))
