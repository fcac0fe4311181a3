"""What the later stages get of a recording: its metadata, its rig, and its results in full."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from schemas.metadata import RecordingMetadata, RigConstants, TableMetadata

Kind = TypeVar("Kind")
Stored: TypeAlias = tuple[str, Path | None]
"""A recording's id and its journal entry, None where its results are in the published snapshot."""


@dataclass(frozen=True)
class RecordingInput:
    """A recording as it lies in the store: small, plain, fit to be sent to a worker.

    `about` is the `metadata` column of `recordings`, `carried` rows of the table of that name, `damage` the problem of a
    recording that is usable in part, "" for a whole one.
    """

    recording_id: str
    kind: str
    about: str
    carried: tuple[Mapping[str, Any], ...]
    damage: str = ""


@dataclass(frozen=True)
class Measured:
    """The same for an analysis. `rig` is empty for tables that stand instead of recordings."""

    metadata: RecordingMetadata | TableMetadata
    rig: RigConstants
    results: tuple[Any, ...]
    damage: str = ""

    @property
    def recording_id(self) -> str:
        return self.metadata.recording_id

    def of(self, kind: type[Kind]) -> tuple[Kind, ...]:
        """The results of one kind."""
        return tuple(result for result in self.results if isinstance(result, kind))


def measured(given: RecordingInput) -> Measured:
    """The recording that an input holds."""
    from pipeline.analyse.carried import results_of

    about = json.loads(given.about)
    metadata: RecordingMetadata | TableMetadata
    if given.kind == "recording":
        metadata = RecordingMetadata.parse(about["recording"], where=given.recording_id)
    else:
        metadata = TableMetadata.parse(about["recording"], where=given.recording_id)
    rig = RigConstants.parse(about.get("rig", {}), where=given.recording_id)
    return Measured(metadata, rig, results_of(given.carried), given.damage)


def results_of_kind(kind: type[Kind], recordings: Iterable[RecordingInput]) -> tuple[Kind, ...]:
    """The results of one kind of all recordings, in their order, without a look at anything else."""
    from pipeline.analyse.carried import results_of

    found = (result for recording in recordings for result in results_of(recording.carried))
    return tuple(result for result in found if isinstance(result, kind))


def all_of(kind: type[Kind], recordings: Sequence[Measured]) -> tuple[Kind, ...]:
    """The results of one kind of all recordings, in their order."""
    return tuple(result for recording in recordings for result in recording.of(kind))
