"""What every part of a night shares: the lab and what it knows, the workers, and the outcomes so far."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ingest.discover import SourceFile
from pipeline.execute import Casualty, run_all
from pipeline.freshness import code_version, digest
from pipeline.lab import Lab
from pipeline.settings import Settings
from pipeline.stages.tasks import MODULES, perform, rig_hash
from pipeline.store.journal import Freshness, Outcome, held_once
from pipeline.store.manifest import Manifest

Track = Callable[[Iterable[Any], int, str], Iterable[Any]]
"""Shows progress: (items, how many, what they are) to the same items."""


@dataclass
class Context:
    """One night's surroundings.

    Parameters
    ----------
    lab, settings, manifest : the lab, what it chose, and what it knows from earlier nights
    rigs : folder with rig files, None to look beside the recordings
    jobs, open_executor : number of workers, and how to get an executor with so many
    track : shows progress
    earlier : outcomes that a killed night left in the journal
    done : outcomes that are new since the last publish, by item
    """

    lab: Lab
    settings: Settings
    manifest: Manifest
    rigs: Path | None
    jobs: int
    open_executor: Callable[[int], Executor]
    track: Track
    earlier: dict[str, Outcome] = field(default_factory=dict)
    done: dict[str, Outcome] = field(default_factory=dict)
    _rig_hashes: dict[tuple[str | None, str, Path], str] = field(default_factory=dict)
    _versions: dict[str, tuple[str, str]] = field(default_factory=dict)

    def version(self, stage: str) -> tuple[str, str]:
        """Code version and settings hash of a stage."""
        if stage not in self._versions:
            self._versions[stage] = code_version(MODULES[stage]), digest(self.settings.of_stage(stage))
        return self._versions[stage]

    @cached_property
    def limits_hash(self) -> str:
        """Stands for the settings in what a casualty was made from: with other limits it is tried again."""
        return digest([self.settings.deadline_s, self.settings.memory_mb])

    def is_fresh(self, item_id: str, expected: Freshness) -> bool:
        """Whether an item's results, published or left in the journal, are what making it again would give."""
        good = (expected, replace(expected, settings_hash=self.limits_hash))
        left = self.earlier.get(item_id)
        if left is not None and left.freshness in good:
            self.done[item_id] = left
            return True
        booked = self.manifest.items.get(item_id)
        return booked is not None and booked.freshness in good

    def rig_hash(self, source: SourceFile, rig_id: str | None) -> str:
        """Hash of the file of a recording's rig; looked up once per rig and folder."""
        key = (rig_id, os.path.dirname(source.path), source.root)
        if key not in self._rig_hashes:
            self._rig_hashes[key] = rig_hash(source, rig_id, self.rigs)
        return self._rig_hashes[key]

    def run(self, tasks: Iterable[Any], count: int, what: str) -> Iterator[tuple[Any, Outcome | Casualty]]:
        """Runs a stage's tasks in workers; results as they are ready."""
        results = run_all(tasks, perform, self.open_executor, jobs=self.jobs)
        for task, result in self.track(results, count, what):
            yield task, held_once(result) if isinstance(result, Outcome) else result
