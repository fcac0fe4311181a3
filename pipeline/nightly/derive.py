"""The night's second half: specimens and groups, made again where their recordings changed."""

from __future__ import annotations

import contextlib
import functools
import itertools
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

from pipeline.lab.inputs import Included, fetch, kinds_of, write_members
from pipeline.lab.journal import Freshness
from pipeline.lab.manifest import published
from pipeline.lab.reader import Reader
from pipeline.nightly.context import Context
from pipeline.nightly.freshness import digest_of_lists
from pipeline.nightly.stages import (
    CALIBRATION_KINDS,
    DIAGNOSIS,
    DIAGNOSIS_KIND,
    GROUP,
    GROUPS,
    SPECIMEN,
    SPECIMEN_KINDS,
    DerivedTask,
    derived_casualty,
    item_id,
)
from pipeline.nightly.workers import Casualty

_Calibrations = Callable[[frozenset[str]], tuple[Included, ...]]
_RIGS_AT_ONCE = 32
"""Sets of rigs whose calibrations are remembered."""
_INCLUDED = "SELECT * FROM included WHERE"
_FIRST = {DIAGNOSIS: 0, GROUP: 1, SPECIMEN: 2}
"""None needs another's result. The longest come first, so that no worker is left alone with one at the end."""


@dataclass(frozen=True)
class _Item:
    """An item about a specimen and the recordings that it is made from."""

    item_id: str
    stage: str
    recordings: tuple[Included, ...]
    calibrations: tuple[Included, ...] = ()

    @property
    def input_hash(self) -> str:
        return digest_of_lists(map(_identity, part) for part in (self.recordings, self.calibrations))


def derive(context: Context) -> None:
    """Makes what is not fresh of the recordings that are included; books all items that there have to be as `derived`."""
    ledger = context.ledger
    ledger.add("derived", _items(context))
    ledger.run("INSERT INTO expected SELECT item_id, stage, input_hash FROM derived")
    for stage in _FIRST:
        context.leave_out_fresh(stage)
    _make(context)


def items_of(specimen_id: str, recordings: Iterable[Included], calibrations: _Calibrations) -> Iterator[_Item]:
    """The items of a specimen. A diagnosis is one of them where it was measured in a way that a model describes, also where
    none of it can be asked."""
    recordings = tuple(recordings)
    fitted = tuple(one for one in recordings if one.kinds & SPECIMEN_KINDS)
    if fitted:
        yield _Item(item_id(SPECIMEN, specimen_id), SPECIMEN, fitted, calibrations(_rigs(fitted)))
    asked = tuple(one for one in recordings if one.kinds & (SPECIMEN_KINDS | {DIAGNOSIS_KIND}))
    if any(not one.kinds & CALIBRATION_KINDS for one in asked):
        yield _Item(item_id(DIAGNOSIS, specimen_id), DIAGNOSIS, asked, calibrations(_rigs(asked)))


def _rigs(recordings: Iterable[Included]) -> frozenset[str]:
    return frozenset(one.rig_id for one in recordings if one.rig_id is not None)


def _items(context: Context) -> Iterator[tuple[Any, ...]]:
    """All items, each with its stage, what it is made from and how many recordings that is."""
    of_rigs = _of_rigs(context)
    with_specimen = _included(context, f"{_INCLUDED} specimen_id IS NOT NULL ORDER BY specimen_id, recording_id")
    for specimen_id, members in itertools.groupby(with_specimen, attrgetter("specimen_id")):
        for item in items_of(specimen_id, members, of_rigs):
            yield item.item_id, item.stage, item.input_hash, len(item.recordings)
    for name in GROUPS:
        count = itertools.count()
        identities = (_identity(one) for one, _ in zip(_members(context, name), count, strict=False))
        input_hash = digest_of_lists((identities, ()))
        if number := next(count):
            yield item_id(GROUP, name), GROUP, input_hash, number


def _make(context: Context) -> None:
    ledger = context.ledger
    count = ledger.number("SELECT count(*) FROM expected JOIN derived USING (item_id)")
    if not count:
        return
    # Groups fetch what they need themselves.
    alone = not ledger.number(
        "SELECT count(*) FROM expected JOIN derived d USING (item_id) WHERE d.stage <> ?", [GROUP]
    )
    with (
        contextlib.nullcontext() if alone else published(context.lab) as reader,
        tempfile.TemporaryDirectory(prefix="members-", dir=context.lab.work) as folder,
    ):
        for task, result in context.run(_tasks(context, reader, Path(folder)), count, "analyses"):
            if isinstance(result, Casualty):
                limits = replace(task.freshness, settings_hash=context.limits_hash)
                result = derived_casualty(replace(task, freshness=limits), result.reason)
            context.keep([result], done=True)


def _tasks(context: Context, reader: Reader | None, folder: Path) -> Iterator[DerivedTask]:
    """The tasks of what has to be made, with what they are made from: fetched here, or where to fetch it."""
    of_rigs = _of_rigs(context)
    place = " ".join(f"WHEN '{stage}' THEN {number}" for stage, number in _FIRST.items())
    stale = context.ledger.each(
        "SELECT item_id, d.stage, d.input_hash FROM expected JOIN derived d USING (item_id)"
        f" ORDER BY CASE d.stage {place} END, CASE d.stage WHEN '{DIAGNOSIS}' THEN -members END, item_id"
    )
    for item, stage, input_hash in stale:
        task = DerivedTask(item, stage, Freshness(input_hash, *context.version(stage)), (), context.lab.journal)
        if stage == GROUP:
            file = folder / task.name
            some_published = write_members(file, _members(context, task.name))
            yield replace(task, snapshot=context.lab.database if some_published else None, members=file)
            continue
        members = _included(context, f"{_INCLUDED} specimen_id = ? ORDER BY recording_id", [task.name])
        (made_from,) = (one for one in items_of(task.name, members, of_rigs) if one.stage == stage)
        only, but = (DIAGNOSIS_KIND, "") if stage == DIAGNOSIS else ("", DIAGNOSIS_KIND)
        yield replace(
            task,
            recordings=fetch(made_from.recordings, reader, only=only, but=but),
            calibrations=fetch(made_from.calibrations, reader, only=only, but=but),
            settings=context.settings.of_stage(stage),
        )


def _members(context: Context, group: str) -> Iterator[Included]:
    """The recordings of a group."""
    kinds = GROUPS[group].kinds
    return (one for one in _included(context, f"{_INCLUDED} kinds <> '' ORDER BY recording_id") if one.kinds & kinds)


def _of_rigs(context: Context) -> _Calibrations:
    """Gives the calibrations of some rigs, by recording."""

    @functools.lru_cache(maxsize=_RIGS_AT_ONCE)
    def of_rigs(rigs: frozenset[str]) -> tuple[Included, ...]:
        query = f"{_INCLUDED} rig_id = ? AND calibrates"
        found = (one for rig in rigs for one in _included(context, query, [rig]))
        return tuple(sorted(found, key=attrgetter("recording_id")))

    return of_rigs


def _included(context: Context, query: str, values: tuple[Any, ...] | list[Any] = ()) -> Iterator[Included]:
    for name, specimen_id, rig_id, kinds, _, *made_from, entry in context.ledger.each(query, values):
        journal_entry = None if entry is None else context.lab.journal / entry
        yield Included(name, specimen_id, rig_id, kinds_of(kinds), Freshness(*made_from), journal_entry)


def _identity(one: Included) -> list[str]:
    made_from = one.made_from
    return [one.recording_id, made_from.input_hash, made_from.code_version, made_from.settings_hash]
