"""What every part of a night shares: the lab and what it knows, the workers, and the outcomes so far."""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ingest.discover import SourceFile
from pipeline.analyse.rows.recordings import joined
from pipeline.lab.journal import Outcome, entry_name
from pipeline.lab.lab import Lab
from pipeline.lab.settings import Settings
from pipeline.nightly.freshness import code_version, digest
from pipeline.nightly.ledger import Ledger
from pipeline.nightly.stages import MODULES, perform, rig_hash
from pipeline.nightly.workers import Casualty, run_all

Track = Callable[[Iterable[Any], int, str], Iterable[Any]]
"""Shows progress: (items, how many, what they are) to the same items."""
_RIGS_AT_ONCE = 1024
"""Rigs and folders whose hash is remembered."""


@dataclass
class Context:
    """One night's surroundings.

    Parameters
    ----------
    lab, settings : the lab, and what it chose
    ledger : what is known of every recording, from earlier nights and from this one
    rigs : folder with rig files, None to look beside the recordings
    jobs, open_executor : number of workers, and how to get an executor with so many
    track : shows progress
    """

    lab: Lab
    settings: Settings
    ledger: Ledger
    rigs: Path | None
    jobs: int
    open_executor: Callable[[int], Executor]
    track: Track
    _rig_hashes: dict[tuple[str | None, str, Path], str] = field(default_factory=dict)
    _versions: dict[str, tuple[str, str]] = field(default_factory=dict)

    def version(self, stage: str) -> tuple[str, str]:
        """Code version and settings hash of a stage."""
        if stage not in self._versions:
            self._versions[stage] = code_version(MODULES[stage]), digest(self.settings.of_stage(stage))
        return self._versions[stage]

    @functools.cached_property
    def limits_hash(self) -> str:
        """Stands for the settings in what a casualty was made from: with other limits it is tried again."""
        return digest([self.settings.deadline_s, self.settings.memory_mb])

    def leave_out_fresh(self, stage: str) -> None:
        """Of the items of a stage that are `expected`, leaves those that have to be made.

        Fresh is one whose results, published or left in the journal, are what making it again would give.
        """
        code, settings = self.version(stage)
        same = (
            "made.item_id = e.item_id AND made.input_hash = e.input_hash AND made.code_version = ?"
            " AND made.settings_hash IN (?, ?) WHERE e.stage = ?"
        )
        good = [code, settings, self.limits_hash, stage]
        fresh = f"IN (SELECT e.item_id FROM expected e CROSS JOIN {{}} made ON {same})"
        self.ledger.run(f"UPDATE outcomes SET done = 1 WHERE item_id {fresh.format('outcomes')}", good)
        self.ledger.run(f"DELETE FROM expected WHERE item_id {fresh.format('items')}", good)
        self.ledger.run("DELETE FROM expected WHERE item_id IN (SELECT item_id FROM outcomes WHERE done)")

    def rig_hash(self, source: SourceFile, rig_id: str | None) -> str:
        """Hash of the file of a recording's rig; looked up once per rig and folder, as far as there are not very many."""
        key = (rig_id, os.path.dirname(source.path), source.root)
        if key not in self._rig_hashes:
            if len(self._rig_hashes) >= _RIGS_AT_ONCE:
                self._rig_hashes.clear()
            self._rig_hashes[key] = rig_hash(source, rig_id, self.rigs)
        return self._rig_hashes[key]

    def keep(self, outcomes: Iterable[Outcome], *, done: bool) -> None:
        """Books outcomes whose entries lie in the journal; `done` where they are tonight's."""
        self.ledger.add("outcomes", (_booked(outcome, done) for outcome in outcomes))

    def run(self, tasks: Iterable[Any], count: int, what: str) -> Iterator[tuple[Any, Outcome | Casualty]]:
        """Runs a stage's tasks in workers; results as they are ready."""
        results = run_all(tasks, perform, self.open_executor, jobs=self.jobs)
        yield from self.track(results, count, what)


def _booked(outcome: Outcome, done: bool) -> tuple[Any, ...]:
    facts = outcome.facts
    refusal = facts.get("refusal")
    return (
        outcome.item_id,
        outcome.stage,
        outcome.freshness.input_hash,
        outcome.freshness.code_version,
        outcome.freshness.settings_hash,
        outcome.outcome,
        outcome.seconds,
        outcome.error,
        *(facts.get(name) for name in ("recording_id", "specimen_id", "rig_id", "status", "problem", "samples_path")),
        None if refusal is None else json.dumps(refusal),
        ",".join(sorted(facts.get("carried", ()))),
        joined(facts.get("notes", ())),
        entry_name(outcome.item_id),
        done,
    )
