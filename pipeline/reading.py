"""The night's first half: raw files to recordings that are accepted, refused, duplicates or waiting."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from pipeline.execute import Casualty
from pipeline.looking import Found
from pipeline.night import Context
from pipeline.paths import is_there
from pipeline.plan import Content, Look, Reading, Verdicts, contents, judge, unseen
from pipeline.stages.tasks import RECORDING, RecordingTask, input_hash, item_id, recording_casualty
from pipeline.store.checks import ANALYSED
from pipeline.store.inputs import Included
from pipeline.store.journal import OK, PENDING, QUARANTINED, USABLE, Freshness, entries, entry_path
from pipeline.store.manifest import KnownRecording, one_set
from schemas.errors import DealabError, PendingError


@dataclass(frozen=True)
class Read:
    """What the night has read: tonight's looks, all contents with their places, and the verdict on each."""

    found: Found
    places: Mapping[str, Content]
    verdicts: Verdicts

    @functools.cached_property
    def accepted(self) -> tuple[str, ...]:
        """The contents that have results in the lab, in the order of the files (those not looked at first)."""
        found = (sha for sha in self.places if sha in self.verdicts.readings and self.verdicts.accepted(sha))
        return tuple(sorted(found, key=lambda sha: (self.places[sha].order, sha)))


def adopt_journal(context: Context) -> None:
    """Takes over the whole entries that a killed night left, and removes what it left half done."""
    journal, staging = context.lab.journal, context.lab.staging
    journal.mkdir(parents=True, exist_ok=True)
    context.earlier.update((outcome.item_id, outcome) for _, outcome in entries(journal))
    whole = {entry_path(journal, item).name for item in context.earlier}
    for path in journal.iterdir():
        if path.name not in whole:
            path.unlink()
    if staging.is_dir():
        for path in staging.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            elif item_id(RECORDING, path.stem) not in context.earlier:
                path.unlink()


def read(context: Context, found: Found) -> Read:
    """Reads what is new, and again what a verdict turns out to need. Files that change meanwhile become pending."""
    known = context.manifest.recordings
    by_content = {row.source_sha256: row for row in known if row.status not in ("duplicate", "pending")}
    published = {row.source_sha256 for row in known if row.status in ANALYSED}
    places = contents(found.looks, known, functools.partial(is_there, roots=found.roots))
    others = unseen(known, places.keys())
    stale = [content for content in places.values() if not _is_fresh(context, content, by_content)]
    while True:
        changing = _read_contents(context, stale)
        if changing:
            found = replace(found, looks=tuple(_pending(one, changing) for one in found.looks))
            places = {sha: content for sha, content in places.items() if sha not in changing}
        everything = {**others, **places}
        readings = {sha: _reading(context, sha, by_content) for sha in everything}
        read_now = Read(found, everything, judge(readings, everything, known))
        stale = [
            everything[sha]
            for sha in read_now.accepted
            if sha not in published and item_id(RECORDING, sha) not in context.done
        ]
        if not stale:
            return read_now


def included(context: Context, read_now: Read, excluded: frozenset[str]) -> list[Included]:
    """The recordings that take part in the analysis, by id."""
    rows = {row.source_sha256: row for row in context.manifest.recordings if row.status in ANALYSED}
    chosen = []
    for sha256 in read_now.accepted:
        name = read_now.verdicts.readings[sha256].recording_id
        if name is None or name in excluded:
            continue
        item = item_id(RECORDING, sha256)
        outcome = context.done.get(item)
        if outcome is not None:
            facts = outcome.facts
            kinds, made_from = one_set(frozenset(facts["carried"])), outcome.freshness
            specimen_id, rig_id = facts["specimen_id"], facts["rig_id"]
        else:
            row = rows[sha256]
            kinds = context.manifest.carried.get(name, frozenset())
            made_from = context.manifest.items[item].freshness
            specimen_id, rig_id = row.specimen_id, row.rig_id
        entry = None if outcome is None else entry_path(context.lab.journal, item)
        chosen.append(Included(name, specimen_id, rig_id, kinds, made_from, entry))
    return sorted(chosen, key=lambda one: one.recording_id)


def _is_fresh(context: Context, content: Content, known: Mapping[str | None, KnownRecording]) -> bool:
    look = content.primary
    if look is None:
        return True
    item = item_id(RECORDING, content.sha256)
    left, row = context.earlier.get(item), known.get(content.sha256)
    if left is not None and context.is_fresh(item, _expected(context, look, left.facts.get("rig_id"))):
        return True
    return row is not None and context.is_fresh(item, _expected(context, look, row.rig_id))


def _expected(context: Context, look: Look, rig_id: str | None) -> Freshness:
    made_from = input_hash(look.source, look.sha256 or "", context.rig_hash(look.source, rig_id))
    return Freshness(made_from, *context.version(RECORDING))


def _read_contents(context: Context, stale: Sequence[Content]) -> frozenset[str]:
    """Reads contents in workers; returns those that could not be read because they change."""
    code, settings = context.version(RECORDING)
    tasks = (
        RecordingTask(
            source=(content.primary or content.looks[0]).source,
            sha256=content.sha256,
            rigs=context.rigs,
            lab=context.lab.folder,
            staged=context.lab.staged(content.sha256),
            journal=context.lab.journal,
            code_version=code,
            settings_hash=settings,
        )
        for content in stale
    )
    changing = set()
    for task, result in context.run(tasks, len(stale), "recordings"):
        if isinstance(result, Casualty):
            result = recording_casualty(replace(task, settings_hash=context.limits_hash), result.reason)
        if result.outcome == PENDING:
            changing.add(task.sha256)
        else:
            context.done[result.item_id] = result
    return frozenset(changing)


def _reading(context: Context, sha256: str, known: Mapping[str | None, KnownRecording]) -> Reading:
    """What reading a content gave, from tonight's outcome or from what is published."""
    item = item_id(RECORDING, sha256)
    outcome = context.done.get(item)
    if outcome is not None:
        facts = outcome.facts
        refusal = facts.get("refusal")
        error = None if refusal is None else DealabError(**refusal)
        return Reading(facts.get("recording_id"), facts["status"], facts["problem"], error)
    row, booked = known[sha256], context.manifest.items.get(item)
    if booked is not None and booked.outcome in USABLE:
        return Reading(row.recording_id, booked.outcome, row.problem)
    if row.status in ANALYSED:
        return Reading(row.recording_id, row.status if row.status in USABLE else OK, row.problem)
    return Reading(row.recording_id, QUARANTINED, row.problem)


def _pending(look: Look, changing: frozenset[str]) -> Look:
    if look.sha256 not in changing:
        return look
    return replace(
        look, sha256=None, error=PendingError("the file changed while it was read", where=look.source.path.name)
    )
