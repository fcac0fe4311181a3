"""The night's second step: contents that are new, or made from something else than now, are read in workers.

What comes of a content lies in the journal until the night publishes it: the row of the recording, its results, and its
samples beside. Does not belong here: which content is which recording (`pipeline.nightly.ownership`).
"""

from __future__ import annotations

import functools
import os
import shutil
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ingest.discover import SourceFile, with_mapping
from ingest.paths import is_there, spell_source
from ingest.remote import staged
from pipeline.analyse.analysis import Analysis
from pipeline.analyse.description import recordings_table, refused_row
from pipeline.lab.inputs import split_kinds
from pipeline.lab.journal import (
    ACCIDENT,
    DAMAGED,
    FAILED,
    OK,
    PENDING,
    QUARANTINED,
    RECORDING,
    Freshness,
    Outcome,
    entry_name,
    explain_unwritable,
    is_accident,
    list_entries,
    make_item_id,
    write_entry,
)
from pipeline.nightly.freshness import hash_input, hash_mapping, hash_rig, leave_out_fresh
from pipeline.nightly.ledger import book_accident, book_outcomes
from pipeline.nightly.look import SOURCE, Found, make_source
from pipeline.nightly.ownership import (
    ANALYSED_SQL,
    HAS_CONTENT,
    ITEM,
    collect_readings,
    place_contents,
    set_aside,
)
from pipeline.nightly.stages import CALIBRATION_KINDS, Night
from schemas.errors import AccidentError, DealabError, LabError, PendingError
from schemas.recording import RawRecording

if TYPE_CHECKING:
    import pyarrow as pa

_RIGS_AT_ONCE = 1024
"""Rigs and folders whose hash is remembered."""
_CONTENT = ", ".join(f"l.{name.strip()}" for name in SOURCE.split(","))
"""Columns of the file that a content is read from."""


@dataclass(frozen=True)
class RecordingTask:
    """One content to be read.

    Parameters
    ----------
    source : the file, its mapping, and its size and time when it was hashed
    sha256 : of its content
    rigs : folder of rig files, None to look beside the recordings
    lab : the lab's folder
    staged : file that gets the samples, until the recording is accepted
    journal : folder that gets the results
    code_version, settings_hash : of the stage, as the night began
    """

    source: SourceFile
    sha256: str
    rigs: Path | None
    lab: Path
    staged: Path
    journal: Path
    code_version: str
    settings_hash: str

    @property
    def item_id(self) -> str:
        return make_item_id(RECORDING, self.sha256)

    @property
    def name(self) -> str:
        return f"{self.source.path.name} {self.source.part}".rstrip()

    def perform(self) -> Outcome:
        """Reads and analyses the file and keeps what comes of it.

        Whatever is wrong with the file ends as an outcome with its reason. What the results say is up to the modules
        that are imported here and in `_read` (`Stage.modules`); this class only brings them together.

        Raises
        ------
        LabError : the lab cannot be written
        MemoryError : memory ends
        """
        from pipeline.analyse.carried import carried_table

        started = time.monotonic()
        try:
            found = self._read()
        except PendingError as error:
            return self._set_aside(error.problem, accident=False)
        except AccidentError as error:
            return self._set_aside(str(error), accident=True)
        outcome = self._describe(found, round(time.monotonic() - started, 3))
        row = found.row | {"rig_id": found.row.get("rig_id") or found.rig_id, "samples_path": found.samples}
        found.analysis.add({"recordings": self._tabulate(row)})
        tables = found.analysis.joined()
        if row.get("recording_id") is not None:
            tables["carried"] = carried_table(row["recording_id"], found.analysis.carried)
        write_entry(self.journal, outcome, tables)
        return outcome

    def _read(self) -> _Finding:
        """What is in the file: its row, results and samples, or why there are none."""
        from ingest.intake import check_recording, list_metadata, name_rig, read_source
        from ingest.samples import write_samples
        from pipeline.analyse.recording import analyse_content

        kind = self.source.mapping.kind if self.source.mapping is not None else RECORDING
        raw, trace = None, ""
        try:
            with staged(self.source.path, self.source.remote):
                raw = read_source(self.source)
                if isinstance(raw, RawRecording):
                    recording = check_recording(raw, self.source, sha256=self.sha256, rigs=self.rigs)
                    raw = replace(raw, channels=())  # its samples are those of the recording, in other units
                    samples = self._write(functools.partial(write_samples, recording, self.lab, staged=self.staged))
                    return _Finding(name_rig(raw), *analyse_content(recording, kind), samples)
                return _Finding(name_rig(raw), *analyse_content(raw, kind))
        except (LabError, MemoryError, PendingError, AccidentError):
            raise
        except DealabError as error:
            problem = error
        except Exception as error:
            if is_accident(error):
                raise AccidentError(f"{type(error).__name__}: {error}") from error
            summary = f"reading it failed unexpectedly: {type(error).__name__}: {error}"
            problem = DealabError(summary, where=self.source.path.name, remedy="Report this with the file")
            trace = f"{summary}\n{traceback.format_exc()}"
        row = refused_row(list_metadata(raw), str(problem), kind)
        return _Finding(name_rig(raw), row, Analysis(), None, problem, trace)

    def _write(self, write: Callable[[], str]) -> str:
        try:
            return write()
        except OSError as error:
            raise explain_unwritable(self.staged.parent, error) from error

    def give_up(self, reason: str) -> Outcome:
        """The file's worker did not come back: an accident, which says nothing about the content."""
        return self._set_aside(
            f"reading or analysing it failed twice: {reason}; with other deadline_s or memory_mb in the lab's"
            " settings.toml it may go well",
            accident=True,
        )

    def _set_aside(self, reason: str, *, accident: bool) -> Outcome:
        """Nothing is known of the content tonight: earlier results stay, and the next night reads it."""
        facts = {ACCIDENT: accident, "source_path": spell_source(self.source)}
        return Outcome(
            self.item_id, RECORDING, Freshness("", self.code_version, self.settings_hash), PENDING, 0.0, reason, facts
        )

    def _describe(self, found: _Finding, seconds: float) -> Outcome:
        """How reading the file ended.

        What is to be tried again the next night is made from nothing that could be the same then: what failed
        unexpectedly is no verdict either.
        """
        problem, failures = found.problem, found.analysis.failures
        ending, error_text = OK if found.row["status"] == "ok" else DAMAGED, None
        if problem is not None:
            ending, error_text = QUARANTINED, found.trace or str(problem)
        elif failures:
            ending, error_text = FAILED, "\n".join(failures)
        facts = {
            **{name: found.row.get(name) for name in ("recording_id", "specimen_id", "protocol", "status", "problem")},
            "rig_id": found.rig_id,
            "samples_path": found.samples,
            "refusal": None if problem is None else problem.as_dict(),
            "carried": sorted({type(result).__name__ for result in found.analysis.carried}),
            "notes": found.analysis.missing,
        }
        passes = problem is not None and (problem.transient or bool(found.trace))
        made_from = "" if passes else self._hash_input(found.rig_id)
        freshness = Freshness(made_from, self.code_version, self.settings_hash)
        return Outcome(self.item_id, RECORDING, freshness, ending, seconds, error_text, facts)

    def _tabulate(self, row: dict[str, Any]) -> pa.Table:
        """The row of `recordings` with the place and the content that it speaks of."""
        place = {"source_path": spell_source(self.source), "source_sha256": self.sha256, "source_present": True}
        return recordings_table([row | place])

    def _hash_input(self, rig_id: str | None) -> str:
        rig_hash = hash_rig(rig_id, self.source.path, self.source.root, self.rigs)
        return hash_input(hash_mapping(self.source), self.sha256, rig_hash)


@dataclass(frozen=True)
class _Finding:
    """What a worker found in a file: its row of `recordings`, its results, where its samples are; or its problem."""

    rig_id: str | None
    row: dict[str, Any]
    analysis: Analysis
    samples: str | None = None
    problem: DealabError | None = None
    trace: str = ""


def adopt_journal(night: Night) -> None:
    """Takes over the whole entries that a killed night left, and removes what it left half done."""
    journal, staging, ledger = night.lab.journal, night.lab.staging, night.ledger
    journal.mkdir(parents=True, exist_ok=True)
    whole = (outcome for path, outcome in list_entries(journal) if path.name == entry_name(outcome.item_id))
    book_outcomes(ledger, whole, done=False)
    for path in _list_folder(journal):
        if ledger.row("SELECT 1 FROM outcomes WHERE entry = ?", [path.name]) is None:
            path.unlink()
    for path in _list_folder(staging) if staging.is_dir() else ():
        if path.is_dir():
            shutil.rmtree(path)
        elif ledger.row("SELECT 1 FROM outcomes WHERE item_id = ?", [make_item_id(RECORDING, path.stem)]) is None:
            path.unlink()


def _list_folder(folder: Path) -> Iterator[Path]:
    with os.scandir(folder) as found:
        for one in found:
            yield Path(one.path)


def read_contents(night: Night, found: Found) -> None:
    """Reads what is new, and again what a verdict turns out to need. Files that change meanwhile become pending."""
    ledger = night.ledger
    place_contents(ledger, functools.partial(is_there, roots=found.roots))
    ledger.add("expected", _list_expected(night))
    code_version, settings_hash = night.version(RECORDING)
    leave_out_fresh(ledger, RECORDING, code_version, settings_hash)
    prefix = len(make_item_id(RECORDING, ""))
    ledger.run(
        "INSERT INTO stale SELECT DISTINCT substr(item_id, ?) FROM expected WHERE stage = ?", [prefix + 1, RECORDING]
    )
    while True:
        set_aside(ledger, _read_stale(night))
        collect_readings(ledger, one_case=night.lab.is_of_one_case)
        ledger.run("DELETE FROM stale")
        ledger.run(
            "INSERT INTO stale SELECT sha256 FROM readings r WHERE accepted"
            f" AND NOT EXISTS (SELECT 1 FROM known WHERE source_sha256 = r.sha256 AND status {ANALYSED_SQL})"
            f" AND NOT EXISTS (SELECT 1 FROM outcomes WHERE done AND item_id = {ITEM} r.sha256)"
        )
        if not ledger.number("SELECT count(*) FROM stale"):
            return


def include_recordings(night: Night, excluded: frozenset[str]) -> None:
    """Books the recordings that take part in the analysis."""
    ledger = night.ledger
    found = ledger.each(
        "SELECT r.recording_id, o.item_id, o.specimen_id, o.rig_id, o.carried, o.input_hash, o.code_version,"
        " o.settings_hash, o.entry, k.specimen_id, k.rig_id,"
        " (SELECT group_concat(kind) FROM carried c WHERE c.recording_id = r.recording_id),"
        " i.input_hash, i.code_version, i.settings_hash, NULL"
        f" FROM readings r LEFT JOIN outcomes o ON o.done AND o.item_id = {ITEM} r.sha256"
        " LEFT JOIN known k ON k.rowid ="
        f" (SELECT max(rowid) FROM known WHERE source_sha256 = r.sha256 AND status {ANALYSED_SQL})"
        f" LEFT JOIN items i ON i.item_id = {ITEM} r.sha256"
        " WHERE r.accepted AND r.recording_id IS NOT NULL"
    )

    def include() -> Iterator[tuple[Any, ...]]:
        for name, item, *rest in found:
            specimen_id, rig_id, kinds, *made_from = rest[:7] if item is not None else rest[7:]
            if name not in excluded:
                calibrates = not CALIBRATION_KINDS.isdisjoint(split_kinds(kinds))
                yield name, specimen_id, rig_id, kinds, calibrates, *made_from

    ledger.add("included", include())


def _list_expected(night: Night) -> Iterator[tuple[str, str, str | None]]:
    """The contents, each with what its results would be made from now; its rig is that of an earlier reading.

    One whose samples are lost is made anew, whatever it was made from.
    """
    hash_rig_of = _remember_rigs(night.rigs)
    found = night.ledger.each(
        f"SELECT c.sha256, l.mapping, o.item_id, o.rig_id, k.rowid, k.rig_id, k.samples_path, {_CONTENT}"
        " FROM contents c JOIN looks l ON l.id = c.look"
        f" LEFT JOIN outcomes o ON o.item_id = {ITEM} c.sha256"
        " LEFT JOIN known k ON k.rowid ="
        f" (SELECT max(rowid) FROM known WHERE source_sha256 = c.sha256 AND {HAS_CONTENT})"
        " WHERE c.at_home"
    )
    for sha256, mapping, left, left_rig, row, known_rig, samples, *where in found:
        item = make_item_id(RECORDING, sha256)
        if samples is not None and not (night.lab.folder / samples).is_file():
            yield item, RECORDING, None
            continue
        rigs = {rig for there, rig in ((left, left_rig), (row, known_rig)) if there is not None}
        for rig_id in rigs:
            rig_hash = "" if rig_id is None else hash_rig_of(rig_id, make_source(*where))
            yield item, RECORDING, hash_input(mapping, sha256, rig_hash)
        if not rigs:
            yield item, RECORDING, None


def _remember_rigs(rigs: Path | None) -> Callable[[str, SourceFile], str]:
    """A function for the hash of the rig's file of a recording, which looks it up once per rig and folder."""

    @functools.lru_cache(maxsize=_RIGS_AT_ONCE)
    def look_up(rig_id: str, folder: Path, root: Path) -> str:
        return hash_rig(rig_id, folder / "any recording", root, rigs)

    return lambda rig_id, source: look_up(rig_id, source.path.parent, source.root)


def _read_stale(night: Night) -> dict[str, str]:
    """Reads the stale contents in workers; returns those of which nothing could be learnt, each with the reason."""
    count = night.ledger.number("SELECT count(*) FROM stale")
    aside = {}
    for task, outcome in night.perform(_make_tasks(night), count, "recordings"):
        if outcome.accident:
            aside[task.sha256] = book_accident(night.ledger, outcome, night.run_id)
        elif outcome.outcome == PENDING:
            aside[task.sha256] = outcome.error or "the file changed while it was read"
        else:
            book_outcomes(night.ledger, [outcome], done=True)
    return aside


def _make_tasks(night: Night) -> Iterator[RecordingTask]:
    """One for each stale content, in the order of the files (those not looked at first)."""
    code_version, settings_hash = night.version(RECORDING)
    found = night.ledger.each(
        f"SELECT c.sha256, {_CONTENT} FROM stale JOIN contents c USING (sha256) JOIN looks l ON l.id = c.look"
        " ORDER BY c.length, c.first, c.sha256"
    )
    for sha256, *where in found:
        yield RecordingTask(
            source=with_mapping(make_source(*where)),
            sha256=sha256,
            rigs=night.rigs,
            lab=night.lab.folder,
            staged=night.lab.staged(sha256),
            journal=night.lab.journal,
            code_version=code_version,
            settings_hash=settings_hash,
        )
